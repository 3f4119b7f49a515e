"""Fits from many starts: is the optimum that was found the only one, and the best?"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from ._fleet import ARRIVED, Ended
from ._parameters import FreeParameters

SPREAD = 5.0
"""Factor by which starts differ from the guess at most, by default."""

SAME = 0.1
"""Costs that differ by less, in units of the noise, are of one optimum."""

MARGIN = 0.02
"""Part of the range between two bounds in which no start lies, at either end."""


@dataclass(frozen=True)
class Waterfall:
    """Where fits from many starts ended.

    **Attributes:**

    - `names`, `units`: of the parameters.
    - `starts`, `ends`: their values in these units, shape (m, n). The first start is the guess.
    - `cost`: sum of the squares of the residuals over their noise, less that of the best, shape (m,); infinite where the
      simulation failed.
    - `optimum`: which one each reached: 0 the best, 1, 2 and so on those that are worse; -1 where none was reached, shape
      (m,).
    - `seed`: of the starts.
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    starts: Float[np.ndarray, "m n"]
    ends: Float[np.ndarray, "m n"]
    cost: Float[np.ndarray, " m"]
    optimum: Int[np.ndarray, " m"]
    seed: int

    @property
    def words(self) -> str:
        """How many starts reached which optimum."""
        m, best = len(self.optimum), int(np.sum(self.optimum == 0))
        elsewhere, none = int(np.sum(self.optimum > 0)), int(np.sum(self.optimum < 0))
        said = [f"{best} of {m} starts reached the best optimum"]
        if elsewhere:
            worse = len(set(self.optimum[self.optimum > 0].tolist()))
            said.append(f"{elsewhere} ended in {worse} worse one{'s' if worse > 1 else ''}")
        if none:
            said.append(f"{none} reached none")
        return ", ".join(said)

    def to_json(self) -> dict[str, Any]:
        """For `result.json`: costs over that of the best, None where the simulation failed."""
        return {
            "message": self.words,
            "cost": [float(cost) if np.isfinite(cost) else None for cost in self.cost],
            "optimum": self.optimum.tolist(),
        }


def draw_starts(numbers: FreeParameters, count: int, spread: float, seed: int) -> Float[np.ndarray, "m n"]:
    """Coordinates of the guess and of `count` - 1 starts about it.

    Each number is the guess times a factor between 1/`spread` and `spread`, evenly drawn in its logarithm, and kept off its
    bounds. What is 0 at the guess stays there, and so do the numbers of clocks, which `align` finds in a trace.
    """
    rng = np.random.default_rng(seed)
    guess, low, high = (np.asarray(a) for a in (numbers.guess, numbers.low, numbers.high))
    factors = spread ** rng.uniform(-1, 1, size=(count, len(numbers)))
    factors[:, [leaf.startswith("clock.") for leaf in numbers.leaves]] = 1.0
    factors[0] = 1.0
    values = guess * factors
    both = np.isfinite(low) & np.isfinite(high)
    room = np.where(both, MARGIN * np.where(both, high - low, 1.0), MARGIN * np.abs(guess))
    # The guess itself may be nearer to a bound than that.
    values = np.clip(values, np.minimum(low + room, guess), np.maximum(high - room, guess))
    return np.stack([np.asarray(numbers.coordinates(jnp.asarray(v))) for v in values])


def waterfall(numbers: FreeParameters, starts: Float[np.ndarray, "m n"], ended: Sequence[Ended], seed: int) -> Waterfall:
    """Which of the fits ended in the same optimum."""
    cost = np.array([one.cost for one in ended])
    cost = cost - cost.min()
    arrived = np.array([one.distance <= ARRIVED for one in ended]) & np.isfinite(cost)
    optimum, level, last = np.full(len(ended), -1), -1, -np.inf
    for i in np.argsort(cost):
        if arrived[i]:
            if cost[i] - last > SAME:
                level += 1
            last, optimum[i] = cost[i], level

    def shown(y):
        values = np.asarray(numbers.values(jnp.asarray(y)))
        return [numbers.shown(i, float(v)) for i, v in enumerate(values)]

    return Waterfall(
        names=numbers.names,
        units=numbers.units,
        starts=np.array([shown(y) for y in starts]),
        ends=np.array([shown(one.y) for one in ended]),
        cost=cost,
        optimum=optimum,
        seed=seed,
    )
