"""Earlier motions of the tool where the teeth are not equally spaced.

A tooth cuts what another one has left a pitch angle earlier, and that is no whole number of time steps. The displacement
is then that of the cubic through displacement and velocity of the two samples around it (Hermite), the velocity its
derivative.
"""

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float

from ._types import Scalar


def earlier_motion(
    displacement: Float[Array, "spans 2 m"],
    velocity: Float[Array, "spans 2 m"],
    lag: Float[Array, "passes teeth"],
    dt: Scalar,
) -> tuple[Float[Array, "passes 2 teeth m"], Float[Array, "passes 2 teeth m"]]:
    """Displacement [m] and velocity [m/s] of the tool `lag` steps of length `dt` before each of the next m steps.

    `displacement` and `velocity` are those of the last `spans` times m steps, the newest in front. The lag is at least m and
    at most as long as these; where it is shorter, what it asks for is not known yet, and NaN.
    """
    spans, _, m = displacement.shape
    length = spans * m

    def in_order(x):
        x = jnp.moveaxis(x[::-1], 0, 1).reshape(2, length)
        return jnp.concatenate([x, x[:, -1:]], axis=1)  # so that a lag of m steps, and no part of one, has a next sample

    samples = jnp.stack([in_order(displacement), in_order(velocity) * dt])
    lag = jnp.where(lag > m - 1e-3, jnp.minimum(lag, length), jnp.nan)
    whole = jnp.ceil(lax.stop_gradient(lag))

    def of(first, s):
        u, step = lax.dynamic_slice_in_dim(samples, first, m + 1, axis=2)
        (u, ahead), (begin, end) = (u[:, :-1], u[:, 1:]), (step[:, :-1], step[:, 1:])
        curved, twisted = 3 * (ahead - u) - 2 * begin - end, begin + end - 2 * (ahead - u)
        return u + s * (begin + s * (curved + s * twisted)), (begin + s * (2 * curved + s * 3 * twisted)) / dt

    return jax.vmap(jax.vmap(of, out_axes=1), out_axes=0)(length - whole.astype(int), whole - lag)
