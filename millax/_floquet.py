"""Floquet multipliers of the time-domain model itself: of the engine over one period, around its periodic orbit.

With G the map over a period (`_steady.Period`), the orbit is z = G(z), found by Newton's method, stable or not; the
multipliers are the eigenvalues of dG/dz there. Both need only products of dG/dz with vectors, which the engine's linear
march gives: in the Krylov space of a vector, spanned by Arnoldi's method, Newton's equation is solved and the largest
multipliers are found. No matrix is larger than that space.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from jaxtyping import Array

from ._case import Case
from ._krylov import SPACE, arnoldi, largest
from ._steady import Orbit, Period, steady, with_cut

MOST_STEPS = 8
"""Steps of Newton's method. One to three are enough where no tooth loses contact along the orbit."""

WAY = (0.5, 0.7, 0.85, 0.95, 1.0)
"""Depths, over that of the cut, at which the orbit is looked for one after the other where it is not found at once."""

CLOSED = 1e-7
"""What may be missing from the orbit to close, over the feed per tooth [-]."""


@eqx.filter_jit
def _close(case: Case, borders: tuple[int, ...]) -> Orbit:
    """Where Newton's method starts. Equal teeth feel little of a periodic motion, and the one under the force on a rigid
    tool is close to the orbit. Unequal teeth feel it, and may lose contact in one that large: from rest the first step leads
    to the motion of the linearised cut, in which every tooth stays in contact."""
    period = Period.of(steady(case, borders))
    return period.under_rigid_force() if period.tooth_periods == 1 else period.at_rest()


@eqx.filter_jit
def _around(case: Case, borders: tuple[int, ...], z: Orbit, direction: Array):
    """What a motion z misses to close, and dG/dz there in the Krylov space of a direction (0: of what is missing)."""
    period = Period.of(steady(case, borders))
    at, unravel = ravel_pytree(z)
    value, linear = jax.linearize(lambda z: ravel_pytree(period(unravel(z)))[0], at)
    missing = at - value
    # A value, not a second program.
    basis, h = arnoldi(linear, jnp.where(jnp.any(direction != 0), direction, missing), SPACE)
    return missing, basis, h, period.model.feed_per_tooth


def periodic_orbit(case: Case, borders: tuple[int, ...]) -> tuple[Orbit, float]:
    """The periodic motion of a cut, stable or not, with the settings of its case: what it leaves to the next period, and by
    how much it does not close, over the feed per tooth [-]."""
    z, missing, feed = _newton(case, borders, _close(case, borders))
    if not missing < CLOSED * feed:
        # It may be far from where Newton's method started: followed there from a shallower cut.
        z = _close(_shallower(case, WAY[0]), borders)
        for part in WAY:
            z, missing, feed = _newton(_shallower(case, part), borders, z)
    return z, float(missing / feed)


def _shallower(case: Case, part: float) -> Case:
    return eqx.tree_at(lambda c: c.cut.depth, case, case.cut.depth * part)


def _newton(case: Case, borders: tuple[int, ...], z: Orbit) -> tuple[Orbit, float, np.ndarray]:
    """From a motion to the orbit; what is missing there to close [m], and the feed per tooth [m]."""
    at, unravel = ravel_pytree(z)
    steps = 0
    while True:
        missing, basis, h, feed = map(np.asarray, _around(case, borders, unravel(at), jnp.zeros_like(at)))
        size = float(np.abs(missing).max()) if np.isfinite(h).all() else np.inf
        if steps == MOST_STEPS or size < CLOSED * feed or size == np.inf:
            return unravel(at), size, feed
        # (dG/dz - 1) dz = z - G(z), in the least-squares sense.
        target = np.eye(1, len(h))[0] * np.linalg.norm(missing)
        at = at + np.linalg.lstsq(h - np.eye(*h.shape), target)[0] @ basis[:-1]
        steps += 1


def leading_multipliers(case: Case, cuts, borders: tuple[int, ...]) -> np.ndarray:
    """The largest Floquet multiplier of cuts: speeds [rad/s], feed rates [m/s] and depths [m], three arrays of shape (n,).

    The settings of the case count. NaN where no orbit is found, or its multipliers have not converged.
    """
    return np.array([_leading(with_cut(case, *cut), borders) for cut in zip(*cuts, strict=True)])


def _leading(case: Case, borders: tuple[int, ...]) -> complex:
    z, residual = periodic_orbit(case, borders)
    if not residual < CLOSED:
        return complex(np.nan)
    at, _ = ravel_pytree(z)
    # A direction with a part along every eigenvector, the same in every run.
    direction = jnp.asarray(np.random.default_rng(0).normal(size=len(at)), at.dtype)
    return largest(np.asarray(_around(case, borders, z, direction)[2]))
