"""Limits of stability: the axial depth at which a small vibration neither grows nor dies away.

A cut is stable where the spectral radius of the map over a period, the largest modulus of its Floquet multipliers, is below
1. The period is a tooth period, or a turn of the tool where its teeth are not equal (runout, pitch). Unequal teeth move the
tool from tooth to tooth, and so cut chips other than those on its path, around which the process is linearised: where the
forced vibration is not small against the feed, believe the time-domain model.

Three ways to a limit: semi-discretisation of the linearised process (`_linearised`), the Floquet multipliers of the
time-domain model itself (`_floquet`), and the growth of a vibration in a simulation (`_growth`).
"""

import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from . import _floquet, _growth, _linearised
from ._case import Case
from ._runtime import double_precision
from ._settings import Settings, block_options
from ._simulate import SINGLE_PRECISION
from ._steady import TOGETHER, along_feed, is_traced, process_matrices, seen, steady, with_cut
from ._structure import free_rates
from ._types import Scalar
from ._units import parse, si_scale
from ._values import Given, Values, read

if TYPE_CHECKING:
    import xarray

Method = Literal["semi", "floquet", "time"]

STABILITY_METHODS = {
    "semi": "semi-discretisation of the linearised cut",
    "floquet": "Floquet multipliers of the time-domain model",
    "time": "growth of a vibration in the time domain",
}
"""The ways to a limit of stability."""

TOLERANCE = {"semi": 1e-10, "floquet": 1e-4, "time": 1e-3}
"""Relative error of a limit depth that the search leaves."""

FACTOR = 1.1
"""From one depth to the next in a search from below. Islands of instability that are thinner may be missed."""

HIGHEST = 1000.0
"""Depth at which a search from below ends, over that at which it begins."""

FINER = 2
"""Steps of the time domain, over those of the semi-discretisation: its force is constant within a step."""

EXACT = 1e-12
"""Tolerance of the fixed-point sweeps: derivatives and small vibrations want them converged."""


@dataclass(frozen=True)
class StabilityProgress:
    """How far a diagram is: `done` of `total` limits, in this method."""

    method: str
    done: int
    total: int


@eqx.filter_custom_jvp
def spectral_radius(case: Case, *, method: Method = "semi") -> Scalar:
    """Spectral radius of the map over a period, around the periodic motion of the steady cut [-].

    The cut is stable where it is below 1: a small vibration changes by this factor from tooth to tooth, or from turn to turn
    where the teeth are not equal.

    **Arguments:**

    - `case`: its tool is taken to be inside the workpiece, far from the borders across the feed.
    - `method`: "semi", "floquet" or "time", see `millax.STABILITY_METHODS`.

    With method "semi" it is differentiable with respect to every number of the case (not under `jit`: the search for
    eigenvalues is no JAX program). Raises `ValueError` where there is nothing to be stable: a tool that is rigid in the
    plane, that never meets the stock, or has no feed; and inside `jit`.
    """
    cut, borders = _checked(case), along_feed(case.stock)
    one = tuple(np.asarray(x)[None] for x in (cut.spindle_speed, cut.feed_rate, cut.depth))
    return jnp.asarray(abs(_radii(case, method, borders, *one)(*one)[0]))


@spectral_radius.def_jvp
def _spectral_radius_jvp(primals, tangents, *, method="semi"):
    (case,), (change,) = primals, tangents
    _differentiable(method)
    _checked(case)
    value, gradient = _linearised.radius_and_gradient(case, along_feed(case.stock), _linearised.resolution(case))
    return jnp.asarray(value), _product(gradient, change)


@eqx.filter_custom_jvp
def limit_depth(case: Case, *, method: Method = "semi") -> Scalar:
    """The smallest axial depth at which the cut is not stable [m]; `cut.depth` does not count. NaN where there is none.

    **Arguments:** as for `spectral_radius`. The search goes upwards in steps of 10 %.

    With method "semi" it is differentiable with respect to every number p of the case: at the limit the spectral radius
    rho(a, p) is 1, so da/dp = -(drho/dp)/(drho/da). Raises `ValueError` as `spectral_radius` does.
    """
    cut = _checked(case)
    depths = _limits(case, method, *(np.asarray(x)[None] for x in (cut.spindle_speed, cut.feed_rate)))
    return jnp.asarray(depths[0])


@limit_depth.def_jvp
def _limit_depth_jvp(primals, tangents, *, method="semi"):
    (case,), (change,) = primals, tangents
    _differentiable(method)
    limit = limit_depth(case, method=method)
    if not np.isfinite(limit):
        return limit, jnp.full_like(limit, jnp.nan)
    at_limit = eqx.tree_at(lambda c: c.cut.depth, case, limit)
    _, gradient = _linearised.radius_and_gradient(at_limit, along_feed(case.stock), _linearised.resolution(case))
    by_depth = gradient.cut.depth
    gradient = eqx.tree_at(lambda c: c.cut.depth, gradient, jnp.zeros_like(by_depth))
    return limit, -_product(gradient, change) / by_depth


