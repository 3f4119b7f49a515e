"""Semi-discretisation of linear delay equations with periodic coefficients.

    x'(t) = A(t) x(t) + sum_j [ B_j(t) y(t - tau_j) + D_j(t) y'(t - tau_j) ],      y = C x,

all coefficients with period T = L h. In each of the L steps the coefficients are their means over the step, and the earlier
y is the polynomial through its values at `order` + 1 neighbouring ends of steps; the step is then exact (Insperger and
Stepan, Int. J. Numer. Meth. Engng 61, 2004, 117-141; orders above 1: the same authors, Semi-Discretization for Time-Delay
Systems, Springer 2011, ch. 3). Only what is seen later, y, is remembered, not x: the map over a period takes

    z = (x(0), y(-h), ..., y(-H h))   to   (x(T), y(T - h), ..., y(T - H h)).

The solution x = 0 is stable where all eigenvalues of this map, the Floquet multipliers, are inside the unit circle.
"""

import math
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float, Int

from ._check import concrete
from ._types import Scalar

TERMS, HALVINGS = 12, 4
"""Taylor's series of the exponential to this degree, over the step halved so often: exact to rounding up to norms of 8."""


class DelayEquation(NamedTuple):
    """The means of the coefficients over each of L steps of length h, and the delays."""

    present: Float[Array, "L n n"]
    """A [1/s]."""
    earlier: Float[Array, "delays L n q"]
    """B."""
    earlier_rate: Float[Array, "delays L n q"]
    """D."""
    seen: Float[Array, "q n"]
    """C."""
    step: Scalar
    """h [s]."""
    lags: Float[Array | np.ndarray, " delays"]
    """tau_j/h; they need not be whole numbers."""
    longest: float
    """No lag is longer, whatever its value: so much has to be remembered."""


class Steps(NamedTuple):
    """The same, integrated: x after a step is `own` x + sum_jl `by[j, l]` y_(i - r_j + l)."""

    own: Float[Array, "L n n"]
    by: Float[Array, "L delays order+1 n q"]
    seen: Float[Array, "q n"]
    first: Int[Array, " delays"]
    """r_j."""
    remembered: int
    """H."""


def integrated(equation: DelayEquation, order: int = 3) -> Steps:
    """Exact steps under coefficients that are constant within each.

    **Arguments:**

    - `equation`: the coefficients, and the lags, not below `order`/2.
    - `order`: of the polynomials through earlier y, >= 0.

    Raises `ValueError` for a lag that is too short.
    """
    lags = concrete(equation.lags)
    if lags is not None and lags.min() + order / 2 + 1e-9 < order:
        raise ValueError(
            f"lags: {lags.min():g} steps given; with order {order} a delay must be at least {order / 2:g} steps long"
        )
    own, moments = _moments(equation.present, equation.step, order)
    # The polynomial of step i goes through y_(i - r) ... y_(i - r + order).
    first = jnp.floor(lax.stop_gradient(equation.lags) + order / 2 + 1e-9)
    by = []
    for j in range(len(equation.lags)):
        # In step i at time s: y(t - tau) = sum_l y_(i - r + l) sum_p weights[l, p] (s/h)^p.
        weights = _lagrange(order, first[j] - equation.lags[j])
        slopes = jnp.pad(weights[:, 1:] * np.arange(1, order + 1), ((0, 0), (0, 1)))
        whole = jnp.einsum("lp,ptab,tbq->tlaq", weights, moments, equation.earlier[j])
        rate = jnp.einsum("lp,ptab,tbq->tlaq", slopes, moments, equation.earlier_rate[j]) / equation.step
        by.append(whole + rate)
    return Steps(own, jnp.stack(by, axis=1), equation.seen, first.astype(int), _remembered(equation, order))


def _remembered(equation: DelayEquation, order: int) -> int:
    """H: how many earlier y are remembered."""
    return int(equation.longest + order / 2 + 1e-9)


