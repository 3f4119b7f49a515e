"""Stability in the time domain: whether a small vibration of the simulated cut grows or dies away.

The engine starts on its periodic orbit, stable or not (`_floquet.periodic_orbit`), with a kick of `KICK` feeds per tooth.
From one period to the next the orbit repeats itself and the vibration does not: what one period differs by from the
one before is the vibration alone, and after the transients it grows by the modulus of the largest Floquet multiplier per
period. No derivative of it is taken, and every nonlinearity counts.

The vibration must be small from its first period on. In a deep cut at a small immersion the first periods make it hundreds
of times the kick, even where it dies away in the end; and beginning at a tenth of the feed it may not die away at all, since
teeth that have lost contact may go on doing so in a stable cut too.
"""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Float

from ._case import Case
from ._floquet import periodic_orbit
from ._steady import Orbit, Period, looped, one_by_one, steady, with_cut
from ._types import Scalar

KICK = 1e-6
"""Displacement and velocity (times the time step) at the start, over the feed per tooth [-]."""

LARGE = 1e-2
"""Vibration, over the feed per tooth, at which it is no longer small, and is not looked at any more [-]."""

FLOOR = 1e-9
"""Vibration, over the feed per tooth, at which it has died away: rounding is not far [-]."""

PERIODS = 600
"""Tooth periods simulated."""


def growth(period: Period, start: Orbit, tooth_periods: int = PERIODS) -> Scalar:
    """By what a small vibration grows in a period [-]: 1 at the limit of stability.

    `start` is on the orbit. The vibration is the root mean square over a period of what the displacement differs by from the
    period before. Of the periods in which it is small and has not died away, its mean over the last quarter is compared with
    that over the quarter before.
    """
    feed = period.model.feed_per_tooth
    periods = tooth_periods // period.tooth_periods
    start = start._replace(state=start.state + KICK * feed)
    _, displacement = period.after(start, periods)
    vibration = jnp.sqrt(jnp.mean(jnp.diff(displacement, axis=0) ** 2, axis=(1, 2)))
    number = jnp.arange(1, periods)
    # Once large, died away, or no longer a number: nothing after counts.
    counted = jnp.cumprod(jnp.where((vibration > FLOOR * feed) & (vibration < LARGE * feed), 1, 0))
    end = jnp.maximum(jnp.sum(counted), 8)

    def mean(first, last):
        within = (number > first * end) & (number <= last * end)
        return jnp.sum(jnp.where(within, vibration, 0.0)) / jnp.sum(within)

    before, last = mean(0.5, 0.75), mean(0.75, 1.0)
    # Rounding beside rounding does not grow.
    ratio = last / jnp.maximum(before, FLOOR * feed)
    return jnp.where(jnp.isfinite(ratio), ratio ** (4 / end), jnp.inf)


@eqx.filter_jit
def _growth(case: Case, cuts, count, borders: tuple[int, ...]) -> Float[Array, " n"]:
    def of(*cut_and_start):
        *cut, start = cut_and_start
        period = Period.of(steady(with_cut(case, *cut), borders))
        return growth(period, ravel_pytree(period.at_rest())[1](start))

    return looped(of, cuts, count)


def growths(case: Case, cuts, borders: tuple[int, ...]) -> np.ndarray:
    """`growth` of cuts: speeds [rad/s], feed rates [m/s] and depths [m], three arrays of shape (n,). The settings count."""
    starts = [ravel_pytree(periodic_orbit(with_cut(case, *cut), borders)[0])[0] for cut in zip(*cuts, strict=True)]
    return one_by_one(lambda cuts, count: _growth(case, cuts, count, borders), (*cuts, np.array(starts)))
