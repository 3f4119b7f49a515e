"""Stability in the time domain: whether a small vibration of the simulated cut grows or dies away.

The engine starts in the periodic motion under the force on a rigid tool, which is close to its orbit, with a kick of
`KICK` feeds per tooth. From one period to the next the orbit repeats itself and the vibration does not: what one
period differs by from the one before is the vibration alone, and after the transients it grows by the modulus of the largest
Floquet multiplier per period. No derivative is taken, and every nonlinearity counts.
"""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ._case import Case
from ._steady import Period, looped, one_by_one, steady, with_cut
from ._types import Scalar

KICK = 1e-3
"""Displacement and velocity (times the time step) at the start, over the feed per tooth [-]."""

LARGE = 0.1
"""Vibration, over the feed per tooth, at which it is no longer small, and is not looked at any more [-]."""

PERIODS = 600
"""Tooth periods simulated."""


def growth(period: Period, tooth_periods: int = PERIODS) -> Scalar:
    """By what a small vibration grows in a period [-]: 1 at the limit of stability.

    The vibration is the root mean square over a period of what the displacement differs by from the period before. Of the
    periods in which it is small, its mean over the last quarter is compared with that over the quarter before.
    """
    start, feed = period.under_rigid_force(), period.model.feed_per_tooth
    periods = tooth_periods // period.tooth_periods
    start = start._replace(state=start.state + KICK * feed)
    _, displacement = period.after(start, periods)
    vibration = jnp.sqrt(jnp.mean(jnp.diff(displacement, axis=0) ** 2, axis=(1, 2)))
    number = jnp.arange(1, periods)
    # Once large, or no longer a number: nothing after counts.
    small = jnp.cumprod(jnp.where(vibration < LARGE * feed, 1, 0))
    end = jnp.maximum(jnp.sum(small), 8)

    def mean(first, last):
        within = (number > first * end) & (number <= last * end)
        # A vibration that has died away to rounding does not grow.
        return jnp.sum(jnp.where(within, vibration, 0.0)) / jnp.sum(within)

    before, last = mean(0.5, 0.75), mean(0.75, 1.0)
    floor = 1e-9 * feed
    ratio = jnp.where(last < floor, 0.5, last / jnp.maximum(before, floor))
    return jnp.where(jnp.isfinite(ratio), ratio ** (4 / end), jnp.inf)


@eqx.filter_jit
def _growth(case: Case, cuts, count, borders: tuple[int, ...]) -> Float[Array, " n"]:
    def of(*cut):
        return growth(Period.of(steady(with_cut(case, *cut), borders)))

    return looped(of, cuts, count)


def growths(case: Case, cuts, borders: tuple[int, ...]) -> np.ndarray:
    """`growth` of cuts: speeds [rad/s], feed rates [m/s] and depths [m], three arrays of shape (n,). The settings count."""
    return one_by_one(lambda cuts, count: _growth(case, cuts, count, borders), cuts)
