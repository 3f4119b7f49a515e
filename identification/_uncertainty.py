"""What was measured says about each parameter: covariance, intervals, and which questions have no answer.

At the optimum the residuals whitened with their noise have the Jacobian J with respect to the solver's coordinates y.
The covariance of y is (J^T J)^-1, the inverse Fisher information, where what is left is white; see `_colour` where it is
not. A standard error of a parameter follows by its slope dv/dy; the 95 % interval is taken in y and mapped, so that it
stays within the bounds.
"""

from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np
from jaxtyping import ArrayLike, Float

from ._parameters import FreeParameters

RANK = 1e-6
"""Singular values of the Jacobian, its columns scaled to length 1, below this times the largest count as zero: the
simulation itself is only accurate to about this."""

INVOLVED = 0.05
"""Part of a direction of length 1, in which nothing changes, from which on a parameter has a share in it."""

UNKNOWN = 1.0
"""Standard error in y from which on a parameter counts as unknown. It is then a factor e for a parameter with one
bound, a quarter of the range for one with two, and for one with none the size of the guess, or the standard deviation of its
prior where that is larger."""

AT_BOUND = 1e-3
"""A parameter nearer to a bound than this part of its range (with one bound: of the guess's distance) is at it."""

NORMAL_95 = 1.959964
"""Half the width of the interval that holds 95 % of a normal distribution, in standard deviations."""


@dataclass(frozen=True)
class Uncertainty:
    """Per parameter, in SI units; None where there is no answer, and then `reason` says why.

    `correlation` holds NaN in the rows and columns of such parameters. `covariance` is that of the coordinates y, NaN where
    the measurements do not tell; `widened` is by how much the standard errors are larger than for white noise.
    """

    std: tuple[float | None, ...]
    ci95: tuple[tuple[float, float] | None, ...]
    identifiable: tuple[bool, ...]
    at_bound: tuple[bool, ...]
    reason: tuple[str | None, ...]
    correlation: Float[np.ndarray, "n n"]
    covariance: Float[np.ndarray, "n n"]
    widened: Float[np.ndarray, " n"]


def none_known(reasons: tuple[str, ...], identifiable: tuple[bool, ...] | None = None) -> Uncertainty:
    """No uncertainty for any of the parameters, each for its reason; which of them could be known: by default none."""
    n = len(reasons)
    nothing, no = (None,) * n, (False,) * n
    empty = np.full((n, n), np.nan)
    return Uncertainty(nothing, nothing, identifiable or no, no, reasons, empty, empty, np.ones(n))


def at_bounds(free: FreeParameters, y: ArrayLike) -> np.ndarray:
    """Which parameters lie at one of their bounds."""
    value, low, high, guess = (np.asarray(a) for a in (free.values(jnp.asarray(y)), free.low, free.high, free.guess))
    both = np.isfinite(low) & np.isfinite(high)
    with np.errstate(invalid="ignore"):
        low_scale, high_scale = np.where(both, high - low, guess - low), np.where(both, high - low, high - guess)
        near_low = np.isfinite(low) & (value - low < AT_BOUND * low_scale)
        near_high = np.isfinite(high) & (high - value < AT_BOUND * high_scale)
    return near_low | near_high


def insensitive(jacobian: Float[np.ndarray, "... rows n"]) -> np.ndarray:
    """Which parameters change nothing that was measured, up to rounding. Leading axes are a batch."""
    norms = np.linalg.norm(jacobian, axis=-2)
    return norms <= 1e-12 * np.maximum(norms.max(axis=-1, keepdims=True), 1.0)