def stability(
    case: Case,
    speeds: Given,
    *,
    depths: Given | None = None,
    methods: Sequence[Method] = ("semi",),
    progress: Callable[[StabilityProgress], None] | None = None,
) -> "xarray.Dataset":
    """The stability lobe diagram: limit depth over spindle speed.

    **Arguments:**

    - `case`: as for `spectral_radius`. Its feed per tooth is held while the speed varies; its depth does not count.
    - `speeds`: "5000:25000:101 rpm" (from, to, how many), "8000, 10000 rpm", or an array [rad/s].
    - `depths`: likewise, at which the spectral radius is kept as well (by semi-discretisation); the limit is then looked for
      between them, from below. None: wherever it is.
    - `methods`: out of `millax.STABILITY_METHODS`. The limits of "floquet" and "time" are looked for around those of "semi".
    - `progress`: called with a `StabilityProgress` now and then.

    **Returns:** a dataset over `analysis` (the methods) and `cut.spindle_speed` (in the unit given) with `limit_depth` [m]
    (NaN: none was found), `multiplier_angle` [rad] at the limit (pi: period doubling, in between: a second frequency), and
    with `depths` also `spectral_radius` over `cut.spindle_speed` and `cut.depth`.

    Raises `ValueError` as `spectral_radius` does, and for speeds, depths and methods that cannot be used.
    """
    import xarray

    for method in methods:
        _known(method)
    methods = list(dict.fromkeys(methods))
    cut = _checked(case)
    speed_values = _given("speeds", speeds, "rad/s")
    omega = speed_values.numbers * _scale(speed_values.unit)
    feed_rates = float(cut.feed_per_tooth(case.tool)) * omega * case.tool.teeth / (2 * np.pi)
    speed = "cut.spindle_speed"
    coords: dict = {
        "analysis": methods,
        speed: (speed, speed_values.numbers, {"units": speed_values.unit or "rad/s"}),
    }
    variables: dict = {}
    grid = None
    if depths is not None:
        depth_values = _given("depths", depths, "m")
        grid = np.sort(depth_values.numbers) * _scale(depth_values.unit)
        coords["cut.depth"] = ("cut.depth", np.sort(depth_values.numbers), {"units": depth_values.unit or "m"})
        radius = np.abs(_map(case, omega, feed_rates, grid, _reporter(progress, "map")))
        definition = "spectral radius of the map over a tooth period, or a turn of unequal teeth; stable below 1"
        variables["spectral_radius"] = ((speed, "cut.depth"), radius, {"units": "", "long_name": definition})
    found = np.full((len(methods), len(omega)), np.nan)
    angles = np.full_like(found, np.nan)
    semi = _limits(case, "semi", omega, feed_rates, grid, progress=_reporter(progress, "semi"))
    for i, method in enumerate(methods):
        if method == "semi":
            found[i] = semi
        else:
            found[i] = _limits(case, method, omega, feed_rates, around=semi, progress=_reporter(progress, method))
        at = np.isfinite(found[i])
        if method != "time" and at.any():
            here = omega[at], feed_rates[at], found[i][at]
            angles[i, at] = np.abs(np.angle(_radii(case, method, along_feed(case.stock), *here)(*here)))
    attributes = {"units": "m", "long_name": "smallest axial depth at which the cut is not stable"}
    variables["limit_depth"] = (("analysis", speed), found, attributes)
    attributes = {"units": "rad", "long_name": "angle of the largest Floquet multiplier at the limit depth"}
    variables["multiplier_angle"] = (("analysis", speed), angles, attributes)
    return xarray.Dataset(variables, coords, {"title": "stability limits of a milling cut"})


Radii = Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]
"""The largest multipliers, or their moduli, for speeds [rad/s], feed rates [m/s] and depths [m]."""


