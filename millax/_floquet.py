"""Floquet multipliers of the time-domain model itself: of the engine over one tooth period, around its periodic orbit.

With G the map over a period (`_steady.Period`), the orbit is z = G(z), found by Newton's method, stable or not; the
multipliers are the eigenvalues of dG/dz there. Both need only products of dG/dz with vectors, which the engine's linear
march gives: in the Krylov space of a vector, spanned by Arnoldi's method, Newton's equation is solved and the largest
multipliers are found. No matrix is larger than that space.
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Float

from ._case import Case
from ._krylov import SPACE, arnoldi, largest
from ._steady import Period, steady, with_cut
from ._types import Scalar

NEWTON_STEPS = 4
"""Newton's method converges in two: the force hardly depends on the motion along the orbit."""

CLOSED = 1e-6
"""What may be missing from the orbit to close, over the feed per tooth [-]."""


class Found(NamedTuple):
    """Around one orbit."""

    space: Float[Array, "SPACE+1 SPACE"]
    """H: dG/dz in the Krylov space."""
    residual: Scalar
    """How far the orbit is from closing, over the feed per tooth [-]."""


def orbit_and_space(period: Period, space: int = SPACE) -> tuple[Array, Found]:
    """The periodic orbit as a vector, and dG/dz around it."""
    guess, unravel = ravel_pytree(period.under_rigid_force())

    def mapped(z):
        return ravel_pytree(period(unravel(z)))[0]

    # A vector with a part along every eigenvector, the same in every run.
    any_vector = jnp.asarray(np.random.default_rng(0).normal(size=len(guess)), guess.dtype)

    def step(i, found):
        z, *_ = found
        value, linear = jax.linearize(mapped, z)
        missing, last = z - value, i == NEWTON_STEPS
        basis, h = arnoldi(linear, jnp.where(last, any_vector, missing), space)
        # (dG/dz - 1) dz = z - G(z) in the least-squares sense.
        shifted = h - jnp.eye(space + 1, space)
        target = jnp.zeros(space + 1).at[0].set(jnp.linalg.norm(missing))
        change = jnp.linalg.lstsq(shifted, target)[0] @ basis[:space]
        return jnp.where(last, z, z + change), h, jnp.max(jnp.abs(missing))

    # One step more than Newton's: at the orbit, for its multipliers.
    start = (guess, jnp.zeros((space + 1, space)), jnp.zeros(()))
    z, h, missing = lax.fori_loop(0, NEWTON_STEPS + 1, step, start)
    return z, Found(h, missing / jnp.maximum(period.model.feed_per_tooth, 1e-30))


@eqx.filter_jit
def _spaces(case: Case, speeds, feed_rates, depths, borders: tuple[int, ...]):
    def of(speed, feed, depth):
        return orbit_and_space(Period.of(steady(with_cut(case, speed, feed, depth), borders)))[1]

    return jax.vmap(of)(speeds, feed_rates, depths)


TOGETHER = 4
"""Orbits computed at once."""


def leading_multipliers(case: Case, speeds, feed_rates, depths, borders: tuple[int, ...]) -> np.ndarray:
    """The largest Floquet multiplier for each speed [rad/s], feed rate [m/s] and depth [m], three arrays of shape (n,).

    The settings of the case count. NaN where no orbit is found, or its multipliers have not converged.
    """
    n = len(speeds)
    found = np.full(n, np.nan, dtype=complex)
    for first in range(0, n, TOGETHER):
        part = np.minimum(np.arange(first, first + TOGETHER), n - 1)
        spaces, residuals = map(np.asarray, _spaces(case, speeds[part], feed_rates[part], depths[part], borders))
        for i, h, residual in zip(part[: n - first], spaces, residuals, strict=False):
            if np.isfinite(h).all() and residual < CLOSED:
                found[i] = largest(h)
    return found
