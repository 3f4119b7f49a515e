"""One block of time steps: the force and the displacement that agree with each other.

Given the surfaces left by earlier passes, the force in each step is a function of the displacement in that same step
(`cutting`), and the displacement follows from the forces by the response of the structure. Fixed-point sweeps, force ->
displacement -> force, solve the two together. The map is strictly causal, so they always converge.
"""

from typing import NamedTuple

import equinox as eqx
import jax
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
    inside: Float[Array, "teeth 1"]
    """Where none can: 1 for a tooth inside all borders, 0 for one in the air."""
    step_angle: float = eqx.field(static=True)


class Solution(NamedTuple):
    """What happens over a block."""

    force: Pair
    """On the tool [N]."""
    thickness: Float[Array, "teeth m"]
    """Mean chip thickness of each tooth [m]."""
    error: Scalar
    """Of the forces that the sweeps leave, estimated: root of the sum of squares over the block [N]."""
    contraction: Scalar
    """By how much the second sweep made the error smaller, or what was expected of it [-]."""


def cutting(process: Process, displacement: Float[Array, "2 m"]) -> tuple[Pair, Float[Array, "teeth m"]]:
    """Mean force on the tool in each step [N], and the mean chip thickness of each tooth [m]."""
    p = process
    gap, rate = thickness(found_paths(p, displacement), p.conditions.width, p.step_angle)

    near, far = (lambda *at, near=near: contact(p, p.conditions, *at, near=near) for near in (True, False))
    met = lax.cond(p.near, near, far, displacement, gap, rate)
    return plane_force(p.angles, met.tangential, met.turn, p.conditions.law.kr, p.conditions.depth), met.thickness


def found_paths(p: Process, displacement: Float[Array, "2 m"]) -> Paths:
    """The paths of the teeth relative to earlier ones; in air, far away from everything."""
    air = jnp.broadcast_to(-p.earlier.commanded.radius, p.angles.cos.shape)
    nothing = tuple((air, jnp.zeros_like(air)) for _ in p.earlier.displacement)
    return lax.cond(p.touching, lambda *at: paths(p.angles, *at), lambda *_: nothing, p.earlier, displacement)


def contact(process: Process, conditions: Conditions, displacement, gap, rate, *, near: bool) -> Contact:
    """What the teeth meet under these conditions, near a border or far from all."""
    law, _, width, borders = conditions
    if not len(borders.before):
        return inside(law, gap, rate, process.step_angle, width)
    if near:
        return crossing(law, borders, displacement, gap, rate, process.step_angle, width, process.near)
    tangential, thickness, turn = inside(law, gap, rate, process.step_angle, width)
    return Contact(tangential * process.inside, thickness * process.inside, turn)


def solve(
    process: Process,
    position: Motion,
    free: Float[Array, "2 m"],
    guess: Pair,
    *,
    contraction: Scalar,
    allowed: Scalar,
    sweeps: int,
) -> Solution:
    """Forces over the block, by sweeps from `guess` until their error [N] is `allowed`, at most `sweeps`.

    `free` is the displacement without a force [m]. A sweep makes the error smaller by `contraction`, or by what the last
    two sweeps show.
    """

    def more(found):
        *_, error, count = found
        return (count < sweeps) & anywhere(error > allowed)

    def sweep(found):
        force, _, before, contraction, error, count = found
        new, chip = cutting(process, free + position.of_force(force).reshape(2, -1))
        change = norm(difference(new, force))
        shown = jnp.where(change < before, change / jnp.where(before > 0, before, 1.0), 1.0)
        left = change * jnp.where(count > 0, shown, contraction)
        # Later sweeps contract more, until they tell about rounding.
        contraction = jnp.where(count == 1, shown, contraction)
        # In a batch, members that are done wait for the others as they are: no result depends on who else is there.
        going = error > allowed
        new, chip, change, contraction, error = jax.tree.map(
            lambda new, old: jnp.where(going, new, old),
            (new, chip, change, contraction, left),
            found[:-1],
        )
        return new, chip, change, contraction, error, count + 1

    nothing = jnp.zeros_like(contraction)
    start = (guess, jnp.zeros_like(process.angles.cos), nothing, contraction, jnp.full_like(nothing, jnp.inf), 0)
    force, chip, _, contraction, error, _ = lax.while_loop(more, sweep, start)
    return Solution(force, chip, error, contraction)


def difference(a: Pair, b: Pair) -> Pair:
    """a - b."""
    return a[0] - b[0], a[1] - b[1]


def product(a: Pair, b: Pair) -> Scalar:
    """Sum of the products over a block."""
    return jnp.vdot(a[0], b[0]) + jnp.vdot(a[1], b[1])


def norm(force: Pair) -> Scalar:
    """Root of the sum of squares over a block."""
    return jnp.sqrt(product(force, force))


@jax.custom_batching.custom_vmap
def anywhere(flag: Bool[Array, ""]) -> Bool[Array, ""]:
    """The flag itself; in a batch, whether any member has it: all then take the same way, and XLA only that one."""
    return flag


@anywhere.def_vmap
def _anywhere_in_batch(size, batched, flags):
    return anywhere(jnp.any(flags)), False  # once more, for batches of batches