def _radii(case: Case, method: Method, borders, speeds, feed_rates, depths) -> Radii:
    """For these cuts, or ones like them: steps, blocks and sweeps are chosen once for all, so that one program serves."""
    _known(method)
    steps = _steps(case, speeds)
    if method == "semi":
        return lambda *cuts: _linearised.leading_multipliers(case, cuts, borders, steps)
    module = _floquet.leading_multipliers if method == "floquet" else _growth.growths
    steps = max(FINER * steps, case.settings.steps_per_tooth)
    if steps > _linearised.STEPS[-1]:
        steps = _linearised.STEPS[-1]
    numerics = [
        Settings.suited(
            case.tool,
            case.force,
            case.at_tool,
            with_cut(case, *at).cut,
            1e-9,
            steps_per_tooth=steps,
            passes=case.settings.passes,
            width=float(case.settings.width),
            blocks=block_options(steps)[-1],
            tolerance=EXACT,
        )
        for at in zip(speeds, feed_rates, depths, strict=True)
    ]
    # Of two settings, more blocks are the safer, with the sweeps of the most demanding cut: in eights, for few programs.
    settled = case.with_settings(
        steps_per_tooth=steps,
        periods=1,
        blocks=block_options(steps)[-1],
        sweeps=8 * -(-max(s.sweeps for s in numerics) // 8),
        tolerance=EXACT,
    )
    return lambda *cuts: module(settled, cuts, borders)


def _steps(case: Case, speeds) -> int:
    """Of the semi-discretisation: what the slowest cut takes."""
    return _linearised.resolution(eqx.tree_at(lambda c: c.cut.spindle_speed, case, jnp.asarray(np.min(speeds))))


def _map(case: Case, speeds, feed_rates, depths, report) -> np.ndarray:
    """The largest multipliers over speed and depth."""
    borders = along_feed(case.stock)
    found = np.empty((len(speeds), len(depths)), dtype=complex)
    for i, (speed, feed) in enumerate(zip(speeds, feed_rates, strict=True)):
        here = (np.full(len(depths), speed), np.full(len(depths), feed), depths)
        found[i] = _radii(case, "semi", borders, *here)(*here)
        report(i + 1, len(speeds))
    return found


def _limits(case, method, speeds, feed_rates, grid=None, *, around=None, progress=lambda done, total: None) -> np.ndarray:
    """Limit depths [m] at these speeds: between the depths of a grid, around some, or wherever they are."""
    borders, n = along_feed(case.stock), len(speeds)
    if method != "semi" and around is None:
        around = _limits(case, "semi", speeds, feed_rates)
    if around is not None:
        near = np.where(np.isfinite(around), around, np.nanmax(around) if np.isfinite(around).any() else 1.0)
        of = _radii(case, method, borders, speeds, feed_rates, 1.05 * near)
        ladder = (np.array([0.98, 1.02]), np.array([0.93, 1.07]), np.array([0.8, 1.25]), np.array([0.5, 2.0]))
    else:
        of = _radii(case, method, borders, speeds, feed_rates, np.ones(n))
        ladder = ()
    low, high = np.zeros(n), np.full(n, np.nan)
    below, above = np.full(n, -1.0), np.full(n, np.nan)

    def excess(at, depths):
        return np.abs(of(speeds[at], feed_rates[at], depths)) - 1

    if around is not None:
        missing = np.flatnonzero(np.isfinite(around))
        for ends in ladder:
            if not len(missing):
                break
            f = [excess(missing, end * around[missing]) for end in ends]
            ok = (f[0] < 0) & (f[1] >= 0)
            at = missing[ok]
            low[at], high[at], below[at], above[at] = ends[0] * around[at], ends[1] * around[at], f[0][ok], f[1][ok]
            missing = missing[~ok]
    else:
        if grid is None:
            start = 0.5 * np.array([_lowest(case, s, f, borders) for s, f in zip(speeds, feed_rates, strict=True)])
            count = int(np.log(HIGHEST) / np.log(FACTOR))
            depths = start[None] * FACTOR ** np.arange(count)[:, None]
        else:
            depths = np.broadcast_to(grid[:, None], (len(grid), n))
        open_, next_row = np.arange(n), 0
        while len(open_) and next_row < len(depths):
            # As many depths of each speed as are computed together anyway.
            rows = depths[next_row : next_row + max(1, TOGETHER // len(open_)), open_]
            next_row += len(rows)
            f = excess(np.tile(open_, len(rows)), rows.ravel()).reshape(rows.shape)
            for row, values in zip(rows, f, strict=True):
                going = np.isnan(high[open_])
                crossed, before = going & ~(values < 0), going & (values < 0)
                high[open_[crossed]], above[open_[crossed]] = row[crossed], values[crossed]
                low[open_[before]], below[open_[before]] = row[before], values[before]
            open_ = open_[np.isnan(high[open_])]
            progress(n - len(open_), n)
    at = np.flatnonzero(np.isfinite(high))
    result = np.full(n, np.nan)
    if len(at):
        result[at] = _crossing(
            lambda which, depths: excess(at[which], depths), low[at], high[at], below[at], above[at], TOLERANCE[method]
        )
    progress(n, n)
    return result


def _crossing(excess, low, high, below, above, tolerance, most: int = 60) -> np.ndarray:
    """Where functions of depth cross 0 between two depths, all at once: the Illinois variant of the false position.

    The smaller end may be 0, of which nothing is known but that it is stable.
    """
    low, high, below, above = (np.array(x, dtype=float) for x in (low, high, below, above))
    root, open_ = high.copy(), np.arange(len(low))
    side = np.zeros(len(low), dtype=int)
    for _ in range(most):
        a, b, fa, fb = low[open_], high[open_], below[open_], above[open_]
        usable = np.isfinite(fa) & np.isfinite(fb) & (fb > fa)
        x = np.where(usable, b - fb * (b - a) / np.where(usable, fb - fa, 1.0), (a + b) / 2)
        f = excess(open_, x)
        root[open_] = x
        up = ~(f < 0)
        # An end that stays twice loses half its weight.
        below[open_] = np.where(up, np.where(side[open_] == 1, fa / 2, fa), f)
        above[open_] = np.where(up, f, np.where(side[open_] == -1, fb / 2, fb))
        high[open_], low[open_] = np.where(up, x, b), np.where(up, a, x)
        side[open_] = np.where(up, 1, -1)
        done = (np.abs(f) < 1e-13) | (high[open_] - low[open_] < tolerance * high[open_])
        moved = np.minimum(np.abs(x - a), np.abs(x - b)) < tolerance / 10 * x
        open_ = open_[~(done | moved)]
        if not len(open_):
            break
    return root


def _lowest(case: Case, speed, feed, borders) -> float:
    """A depth below which no cut like this is unstable, by rule of thumb [m]: 2 zeta k over the largest process stiffness.

    Raises `ValueError` where no tooth ever meets the stock.
    """
    per_depth = np.asarray(_process_of(with_cut(case, speed, feed, 1.0), borders, 80))
    process = float(np.linalg.norm(per_depth.mean(axis=0), 2))
    if process == 0:
        raise ValueError(
            "stability: no tooth meets the stock, so there is no limit of stability. Look at stock.y, cut.start and "
            "tool.diameter"
        )
    s = case.at_tool
    shapes = np.asarray(s.in_plane_shapes)
    compliance = np.linalg.norm(shapes @ np.linalg.solve(np.asarray(s.stiffness_matrix), shapes.T), 2)
    values = np.linalg.eigvals(free_rates(s.mass_matrix, s.damping_matrix, s.stiffness_matrix))
    ratio = float(np.min(-values.real / np.abs(values)))
    return float(2 * max(ratio, 1e-6) / (compliance * process))


@eqx.filter_jit
def _process_of(case: Case, borders, steps: int) -> Float[Array, "L 2 2"]:
    return process_matrices(steady(case, borders), steps).now


def _checked(case: Case):
    """The cut of a case whose stability can be asked for."""
    if is_traced(case):
        raise ValueError("stability: the case is traced; call it outside jit and vmap (jax.grad and jax.jacrev are fine)")
    if not seen(case) or case.at_tool.coordinates == 0:
        raise ValueError(
            "structure: the tool is rigid in the plane, so it does not chatter and has no limit of stability. Give the case "
            "a [structure] that moves along x or y"
        )
    if not float(case.cut.feed_rate) > 0:
        raise ValueError("cut.feed_rate: 0 m/s given; without feed no tooth cuts, and there is no limit of stability")
    if not double_precision():
        warnings.warn(SINGLE_PRECISION, stacklevel=3)
    return case.cut


def _known(method) -> None:
    if method not in STABILITY_METHODS:
        raise ValueError(f"method: {method!r} given; it must be one of {', '.join(STABILITY_METHODS)}")


def _differentiable(method) -> None:
    if method != "semi":
        raise ValueError(f'method: "{method}" given; derivatives are there with "semi"')


def _product(gradient: Case, change: Case) -> Scalar:
    """Sum of gradient times change over all numbers of a case."""
    gradients, changes = (jax.tree.leaves(tree, is_leaf=lambda x: x is None) for tree in (gradient, change))
    return sum((jnp.sum(g * d) for g, d in zip(gradients, changes, strict=True) if d is not None), jnp.zeros(()))


def _given(name: str, given: Given, unit: str) -> Values:
    values = read(name, given)
    if values.unit is not None:
        parse(name, f"1 {values.unit}".strip(), unit)  # a unit of another kind is an error
    numbers = np.atleast_1d(values.numbers)
    if not (numbers > 0).all():
        raise ValueError(f"{name}: {numbers.min():g} {values.unit or unit} given; every one must be greater than 0")
    return Values(numbers, values.unit)


def _scale(unit: str | None) -> float:
    return si_scale(unit) if unit else 1.0


def _reporter(progress, method: str):
    if progress is None:
        return lambda done, total: None
    return lambda done, total: progress(StabilityProgress(method, done, total))
