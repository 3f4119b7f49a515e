"""The exact response of a linear structure over a block of time steps, as matrices."""

from typing import NamedTuple

import jax.numpy as jnp
import jax.scipy.linalg
import numpy as np
from jaxtyping import Array, Float

from ._structure import Structure
from ._types import Scalar


class BlockResponse(NamedTuple):
    """Motion over a block of m steps = `free` @ (state at its start) + `forced` @ (mean force in each step).

    The state is (q, dt q'): with the velocity scaled by the step, all its entries have one unit and the exponentials are
    well conditioned. Position and velocity are those of the tool in the plane at the middle of each step; forces are the
    in-plane forces on the tool, constant within a step. Indices: a axis (x, y), j step, s state, l step of the force.
    """

    free_position: Float[Array, "2 m states"]
    forced_position: Float[Array, "2 m 2 m"]
    free_velocity: Float[Array, "2 m states"]
    forced_velocity: Float[Array, "2 m 2 m"]
    free_end: Float[Array, "states states"]
    forced_end: Float[Array, "states 2 m"]
    free_axes: Float[Array, "axes m states"]
    forced_axes: Float[Array, "axes m 2 m"]


def block_response(structure: Structure, dt: Scalar, steps: int) -> BlockResponse:
    """The response of `structure` over `steps` steps of length `dt` [s], from the matrix exponential."""
    n = structure.coordinates
    half_transition, half_input = _discretise(structure, dt / 2, dt)
    transition = half_transition @ half_transition
    step_input = half_transition @ half_input + half_input
    # powers[j] = transition^j, by doubling: log2(m) small products instead of a loop of m.
    powers = jnp.eye(2 * n)[None]
    while len(powers) <= steps:
        powers = jnp.concatenate([powers, powers @ (powers[-1] @ transition)])

    to_middle = half_transition @ powers[:steps]
    # A force in step l acts on the middle of step j > l through (j - l - 1) whole steps and the half step before it.
    lagged = jnp.concatenate([half_input[None], to_middle[:-1] @ step_input])
    lag = np.arange(steps)[:, None] - np.arange(steps)[None, :]
    causal = jnp.asarray(lag >= 0)[:, :, None, None]
    forced = jnp.where(causal, lagged[np.maximum(lag, 0)], 0.0)  # (j, l, state, force axis)

    def observed(rows):
        return jnp.einsum("as,jst->ajt", rows, to_middle), jnp.einsum("as,jlsb->ajbl", rows, forced)

    zero = jnp.zeros((2, n))
    position = jnp.concatenate([structure.in_plane_shapes, zero], axis=1)
    velocity = jnp.concatenate([zero, structure.in_plane_shapes / dt], axis=1)
    axes = jnp.concatenate([structure.shapes, jnp.zeros_like(structure.shapes)], axis=1)
    forced_end = jnp.einsum("lst,tb->sbl", powers[:steps][::-1], step_input)
    return BlockResponse(*observed(position), *observed(velocity), powers[steps], forced_end, *observed(axes))


def _discretise(structure: Structure, duration: Scalar, dt: Scalar):
    """Transition and input matrices over `duration` under a constant in-plane force: exact (van Loan's block matrix)."""
    n = structure.coordinates
    terms = jnp.concatenate(
        [-structure.stiffness_matrix * dt, -structure.damping_matrix, structure.in_plane_shapes.T * dt], axis=1
    )
    acceleration = jnp.linalg.solve(structure.mass_matrix, terms)
    rates = jnp.block(
        [
            [jnp.zeros((n, n)), jnp.eye(n) / dt, jnp.zeros((n, 2))],
            [acceleration],
            [jnp.zeros((2, 2 * n + 2))],
        ]
    )
    exponential = jax.scipy.linalg.expm(rates * duration)
    return exponential[: 2 * n, : 2 * n], exponential[: 2 * n, 2 * n :]
