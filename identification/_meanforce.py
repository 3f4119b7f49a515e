"""Force coefficients from mean forces: the classical start of a fit, and a check of it.

Per unit of axial depth the linear law with edge forces is F_t = k_tc h + k_te, F_r = k_rc h + k_re, F_a = k_ac h + k_ae, and
h = f_z cos(phi) where the tool is rigid. With F_x = sum(F_t sin(phi) - F_r cos(phi)), F_y = sum(F_t cos(phi) + F_r sin(phi))
(E 29), F_z = sum(F_a), the mean over a turn of N_z teeth, each engaged from phi_1 to phi_2 and to the depth a, is

    F_x = N_z a/(2 pi) (f_z (k_tc I_sc - k_rc I_cc) + k_te I_s - k_re I_c),
    F_y = N_z a/(2 pi) (f_z (k_tc I_cc + k_rc I_sc) + k_te I_c + k_re I_s),
    F_z = N_z a/(2 pi) (f_z k_ac I_c + k_ae I_1),

with I_sc the integral of sin(phi) cos(phi) from phi_1 to phi_2 and so on: linear in the six coefficients (Budak, Altintas
and Armarego, J. Eng. Ind. 118, 1996, 216-224; Altintas, Manufacturing Automation, 2012; both with other axes). Every slice
of a helical tooth passes through all of these angles once a turn, only later than the tip: the helix does not change the
mean.
"""

import math
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from millax import Case

from ._meanresult import COEFFICIENTS, Coefficient, CutMeans, MeanForceFit
from ._steady import Steady, steady
from ._traces import Trace
from ._turns import FORCES, turn_means
from ._uncertainty import RANK
from ._weighted import reasons, weighted

_PARTS = ((("Fx", "Fy"), ("ktc", "krc", "kte", "kre")), (("Fz",), ("kac", "kae")))
"""Channels and the coefficients that they depend on: two questions that have nothing in common."""


def mean_force_fit(cases: Case | Sequence[Case], traces: Trace | Sequence[Trace]) -> MeanForceFit:
    """k_tc, k_rc, k_ac, k_te, k_re and k_ae of the linear edge model (Budak, Altintas and Armarego 1996; equations in the
    head of this file) from the mean forces of several cuts, by weighted linear least squares.

    The variance of a mean is that of its scatter from turn to turn (see `turn_means`), plus that of what the linear law
    misses, one for Fx and Fy and one for Fz, as large as the residuals ask for (see `weighted`): a bent law does not
    pass for a certain one because the traces are long. With no more means than coefficients, scatter alone can count.

    What it takes for granted, and does not check:

    - A rigid tool. The mean of a linear law hardly feels vibration while every tooth keeps cutting.
    - f_z << R. The tooth paths and the ends of the engagement make the means wrong by up to about f_z/R of the largest.
    - Equal teeth. Those of unequal pitch or radius have the same mean while each cuts through the whole engagement. Near
      phi = ±90 deg, and everywhere with a runout of about f_z, one does not: the others cut its share of h, but its edge
      force is missing.

    **Arguments:**

    - `cases`: the case of each cut. Tool, cut and stock count, its force law, structure and settings do not. The cuts may
      differ in all of them; to tell cutting from edge forces, they should in feed.
    - `traces`: the trace of each cut, with some of Fx, Fy, Fz on the tool [N]; other channels do not count. Of each, the
      whole turns in steady cutting are used, when no border across the feed is in reach. Times count from the start of
      the cut, where the case has no clock.

    Returns a `MeanForceFit`, also where some coefficients cannot be known: these say why, and have no number.

    Raises `ValueError` where there is not one case for each trace, or a tool never cuts steadily; `TraceError` for a trace
    without a force, with fewer than 5 turns in steady cutting, or with fewer than 4 samples per tooth period.
    """
    cases = [cases] if isinstance(cases, Case) else list(cases)
    traces = [traces] if isinstance(traces, Trace) else list(traces)
    if len(cases) != len(traces) or not traces:
        raise ValueError(
            f"{len(cases)} cases given for {len(traces)} traces; give one case for each, and at least one of each"
        )
    cuts, maps = [], []
    for i, (case, trace) in enumerate(zip(cases, traces, strict=True), 1):
        try:
            within = steady(case)
        except ValueError as error:
            raise ValueError(f"case {i} of {len(cases)}: {error}") from error
        means = turn_means(trace, case, within)
        maps.append(mean_map(case, within)[[FORCES.index(channel) for channel in means.channels]])
        cuts.append((trace.name, float(case.cut.feed_per_tooth(case.tool)), means))
    channels = [channel for *_, means in cuts for channel in means.channels]
    measured = np.concatenate([means.mean for *_, means in cuts])
    std = np.concatenate([means.std for *_, means in cuts])
    value, coefficients, misfit = _solved(
        np.concatenate(maps), measured, std, channels, _cure([feed for _, feed, _ in cuts])
    )
    beside = (
        CutMeans(name, feed, means.turns, means.channels, means.mean, means.std, its @ value)
        for (name, feed, means), its in zip(cuts, maps, strict=True)
    )
    return MeanForceFit(coefficients, tuple(beside), misfit)


