"""The exact response of a linear structure over a block of time steps, as matrices."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ._einsum import einsum
from ._structure import Structure
from ._types import AXES, Scalar


class Motion(NamedTuple):
    """One motion over a block of m steps, from the state at its start and the mean force in each step.

    Its columns are quantities and steps in one: matrices that XLA multiplies as they are.
    """

    free: Float[Array, "states columns"]
    by: tuple[Float[Array, "m columns"], ...]
    """By the force along x, along y and, where there is one, along z."""

    def __call__(self, state: Float[Array, " states"], force: tuple[Float[Array, " m"], ...]) -> Array:
        return self.of_state(state) + self.of_force(force)

    def of_state(self, state: Float[Array, " states"]) -> Float[Array, " columns"]:
        """The motion without a force."""
        return einsum("k,kc->c", state, self.free)

    def of_force(self, force: tuple[Float[Array, " m"], ...]) -> Float[Array, " columns"]:
        """The motion that starts from rest."""
        first, *others = (einsum("k,kc->c", along, by) for along, by in zip(force, self.by, strict=True))
        return sum(others, first)


class BlockResponse(NamedTuple):
    """The motions of the tool that follow from the force over a block.

    The state is (q, dt q'): with the velocity scaled by the step, all its entries have one unit. Positions and velocities
    are those at the middle of each step.
    """

    felt: Motion
    """What the force feels: the position in the plane, (x, y) by steps [m], and with process damping the velocity [m/s]."""
    motion: Motion
    """Position and velocity in the plane, and the state after the block: see `parted`."""
    axes: Motion
    """Position along the axes of the structure, axes by steps [m]."""

    @property
    def feels(self) -> int:
        """How many motions the force feels: 2 or 4."""
        return self.felt.free.shape[1] // len(self.felt.by[0])

    def to_one_step(self) -> Float[Array, "2 felt m"]:
        """As `response_to_one_step`."""
        return jnp.stack([self._by_steps(by[0]) for by in self.felt.by[:2]])

    def felt_in(self, columns: Float[Array, " columns"]) -> Float[Array, "felt m"]:
        """What the force feels of the columns of `motion`."""
        return self._by_steps(columns[: self.felt.free.shape[1]])

    def _by_steps(self, columns):
        return columns.reshape(-1, len(self.felt.by[0]))

    def parted(self, columns: Float[Array, " columns"]) -> tuple[Array, Array, Array]:
        """The columns of `motion`: position and velocity, each of shape (2, m), and the state after the block."""
        plane = 2 * len(self.motion.by[0])
        position, velocity, end, _ = jnp.split(columns, [plane, 2 * plane, 2 * plane + len(self.motion.free)])
        return position.reshape(2, -1), velocity.reshape(2, -1), end


def block_response(structure: Structure, dt: Scalar, steps: int, forces: int = 2, felt: int = 2) -> BlockResponse:
    """The response of `structure` over `steps` steps of length `dt` [s] to so many forces, along x, y and z; from the matrix
    exponential. The forces feel the position in the plane (`felt` is 2), or the velocity too (4)."""
    n = structure.coordinates
    powers, to_middle, lagged, step_input = _after_steps(structure, dt, steps, forces)
    lag = np.arange(steps)[:, None] - np.arange(steps)[None, :]
    forced = jnp.where((lag >= 0)[:, :, None, None], lagged[np.maximum(lag, 0)], 0.0)  # (step, step of force, state, force)

    def observed(rows):
        free = jnp.einsum("as,jst->taj", rows, to_middle).reshape(2 * n, len(rows) * steps)
        by = jnp.einsum("as,jlsb->blaj", rows, forced).reshape(forces, steps, len(rows) * steps)
        return Motion(free, tuple(by))

    still = jnp.zeros((2, n))
    position = observed(jnp.concatenate([structure.in_plane_shapes, still], axis=1))
    velocity = observed(jnp.concatenate([still, structure.in_plane_shapes / dt], axis=1))
    end = Motion(powers[steps].T, tuple(jnp.einsum("lst,tb->bls", powers[:steps][::-1], step_input)))
    return BlockResponse(
        position if felt == 2 else jax.tree.map(lambda *parts: jnp.concatenate(parts, axis=1), position, velocity),
        motion=jax.tree.map(lambda *parts: _side_by_side(parts), position, velocity, end),
        axes=observed(jnp.concatenate([structure.shapes, jnp.zeros_like(structure.shapes)], axis=1)),
    )


def response_to_one_step(structure: Structure, dt: Scalar, steps: int) -> Float[Array, "2 4 steps"]:
    """Position (x, y) [m] and velocity [m/s] in the middle of each step, after 1 N along x, or y, in the first one."""
    _, _, lagged, _ = _after_steps(structure, dt, steps, 2)
    n, shapes = structure.coordinates, structure.in_plane_shapes
    position, travel = (jnp.einsum("as,jsb->baj", shapes, seen) for seen in (lagged[:, :n], lagged[:, n:]))
    return jnp.concatenate([position, travel / dt], axis=1)


def _after_steps(structure: Structure, dt: Scalar, steps: int, forces: int):
    """The state after 0 ... `steps` steps and in the middle of each, from the state at the start; in the middle of each
    after a force in the first one, and at the end of a step with a force."""
    n = structure.coordinates
    half_transition, half_input = _discretise(structure, dt / 2, dt, forces)
    transition = half_transition @ half_transition
    step_input = half_transition @ half_input + half_input
    # powers[j] = transition^j, by doubling: log2(m) small products instead of a loop of m.
    powers = jnp.eye(2 * n)[None]
    while len(powers) <= steps:
        powers = jnp.concatenate([powers, powers @ (powers[-1] @ transition)])
    to_middle = half_transition @ powers[:steps]
    # A force in step l acts on the middle of step j > l through the rest of its own step, j - l - 1 whole ones and a half.
    lagged = jnp.concatenate([half_input[None], to_middle[:-1] @ step_input])
    return powers, to_middle, lagged, step_input


def _side_by_side(parts) -> Array:
    """Matrices with the same rows as one. XLA multiplies eight columns at once and what remains one by one: filled up."""
    columns = sum(part.shape[1] for part in parts)
    return jnp.concatenate([*parts, jnp.zeros((len(parts[0]), -columns % 8))], axis=1)


def _discretise(structure: Structure, duration: Scalar, dt: Scalar, forces: int):
    """Transition and input matrices over `duration` under a constant force: exact (van Loan's block matrix)."""
    n = structure.coordinates
    terms = jnp.concatenate(
        [-structure.stiffness_matrix * dt, -structure.damping_matrix, structure.shapes_along(AXES[:forces]).T * dt], axis=1
    )
    acceleration = jnp.linalg.solve(structure.mass_matrix, terms)
    rates = jnp.block(
        [
            [jnp.zeros((n, n)), jnp.eye(n) / dt, jnp.zeros((n, forces))],
            [acceleration],
            [jnp.zeros((forces, 2 * n + forces))],
        ]
    )
    change = _exponential_minus_one(rates * duration)
    return jnp.eye(2 * n) + change[: 2 * n, : 2 * n], change[: 2 * n, 2 * n :]


def _exponential_minus_one(a: Array) -> Array:
    """exp(a) - 1, to rounding for norms up to 8, far beyond any step that resolves the motion.

    Taylor's series to degree 12 of a/16, squared four times. Without the 1, which would drown the small change that a slow
    mode makes in a step. A general routine has to choose its degree by the norm, and costs more to compile than all the
    rest of the simulation.
    """
    identity = jnp.eye(len(a), dtype=a.dtype)
    result = jnp.zeros_like(a)
    for k in range(12, 0, -1):
        result = (a / (16 * k)) @ (identity + result)
    for _ in range(4):
        result = 2 * result + result @ result
    return result
