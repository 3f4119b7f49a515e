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
from ._contact import Borders, Contact, crossing, force_on_tool, fully_inside
from ._forces import ForceLaw
from ._response import Motion
from ._types import Scalar

Forces = tuple[Float[Array, " m"], ...]
"""Force along x, y and, where the law has an axial force, z in each step. Kept apart: joined in one array, XLA computes them
in a loop it cannot vectorise."""


class Conditions(NamedTuple):
    """What the force on a tooth depends on beside its path and the borders."""

    law: ForceLaw
    depth: Scalar
    """Of a slice [m]."""
    width: Scalar
    damping: Scalar | None = None
    """Process damping: radial force over the velocity, per unit of depth [N s/m²]; None for none."""


class Slice(NamedTuple):
    """A slice of the tool, straight-fluted: what makes it different from the others."""

    angles: Angles
    excess: Float[Array, "passes teeth 1"] | None
    """See `Commanded`."""
    borders: Borders


class Process(eqx.Module):
    """Everything that turns the tool's displacement in a block into the cutting force."""

    slices: Slice
    """All slices of the tool, along the first axis."""
    earlier: Earlier
    """Without the excess, which is the slices' own."""
    conditions: Conditions
    inside: Float[Array, "slices teeth 1"]
    """Where no tooth may meet a border: 1 for a tooth inside all borders, 0 for one in the air."""
    touching: Bool[Array, ""]
    """Whether a tooth may meet the stock in this block at all. Where none can, no paths are computed."""
    near: Bool[Array, ""]
    """Whether a tooth may meet a border. Where none can, that part of the model is left out."""
    step_angle: float = eqx.field(static=True)


class Solution(NamedTuple):
    """What happens over a block."""

    force: Forces
    """On the tool [N]."""
    thickness: Float[Array, "teeth m"]
    """Mean chip thickness of each tooth [m]."""
    error: Scalar
    """Of the forces that the sweeps leave, estimated: root of the sum of squares over the block [N]."""
    contraction: Scalar
    """By how much the second sweep made the error smaller, or what was expected of it [-]."""


def cutting(process: Process, motion: Float[Array, "felt m"]) -> tuple[Forces, Float[Array, "teeth m"]]:
    """Mean force on the tool in each step [N], and the mean chip thickness of each tooth [m], over all slices.

    `motion` is what the force feels: the displacement, x and y [m], and with process damping the velocity too [m/s].
    """
    p = process
    displacement, velocity = motion[:2], tuple(motion[2:])

    def of_slice(own, inside):
        gap, rate = thickness(found_paths(p, own, displacement), p.conditions.width, p.step_angle)
        near, far = (lambda *at, near=near: contact(p, own, inside, p.conditions, *at, near=near) for near in (True, False))
        met = lax.cond(p.near, near, far, displacement, gap, rate)
        law, depth, _, damping = p.conditions
        forces = force_on_tool(own.angles, met.tangential, met.engaged, met.turn, law, depth, velocity, damping)
        return forces, met.thickness

    forces, found = of_slices(of_slice, p.slices, p.inside)
    return tuple(added(force) for force in forces), added(found) / len(found)


def of_slices(function, *slices):
    """`function` of every slice, its results along the first axis: a helical tool is a stack of straight ones."""
    if len(jax.tree.leaves(slices)[0]) == 1:
        return jax.tree.map(lambda x: x[None], function(*jax.tree.map(lambda x: x[0], slices)))
    return jax.vmap(function)(*slices)


def added(x: Float[Array, "slices ..."]) -> Float[Array, "..."]:
    """Sum over the slices."""
    return x[0] if len(x) == 1 else jnp.sum(x, axis=0)


def found_paths(p: Process, own: Slice, displacement: Float[Array, "2 m"]) -> Paths:
    """The paths of the teeth relative to earlier ones; in air, far away from everything."""
    air = jnp.broadcast_to(-p.earlier.commanded.radius, own.angles.cos.shape)
    nothing = tuple((air, jnp.zeros_like(air)) for _ in p.earlier.displacement)
    earlier = p.earlier._replace(commanded=p.earlier.commanded._replace(excess=own.excess))
    return lax.cond(p.touching, paths, lambda *_: nothing, own.angles, earlier, displacement)


def contact(p: Process, own: Slice, inside, conditions: Conditions, displacement, gap, rate, *, near: bool) -> Contact:
    """What the teeth of a slice meet under these conditions, near a border or far from all."""
    law, width = conditions.law, conditions.width
    if len(own.borders.before) and near:
        return crossing(law, own.borders, displacement, gap, rate, p.step_angle, width, p.near)
    met = fully_inside(law, gap, rate, p.step_angle, width)
    if not len(own.borders.before):
        return met
    engaged = None if met.engaged is None else met.engaged * inside
    return Contact(met.tangential * inside, engaged, jnp.zeros_like(gap), met.thickness * inside)


def solve(
    process: Process,
    felt: Motion,
    free: Float[Array, "felt m"],
    guess: Forces,
    *,
    contraction: Scalar,
    allowed: Scalar,
    sweeps: int,
) -> Solution:
    """Forces over the block, by sweeps from `guess` until their error [N] is `allowed`, at most `sweeps`.

    `felt` is the motion that the forces feel, by the forces, and `free` that without any, as in `cutting`. A sweep makes the
    error smaller by `contraction`, or by what the last two sweeps show.
    """

    def more(found):
        *_, error, count = found
        return (count < sweeps) & anywhere(error > allowed)

    def sweep(found):
        force, _, before, contraction, error, count = found
        new, chip = cutting(process, free + felt.of_force(force).reshape(free.shape))
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
    start = (guess, jnp.zeros_like(process.slices.angles.cos[0]), nothing, contraction, jnp.full_like(nothing, jnp.inf), 0)
    force, chip, _, contraction, error, _ = lax.while_loop(more, sweep, start)
    return Solution(force, chip, error, contraction)


def difference(a: Forces, b: Forces) -> Forces:
    """a - b."""
    return tuple(x - y for x, y in zip(a, b, strict=True))


def product(a: Forces, b: Forces) -> Scalar:
    """Sum of the products over a block."""
    first, *others = (jnp.vdot(x, y) for x, y in zip(a, b, strict=True))
    return sum(others, first)


def norm(force: Forces) -> Scalar:
    """Root of the sum of squares over a block."""
    return jnp.sqrt(product(force, force))


@jax.custom_batching.custom_vmap
def anywhere(flag: Bool[Array, ""]) -> Bool[Array, ""]:
    """The flag itself; in a batch, whether any member has it: all then take the same way, and XLA only that one."""
    return flag


@anywhere.def_vmap
def _anywhere_in_batch(size, batched, flags):
    return anywhere(jnp.any(flags)), False  # once more, for batches of batches
