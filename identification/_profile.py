"""Profile likelihood: intervals that need no straight line through the optimum.

A parameter is held beside its estimate, the others are fitted again, and the cost rises by D. For normal errors D is the
square of the distance in standard errors; in general the 95 % interval is where sqrt(D) stays below 1.96 (Wilks 1938; Bates
and Watts, Nonlinear Regression Analysis, 1988). Where residuals are correlated in time, D is divided by the square of the
factor by which the standard error was widened (Rotnitzky and Jewell 1990).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from ._fleet import ARRIVED, solve_many
from ._result import FitResult
from ._uncertainty import NORMAL_95

LIMIT = NORMAL_95
"""sqrt(D) at the ends of the interval of 95 %."""

NEAR = 0.01
"""How near to it an end is found."""

ROUNDS = 8
"""Most rounds of looking for the ends."""

FARTHEST = 12.0
"""Distance from the estimate looked at, in standard errors: what is open there is open."""

BETTER = 0.05
"""By how much the cost may fall beside an optimum, rounding and the end of a fit allowed."""

DRAWN = (0.5, 1.0, 1.5, 3.0)
"""Distances that are looked at besides, in standard errors, for the curve."""


@dataclass(frozen=True)
class Profile:
    """What the measurements say of one parameter, whatever the others are.

    **Attributes:**

    - `name`, `unit`: of the parameter.
    - `values`: in `unit`, rising, shape (k,), and `root`: sqrt(D) there, negative below the estimate.
    - `ci95`: where |root| is below 1.96, in `unit`; None where an end was not found, or where there is a better optimum.
    - `reason`: why, in words.
    """

    name: str
    unit: str
    values: Float[np.ndarray, " k"]
    root: Float[np.ndarray, " k"]
    ci95: tuple[float, float] | None
    reason: str | None

    def to_json(self) -> dict[str, Any]:
        """For `result.json`."""
        return {
            "name": self.name,
            "unit": self.unit,
            "values": self.values.tolist(),
            "root": self.root.tolist(),
            "ci95": self.ci95 and list(self.ci95),
            "reason": self.reason,
        }


def profile(
    result: FitResult, names: Sequence[str] | None = None, *, progress: Callable[[str], None] | None = None
) -> tuple[Profile, ...]:
    """The profile likelihoods of parameters of a fit that reached an optimum.

    **Arguments:**

    - `result`: of `fit`.
    - `names`: of the parameters. None: all. One without a standard error has no profile, and the reason is that of the fit.
    - `progress`: called with words.

    Raises `ValueError` for a name that was not free, and for a fit that did not reach an optimum.
    """
    free = [e.name for e in result.parameters]
    for name in names or ():
        if name not in free:
            raise ValueError(f"profile of {name}: it was not free; free were {', '.join(free)}")
    if not result.has_optimum:
        raise ValueError(f"profile: the fit has no optimum to start from: {result.message}")
    which = [free.index(name) for name in names or free]
    curves = [_Curve(result, i) for i in which if result.parameters[i].std is not None]
    say = progress or (lambda words: None)
    for number in range(ROUNDS):
        wanted = [(curve, step) for curve in curves for step in curve.next(first=number == 0)]
        if not wanted:
            break
        words = f"profiles, round {number + 1}: {{}} of {len(wanted)} fits"
        _look(result, wanted, lambda done, words=words: say(words.format(done)))
    by_name = {result.parameters[curve.i].name: curve.profile() for curve in curves}
    unknown = (result.parameters[i] for i in which)
    nothing = {e.name: Profile(e.name, e.unit, np.zeros(0), np.zeros(0), None, e.reason) for e in unknown if e.std is None}
    return tuple((by_name | nothing)[free[i]] for i in which)


def _look(result: FitResult, wanted: Sequence[tuple["_Curve", float]], done: Callable[[int], None]) -> None:
    """Fit with one parameter held, for every curve and distance wanted."""
    starts = np.stack([curve.start(step) for curve, step in wanted])
    held = np.stack([np.arange(len(result.y)) == curve.i for curve, _ in wanted])
    ended = solve_many(result.asked.model, result.noise, starts, held, done=done)
    for (curve, step), one in zip(wanted, ended, strict=True):
        curve.add(step, one.cost if one.distance <= ARRIVED else np.inf)


class _Curve:
    """The profile of parameter `i` while it is found; distances are in standard errors of its coordinate."""

    def __init__(self, result: FitResult, i: int):
        self.result, self.i = result, i
        covariance = np.nan_to_num(result.covariance)
        self.std = float(np.sqrt(covariance[i, i]))
        # How the others move along with it.
        self.along = covariance[:, i] / self.std
        self.least = result.cost
        self.squares = {0.0: 0.0}

    def start(self, step: float) -> np.ndarray:
        return self.result.y + self.along * step

    def add(self, step: float, cost: float) -> None:
        self.squares[step] = (cost - self.least) / self.result.parameters[self.i].widened ** 2

    def next(self, first: bool) -> list[float]:
        """Distances to look at: at first some for the curve, then where the ends seem to be."""
        if first:
            return [sign * step for sign in (-1.0, 1.0) for step in (*DRAWN, LIMIT)]
        steps = [self._guess(sign) for sign in (-1.0, 1.0)]
        return [step for step in steps if step is not None]

    def _guess(self, sign: float) -> float | None:
        """Where the end on this side may be; None where it is found, or is none."""
        side = self._side(sign)
        if any(abs(root - LIMIT) < NEAR for _, root in side):
            return None
        below, above = _bracket(side)
        if above is None:
            return sign * min(2 * below[0], FARTHEST) if below[0] < FARTHEST else None
        if not np.isfinite(above[1]):
            return sign * 0.5 * (below[0] + above[0]) if above[0] - below[0] > 0.02 else None
        return sign * _between(below, above)

    def _end(self, sign: float) -> float | None:
        below, above = _bracket(self._side(sign))
        return None if above is None or not np.isfinite(above[1]) else sign * _between(below, above)

    def _side(self, sign: float) -> list[tuple[float, float]]:
        """Distances looked at on one side, the nearest first, and sqrt(D) there."""
        here = ((abs(step), square) for step, square in self.squares.items() if step * sign >= 0)
        return sorted((step, float(np.sqrt(max(square, 0.0)))) for step, square in here)

    def profile(self) -> Profile:
        estimate = self.result.parameters[self.i]
        steps = sorted(step for step, square in self.squares.items() if np.isfinite(square))
        root = np.array([np.sign(step) * np.sqrt(max(self.squares[step], 0.0)) for step in steps])
        ends, reason = [self._end(sign) for sign in (-1.0, 1.0)], None
        if min(self.squares.values()) < -BETTER:
            reason = f"there is a better optimum beside the one found: fit again, from several starts ({estimate.name})"
        elif None in ends:
            side = "below" if ends[0] is None else "above"
            reason = f"the measurements leave {estimate.name} open {side} the estimate"
        low, high = (self._shown(end) if end is not None else 0.0 for end in ends)
        return Profile(
            name=estimate.name,
            unit=estimate.unit,
            values=np.array([self._shown(step) for step in steps]),
            root=root,
            ci95=(low, high) if reason is None else None,
            reason=reason,
        )

    def _shown(self, step: float) -> float:
        numbers = self.result.asked.numbers
        y = self.result.y.copy()
        y[self.i] += self.std * step
        return numbers.shown(self.i, float(numbers.values(jnp.asarray(y))[self.i]))


def _bracket(side: Sequence[tuple[float, float]]) -> tuple[tuple[float, float], tuple[float, float] | None]:
    """The last point before the first one beyond the limit, and that one, if there is one."""
    below = side[0]
    for point in side[1:]:
        if point[1] >= LIMIT:
            return below, point
        below = point
    return below, None


def _between(below: tuple[float, float], above: tuple[float, float]) -> float:
    """Where a straight line from the one point to the other reaches the limit."""
    return below[0] + (LIMIT - below[1]) / (above[1] - below[1]) * (above[0] - below[0])