def mean_map(case: Case, within: Steady) -> Float[np.ndarray, "3 6"]:
    """Mean of Fx, Fy, Fz in steady cutting by each of `COEFFICIENTS`: [m²] by k_tc, k_rc, k_ac, [m] by k_te, k_re, k_ae."""
    s1, s2 = within.low, within.high
    c1, c2 = math.sqrt(1 - s1**2), math.sqrt(1 - s2**2)
    angle = math.asin(s2) - math.asin(s1)
    s, c, sc, cc = c1 - c2, s2 - s1, (s2**2 - s1**2) / 2, (angle + s2 * c2 - s1 * c1) / 2
    per_feed = float(case.cut.feed_per_tooth(case.tool)) * np.array([[sc, -cc, 0.0], [cc, sc, 0.0], [0.0, 0.0, c]])
    per_edge = np.array([[s, -c, 0.0], [c, s, 0.0], [0.0, 0.0, angle]])
    return case.tool.teeth * float(case.cut.depth) / (2 * math.pi) * np.hstack([per_feed, per_edge])


def _solved(
    design: Float[np.ndarray, "m 6"],
    measured: Float[np.ndarray, " m"],
    std: Float[np.ndarray, " m"],
    channels: Sequence[str],
    cure: str,
) -> tuple[Float[np.ndarray, "6"], tuple[Coefficient, ...], dict[str, float | None]]:
    """Numbers for all coefficients that fit the means, what can be said of each, and the misfit of each channel."""
    names = list(COEFFICIENTS)
    value, said, misfit = np.zeros(len(names)), {}, {}
    for part, its in _PARTS:
        rows = [i for i, channel in enumerate(channels) if channel in part]
        columns = [names.index(name) for name in its]
        if not rows:
            said |= {name: _unknown(name, f"no trace has {' or '.join(part)}") for name in its}
            continue
        found = weighted(design[rows][:, columns], measured[rows], std[rows])
        value[columns] = found.value
        misfit |= {channel: found.misfit for channel in part if channel in channels}
        for i, (name, reason) in enumerate(zip(its, reasons(its, found), strict=True)):
            known = Coefficient(name, float(found.value[i]), COEFFICIENTS[name], float(found.std[i]), None)
            said[name] = known if reason is None else _unknown(name, f"{reason}. {cure}")
    return value, tuple(said[name] for name in names), misfit


def _unknown(name: str, reason: str) -> Coefficient:
    return Coefficient(name, None, COEFFICIENTS[name], None, reason)


def _cure(feeds: Sequence[float]) -> str:
    """What to measure so that more can be known."""
    if np.ptp(feeds) <= RANK * max(feeds):
        return f"All cuts have the same feed per tooth, {1e3 * feeds[0]:.4g} mm: measure at others too"
    return "Measure both Fx and Fy, and at more feeds"
