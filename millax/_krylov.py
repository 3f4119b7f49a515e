"""The largest eigenvalues of a linear map from its products with vectors: Arnoldi's method."""

import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float

SPACE = 48
"""Dimension of the Krylov space. The multipliers of a cut fall off fast: most of them are next to 0."""

CONVERGED = 1e-7
"""Residual with which an eigenvalue of order 1 counts as found."""


def arnoldi(linear, start: Float[Array, " N"], size: int) -> tuple[Float[Array, "size+1 N"], Float[Array, "size+1 size"]]:
    """An orthonormal basis V of the Krylov space of a linear map and a vector, and H with `linear`(V[:size]) = H^T V.

    The first row of V is `start` over its norm. Where the space ends before `size`, what remains is 0.
    """

    def extend(k, found):
        basis, h = found
        new = linear(basis[k])
        size_before = jnp.linalg.norm(new)
        # Twice is enough (Kahan, Parlett).
        column = basis @ new
        new = new - column @ basis
        again = basis @ new
        new = new - again @ basis
        length = jnp.linalg.norm(new)
        length = jnp.where(length > 1e-14 * size_before, length, 0.0)
        new = jnp.where(length > 0, new / jnp.where(length > 0, length, 1.0), 0.0)
        return basis.at[k + 1].set(new), h.at[:, k].set(column + again).at[k + 1, k].set(length)

    length = jnp.linalg.norm(start)
    first = start / jnp.where(length > 0, length, 1.0)
    basis = jnp.zeros((size + 1, len(start))).at[0].set(first)
    return lax.fori_loop(0, size, extend, (basis, jnp.zeros((size + 1, size))))


def largest(h: Float[np.ndarray, "k+1 k"]) -> complex:
    """The eigenvalue of largest modulus of a map from its Krylov space; NaN where it has not converged."""
    if not np.isfinite(h).all():
        return complex(np.nan)
    values, vectors = np.linalg.eig(h[:-1])
    at = int(np.argmax(np.abs(values)))
    error = h[-1, -1] * abs(vectors[-1, at])
    return complex(values[at]) if error < CONVERGED * max(1.0, abs(values[at])) else complex(np.nan)