def uncertainty(
    free: FreeParameters,
    y: ArrayLike,
    jacobian: Float[np.ndarray, "rows n"],
    correlated: Float[np.ndarray, "n n"] | None = None,
) -> Uncertainty:
    """Uncertainty of the estimates at the optimum `y`, where the whitened residuals have this Jacobian J. Where they are
    correlated in time all the same, `correlated` is J^T R J, R their correlation: the covariance then is
    (J^T J)^-1 J^T R J (J^T J)^-1."""
    n, y = len(free), jnp.asarray(y)
    value, slope = np.asarray(free.values(y)), np.asarray(free.slopes(y))
    at_bound = at_bounds(free, y)
    reason: list[str | None] = [
        f"the optimum lies at a bound: the bound decides {name}, not the measurements" if held else None
        for name, held in zip(free.names, at_bound, strict=True)
    ]
    dead = insensitive(jacobian)
    for i in np.flatnonzero(dead & ~at_bound):
        reason[i] = f"{free.names[i]} changes nothing that was measured"
    live = np.flatnonzero(~dead & ~at_bound)

    covariance, widened = np.full((n, n), np.nan), np.ones(n)
    if len(live):
        norms = np.linalg.norm(jacobian[:, live], axis=0)
        _, s, directions = np.linalg.svd(jacobian[:, live] / norms, full_matrices=False)
        known = s > RANK * s[0]
        for direction in directions[~known]:
            # In relative changes of the parameters, the largest of them 1.
            change = direction / norms * slope[live] / np.where(value[live] != 0, value[live], 1.0)
            involved = np.flatnonzero(np.abs(direction) > INVOLVED)
            text = _combination([free.names[live[k]] for k in involved], change[involved])
            for k in involved:
                reason[live[k]] = reason[live[k]] or text
        inverse = directions[known].T / s[known] ** 2 @ directions[known]
        if correlated is not None:
            white = np.diag(inverse)
            inverse = inverse @ (correlated[np.ix_(live, live)] / np.outer(norms, norms)) @ inverse
            widened[live] = np.sqrt(np.diag(inverse) / np.where(white > 0, white, 1.0))
        covariance[np.ix_(live, live)] = inverse / np.outer(norms, norms)

    std_y = np.sqrt(np.diag(covariance))
    open_ = [i for i in range(n) if reason[i] is None and std_y[i] > UNKNOWN]
    for i in open_:
        reason[i] = _drowned(free, i, live, covariance, slope, value)
    for i in open_:
        if reason[i] is None:
            shown, unit = free.shown(i, abs(slope[i]) * std_y[i]), free.units[i]
            reason[i] = (
                f"the standard error of {free.names[i]}, about {shown:.2g} {unit}".rstrip()
                + f", is too large against its value, {free.shown(i, value[i]):.3g}: the measurements hardly depend on it"
            )
    given = np.array([text is None for text in reason])
    scale = np.where(given, std_y, np.nan)
    ends = [np.asarray(free.values(y + sign * NORMAL_95 * jnp.where(given, std_y, 0.0))) for sign in (-1, 1)]
    return Uncertainty(
        std=tuple(float(slope[i] * std_y[i]) if given[i] else None for i in range(n)),
        ci95=tuple((float(ends[0][i]), float(ends[1][i])) if given[i] else None for i in range(n)),
        identifiable=tuple(bool(ok) for ok in given | at_bound),
        at_bound=tuple(bool(held) for held in at_bound),
        reason=tuple(reason),
        correlation=covariance / np.outer(scale, scale),
        covariance=covariance,
        widened=widened,
    )


def _drowned(free: FreeParameters, i: int, live, covariance, slope, value) -> str | None:
    """The combination that parameter `i` takes part in and noise hides, in words; None where it is alone."""
    size, directions = np.linalg.eigh(covariance[np.ix_(live, live)])
    worst = np.argmax(np.abs(directions[list(live).index(i)]) * np.sqrt(np.maximum(size, 0.0)))
    direction = directions[:, worst]
    involved = np.flatnonzero(np.abs(direction) > 0.1 * np.abs(direction).max())
    if len(involved) == 1:
        return None
    change = direction * slope[live] / np.where(value[live] != 0, value[live], 1.0)
    return _combination(
        [free.names[live[k]] for k in involved], change[involved], "the measurements by less than their noise"
    )


def _combination(names: list[str], change: np.ndarray, what: str = "nothing that was measured") -> str:
    """A direction in which a change of the parameters changes only `what`, in words."""
    # The first of the largest is +1, whatever rounding makes of those that are as large.
    size = np.abs(change)
    change = change / change[np.argmax(size > (1 - 1e-6) * size.max())]
    parts = [f"{c:+.3g} % of {name}" for name, c in zip(names, change, strict=True)]
    if len(parts) == 1:
        return f"{names[0]} changes {what}"
    together = f"{', '.join(parts[:-1])} with {parts[-1]}"
    return f"{', '.join(names)} cannot be told apart: {together} changes {what}. Fix one of them"
