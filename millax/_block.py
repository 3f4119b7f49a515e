"""One block of time steps: the force and the displacement that agree with each other.

Given the surfaces left by earlier passes, the force in each step is a function of the displacement in that same step
(`cutting`), and the displacement follows from the forces by the response of the structure. Fixed-point sweeps, force ->
displacement -> force, solve the two together. The map is strictly causal, so they always converge.
"""

from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float

from ._chip import Angles, Earlier, Paths, paths, thickness
from ._contact import Borders, Contact, crossing, inside, plane_force
from ._forces import ForceLaw
from ._response import Motion
from ._types import Scalar

Pair = tuple[Float[Array, " m"], Float[Array, " m"]]
"""Force along x and y in each step. Kept apart: joined in one array, XLA computes them in a loop it cannot vectorise."""


class Conditions(NamedTuple):
    """What the force on a tooth depends on beside its path."""

    law: ForceLaw
    depth: Scalar
    width: Scalar
    borders: Borders


class Process(eqx.Module):
    """Everything that turns the tool's displacement in a block into the cutting force."""

    angles: Angles
    earlier: Earlier
    conditions: Conditions
    touching: Bool[Array, ""]
    """Whether a tooth may meet the stock in this block at all. Where none can, no paths are computed."""
    near: Bool[Array, ""]
    """Whether a tooth may meet a border. Where none can, that part of the model is left out."""
    step_angle: float = eqx.field(static=True)


class Guess(NamedTuple):
    """Forces over a block [N], and what of the displacement they make [m]."""

    force: Pair
    forced: Float[Array, " 2*m"]


class Solution(NamedTuple):
    """What happens over a block."""

    end: Guess
    """The forces."""
    displacement: Float[Array, "2 m"]
    """The tool's displacement that they make [m]."""
    thickness: Float[Array, "teeth m"]
    """Mean chip thickness of each tooth [m]."""
    changes: tuple[Scalar, Scalar]
    """Of the forces, in the last sweep but one and in the last: root of the sum of squares over the block [N]."""


def cutting(process: Process, displacement: Float[Array, "2 m"]) -> tuple[Pair, Float[Array, "teeth m"]]:
    """Mean force on the tool in each step [N], and the mean chip thickness of each tooth [m]."""
    p = process
    gap, rate = thickness(found_paths(p, displacement), p.conditions.width, p.step_angle)

    def met_if(near: bool):
        return lambda displacement, gap, rate: contact(p.conditions, displacement, gap, rate, p.step_angle, near=near)

    met = lax.cond(p.near, met_if(True), met_if(False), displacement, gap, rate)
    return plane_force(p.angles, met.tangential, met.turn, p.conditions.law.kr, p.conditions.depth), met.thickness


def found_paths(p: Process, displacement: Float[Array, "2 m"]) -> Paths:
    """The paths of the teeth relative to earlier ones; in air, far away from everything."""
    # Beside the work it saves, the condition makes XLA store the paths, instead of computing them anew in each of the
    # kernels that use them.
    air = jnp.broadcast_to(-p.earlier.radius, p.angles.cos.shape)
    nothing = tuple((air, jnp.zeros_like(air)) for _ in p.earlier.displacement)
    return lax.cond(p.touching, lambda *at: paths(p.angles, *at), lambda *_: nothing, p.earlier, displacement)


def contact(conditions: Conditions, displacement, gap, rate, step_angle: float, *, near: bool) -> Contact:
    """What the teeth meet, near a border or far from all."""
    law, _, width, borders = conditions
    if near and len(borders.before):
        return crossing(law, borders, displacement, gap, rate, step_angle, width)
    return inside(law, gap, rate, step_angle, width)


def solve(process: Process, position: Motion, state: Float[Array, " states"], guess: Guess, *, sweeps: int) -> Solution:
    """Forces and displacements over the block after `sweeps` sweeps from `guess`."""
    free = position.of_state(state)

    def sweep(last: Guess):
        force, chip = cutting(process, (free + last.forced).reshape(2, -1))
        squares = sum(jnp.vdot(new - old, new - old) for new, old in zip(force, last.force, strict=True))
        return Guess(force, position.of_force(force)), chip, jnp.sqrt(squares)

    guess = repeat(lambda guess: sweep(guess)[0], guess, sweeps - 2)
    guess, chip, before = sweep(guess)
    change = before
    if sweeps > 1:
        guess, chip, change = sweep(guess)
    return Solution(guess, (free + guess.forced).reshape(2, -1), chip, (before, change))


def repeat(sweep, start, times: int):
    """`sweep` applied `times` times, none where that is negative."""
    # Unrolled while short: XLA runs straight code faster than a loop, and compiles a long loop faster.
    if times > 6:
        return lax.scan(lambda carry, _: (sweep(carry), None), start, length=times)[0]
    for _ in range(times):
        start = sweep(start)
    return start
