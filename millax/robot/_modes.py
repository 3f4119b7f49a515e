"""Natural frequencies, mode shapes and modal damping of M x'' + K x = 0."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._types import Matrix, as_number

SAME = 1e-6
"""Eigenvalues that differ by less than this part of the largest count as one, in derivatives."""


class Modes(NamedTuple):
    """Natural frequencies [Hz] in ascending order, shape (n,), and mode shapes as columns, (n, n), with
    shapes^T M shapes = 1."""

    frequency: Float[Array, " n"]
    shapes: Float[Array, "n n"]


def modes(mass: Matrix, stiffness: Matrix) -> Modes:
    """Solutions of det(w² M - K) = 0 (E 21), f = w/(2 pi).

    **Arguments:**

    - `mass`: M, symmetric and positive definite.
    - `stiffness`: K. A moment that keeps its direction makes it slightly unsymmetric: its symmetric part counts.

    A frequency is NaN where the stiffness is negative: the structure does not hold.
    """
    root, standard = _standard(mass, stiffness)
    square, vectors = jnp.linalg.eigh(standard)
    shapes = jax.scipy.linalg.solve_triangular(root.T, vectors, lower=False)
    return Modes(jnp.sqrt(square) / (2 * jnp.pi), shapes)


def modal_damping(mass: Matrix, stiffness: Matrix, ratio: Float[Array, "..."]) -> Matrix:
    """C = M shapes diag(2 zeta_l w_l) shapes^T M: every mode has its own damping ratio.

    **Arguments:**

    - `mass`, `stiffness`: as of `modes`.
    - `ratio`: zeta [-], one number for all modes, or one per mode in the order of their frequencies.

    With one number for all, differentiable also where two modes have the same frequency.
    """
    root, standard = _standard(mass, stiffness)
    ratio = jnp.broadcast_to(as_number(ratio), (len(mass),))
    return root @ _rate(standard, ratio) @ root.T


def _standard(mass: Matrix, stiffness: Matrix) -> tuple[Matrix, Matrix]:
    """L with M = L L^T, and L^-1 K L^-T."""
    root = jnp.linalg.cholesky((mass + mass.T) / 2)
    half = jax.scipy.linalg.solve_triangular(root, (stiffness + stiffness.T) / 2, lower=True)
    standard = jax.scipy.linalg.solve_triangular(root, half.T, lower=True)
    return root, (standard + standard.T) / 2


@jax.custom_jvp
def _rate(a: Matrix, ratio: Float[Array, " n"]) -> Matrix:
    """V diag(2 zeta sqrt(lambda)) V^T with a = V diag(lambda) V^T."""
    value, vectors = jnp.linalg.eigh(a)
    return vectors @ jnp.diag(2 * ratio * jnp.sqrt(value)) @ vectors.T


@_rate.defjvp
def _rate_jvp(primals, tangents):
    """Daleckii and Krein: divided differences of 2 zeta sqrt(lambda), where eigenvalues coincide its derivative. The
    eigenvectors themselves have none there."""
    (a, ratio), (da, dratio) = primals, tangents
    value, vectors = jnp.linalg.eigh(a)
    rate = 2 * ratio * jnp.sqrt(value)
    change = vectors.T @ da @ vectors
    gap = value[:, None] - value
    same = jnp.abs(gap) <= SAME * jnp.max(jnp.abs(value))
    slope = (ratio[:, None] + ratio) / (jnp.sqrt(value)[:, None] + jnp.sqrt(value))
    divided = jnp.where(same, slope, (rate[:, None] - rate) / jnp.where(same, 1.0, gap))
    inner = divided * change + jnp.diag(2 * dratio * jnp.sqrt(value))
    return vectors @ jnp.diag(rate) @ vectors.T, vectors @ inner @ vectors.T


def combination(names: tuple[str, ...], direction: Float[np.ndarray, " n"]) -> str:
    """The joints that take a considerable part in a motion: "joint_4 and joint_6"."""
    part = np.abs(direction) > 0.1 * np.abs(direction).max()
    *first, last = np.array(names)[part]
    return f"{', '.join(first)} and {last}" if first else str(last)
