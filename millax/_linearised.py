"""The linearised cut: structure and process matrices as one delay equation, and its Floquet multipliers.

    M q'' + C q' + K q = S^T [ P_0(t) u(t) + V_0(t) u'(t) + sum_j ( P_j(t) u(t - tau_j) + V_j(t) u'(t - tau_j) ) ],  u = S q.

With equal teeth there is one delay, of one tooth period, which is the period of the coefficients too. Teeth of unequal radii
look back several tooth periods, and where they are not equally spaced each one has delays of its own; the period then is a
turn. The process matrices are derivatives of the engine's force (`_steady.process_matrices`), the equation is solved by
semi-discretisation (`_semidiscretisation`). With x = (q, dt q') all entries of the state have one unit.
"""

import math

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ._case import Case
from ._krylov import SPACE, arnoldi, largest
from ._semidiscretisation import DelayEquation, leading, monodromy, multipliers, over_period
from ._semidiscretisation import integrated as integrate
from ._settings import fastest_rate
from ._steady import looped, one_by_one, process_matrices, seen, steady, with_cut

ORDER = 3
"""Of the polynomials through earlier displacements."""

STEPS = (80, 120, 160, 240, 320, 480, 640)
"""Resolutions to choose from: a few, since each is compiled."""

PER_VIBRATION = 12
"""Fewest steps per period of the fastest mode. With these, and polynomials of order 3, limits are good to 0.5 %."""


def resolution(case: Case, fewest: int = 80) -> int:
    """Steps per tooth period that resolve the teeth and the structure."""
    s = case.at_tool
    fastest = float(fastest_rate(s.mass_matrix, s.damping_matrix, s.stiffness_matrix))
    needed = max(fewest, PER_VIBRATION * fastest * float(case.cut.tooth_period(case.tool)) / (2 * math.pi))
    enough = [steps for steps in STEPS if steps >= needed]
    if not enough:
        raise ValueError(
            f"structure: its fastest mode ({fastest / (2 * math.pi):.4g} Hz) swings {needed / PER_VIBRATION:.0f} times in a "
            f"tooth period, more than the {STEPS[-1] // PER_VIBRATION} that are resolved. Leave out modes far above the "
            "frequency of chatter, or raise cut.spindle_speed"
        )
    return enough[0]


def delay_equation(case: Case, steps: int) -> DelayEquation:
    """Of a steady case, with `steps` steps in a tooth period."""
    structure = case.at_tool
    n = structure.coordinates
    process = process_matrices(case, steps)
    dt = case.cut.tooth_period(case.tool) / steps
    shapes = structure.in_plane_shapes
    directions = list(seen(case))

    def accelerated(force):
        """The lower half of the equation, in which the force on the coordinates acts."""
        lower = dt * jnp.linalg.solve(structure.mass_matrix, force)
        return jnp.concatenate([jnp.zeros_like(lower), lower], axis=-2)

    def on_coordinates(matrices):
        return jnp.einsum("ia,tij,jb->tab", shapes, matrices, shapes)

    moving = jnp.zeros((2 * n, n)).at[:n].set(jnp.eye(n) / dt)
    stiffness = accelerated(on_coordinates(process.now) - structure.stiffness_matrix)
    damping = moving + accelerated((on_coordinates(process.now_rate) - structure.damping_matrix) / dt)
    present = jnp.concatenate([stiffness, damping], axis=-1)

    def earlier(matrices):
        return accelerated(jnp.einsum("ia,ktij->ktaj", shapes, matrices))[..., directions]

    return DelayEquation(
        present,
        earlier(process.earlier),
        earlier(process.earlier_rate),
        jnp.concatenate([shapes, jnp.zeros_like(shapes)], axis=1)[jnp.array(directions, dtype=int)],
        dt,
        process.lags,
        process.longest,
    )


def _matrix(case: Case, borders: tuple[int, ...], steps: int) -> Float[Array, "N N"]:
    """Of the map over a period."""
    return monodromy(delay_equation(steady(case, borders), steps), ORDER)


@eqx.filter_jit
def _spaces(case: Case, cuts, count, borders: tuple[int, ...], steps: int):
    def of(*cut):
        matrix = _matrix(with_cut(case, *cut), borders, steps)
        start = jnp.asarray(np.random.default_rng(0).normal(size=len(matrix)), matrix.dtype)
        return arnoldi(lambda x: matrix @ x, start, min(SPACE, len(matrix)))[1]

    return looped(of, cuts, count)


@eqx.filter_jit
def _matrix_of(case: Case, borders: tuple[int, ...], steps: int) -> Array:
    return _matrix(case, borders, steps)


def leading_multipliers(case: Case, cuts, borders: tuple[int, ...], steps: int) -> np.ndarray:
    """The largest Floquet multiplier of cuts: speeds [rad/s], feed rates [m/s], depths [m], three arrays of shape (n,)."""
    spaces = one_by_one(lambda cuts, count: _spaces(case, cuts, count, borders, steps), cuts)
    found = np.array([largest(space) for space in spaces])
    for i in np.flatnonzero(~np.isfinite(found)):
        matrix = np.asarray(_matrix_of(with_cut(case, *(x[i] for x in cuts)), borders, steps))
        found[i] = multipliers(matrix)[0] if np.isfinite(matrix).all() else np.nan
    return found


def radius_and_gradient(case: Case, borders: tuple[int, ...], steps: int) -> tuple[float, Case]:
    """Spectral radius of the map over a period, and its derivatives by every number of the case.

    dmu = w^H dPhi v with the eigenvectors of the multiplier mu, so the gradient is that of a scalar: Phi v costs one run
    through the period.
    """
    mu, v, w = leading(np.asarray(_matrix_of(case, borders, steps)))
    # d abs(mu) = Re(conj(mu)/abs(mu) dmu)
    w = w * (mu / abs(mu) if mu else 1.0)
    gradient = _gradient(case, _columns(v), _columns(w), borders, steps)
    return abs(mu), gradient


def _columns(x) -> Float[Array, "N 2"]:
    return jnp.asarray(np.stack([np.real(x), np.imag(x)], axis=1))


@eqx.filter_jit
def _gradient(case: Case, v, w, borders: tuple[int, ...], steps: int) -> Case:
    def projected(case):
        steps_of = integrate(delay_equation(steady(case, borders), steps), ORDER)
        return jnp.sum(w * over_period(steps_of, v))  # Re(w^H Phi v)

    return eqx.filter_grad(projected)(case)