def over_period(steps: Steps, z: Float[Array, "N k"]) -> Float[Array, "N k"]:
    """The map over a period, of k vectors at once."""
    length, delays, points, n, q = steps.by.shape
    history, columns = steps.remembered, z.shape[1]
    x, before = z[:n], z[n:].reshape(history, q, columns)[::-1]
    seen = jnp.einsum("qn,nk->qk", steps.seen, x)
    # y_(i - H) ... y_i in step i, followed by room for what is to come.
    y = jnp.concatenate([before, seen[None], jnp.zeros((length, q, columns), z.dtype)])
    start = history - steps.first

    def step(carry, inputs):
        x, y = carry
        i, own, by = inputs
        x = own @ x
        for j in range(delays):
            part = lax.dynamic_slice_in_dim(y, i + start[j], points)
            x = x + jnp.moveaxis(by[j], 0, 1).reshape(n, points * q) @ part.reshape(points * q, columns)
        y = lax.dynamic_update_index_in_dim(y, steps.seen @ x, i + history + 1, 0)
        return (x, y), None

    (x, y), _ = lax.scan(step, (x, y), (jnp.arange(length), steps.own, steps.by))
    return jnp.concatenate([x, y[length : length + history][::-1].reshape(history * q, columns)])


def monodromy(equation: DelayEquation, order: int = 3) -> Float[Array, "N N"]:
    """The matrix of the map over a period, N = n + q H; arguments as in `integrated`.

    Its eigenvalues are the Floquet multipliers, of which the largest are exact to second order in h, and better where the
    coefficients vary slowly.
    """
    _, n, _ = equation.present.shape
    size = n + len(equation.seen) * _remembered(equation, order)
    return over_period(integrated(equation, order), jnp.eye(size))


def multipliers(matrix: Float[np.ndarray, "N N"]) -> Float[np.ndarray, " k"]:
    """Eigenvalues other than 0, largest modulus first. What no later motion feels is left out before."""
    matrix = np.asarray(matrix)
    felt = matrix.any(axis=0)
    found = np.linalg.eigvals(matrix[np.ix_(felt, felt)]) if felt.any() else np.zeros(1)
    return found[np.argsort(-np.abs(found))]


def leading(matrix: Float[np.ndarray, "N N"]) -> tuple[complex, np.ndarray, np.ndarray]:
    """The largest eigenvalue mu, with right and left eigenvectors scaled so that w^H v = 1: dmu = w^H dPhi v."""
    import scipy.linalg

    values, left, right = scipy.linalg.eig(np.asarray(matrix), left=True, right=True)  # type: ignore[misc]
    largest = int(np.argmax(np.abs(values)))
    v, w = right[:, largest], left[:, largest]
    return complex(values[largest]), v, w / np.conj(w.conj() @ v)


def _moments(a: Float[Array, "L n n"], h: Scalar, order: int) -> tuple[Array, Float[Array, "order+1 L n n"]]:
    """exp(A h), and for p = 0 ... order the integral over s from 0 to h of exp(A (h - s)) (s/h)^p."""
    part = h / 2**HALVINGS
    power = jnp.broadcast_to(jnp.eye(a.shape[-1]), a.shape)
    own, moments = jnp.zeros_like(a), [jnp.zeros_like(a) for _ in range(order + 1)]
    for i in range(TERMS + 1):
        own = own + power / math.factorial(i)
        moments = [m + power * (math.factorial(p) / math.factorial(i + p + 1)) for p, m in enumerate(moments)]
        power = power @ (a * part)
    moments = [part * m for m in moments]
    for _ in range(HALVINGS):
        # The first half of the doubled step goes on through the second one; in that, s/h has grown by 1.
        moments = [(own @ m + sum(math.comb(p, k) * moments[k] for k in range(p + 1))) / 2**p for p, m in enumerate(moments)]
        own = own @ own
    return own, jnp.stack(moments)


def _lagrange(order: int, offset: Scalar) -> Float[Array, "order+1 order+1"]:
    """Coefficients of (s/h)^p in Lagrange's polynomials through 0 ... `order`, as functions of s/h + `offset`."""
    weights = []
    for at in range(order + 1):
        polynomial = [jnp.ones_like(offset)]
        for other in range(order + 1):
            if other != at:  # times (s/h + offset - other)/(at - other)
                same = [c * (offset - other) / (at - other) for c in polynomial] + [jnp.zeros_like(offset)]
                higher = [jnp.zeros_like(offset)] + [c / (at - other) for c in polynomial]
                polynomial = [a + b for a, b in zip(same, higher, strict=True)]
        weights.append(jnp.stack(polynomial))
    return jnp.stack(weights)


def mean_over_steps(function, period: float, length: int, points: int = 8):
    """Means of a function of time over each of `length` steps of a period, by Gauss's rule: shape (length, ...)."""
    nodes, weights = np.polynomial.legendre.leggauss(points)
    h = period / length
    times = h * (np.arange(length)[:, None] + (nodes + 1) / 2)
    values = jax.vmap(jax.vmap(function))(jnp.asarray(times))
    return jnp.tensordot(weights / 2, values, axes=(0, 1))
