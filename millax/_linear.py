"""One block of time steps, linearised: how force and displacement change together.

At the solution f = F(u, past, p), and u = u(f, p). So df = F_p dp + F_past dpast + F_u (du + G df), with du the change of
the displacement at a fixed force and G the response within the block. Steps do not feel each other in F, so F has one
derivative for each step and input. The chain rule is spelt out, from the forces back to the paths of the teeth, and the
links are stored; what a tooth meets is differentiated automatically. Until it is stored, everything stays apart, each force
and each axis: joined in one array, XLA computes them in loops that it cannot vectorise.
"""

import functools
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float

from ._block import Conditions, Process, Slice, added, contact, found_paths, of_slices
from ._chip import Angles, Choice, Commanded, Paths, choices, least_so_far, passes, passes_by
from ._contact import force_on_tool
from ._einsum import einsum
from ._math import stored, summed
from ._response import Motion


class Others(NamedTuple):
    """What the forces depend on beside the displacements of the tool."""

    slices: Slice
    commanded: Commanded
    """Without the excess, which is the slices' own."""
    conditions: Conditions


class Partials(NamedTuple):
    """Derivatives of the forces along x, y and z (first axis) in each step, by what belongs to the same step."""

    past: tuple[Float[Array, "forces 2*passes *teeth m"], Float[Array, "forces 2*passes *teeth m"]]
    """By the displacement [N/m] and the velocity [N s/m] in the earlier passes."""
    motion: Float[Array, "forces felt m"]
    """By the present displacement [N/m] and, where they feel it, the velocity [N s/m]."""
    others: Others
    """By all else that changes, its own axes between the first and the last; None for what does not change."""


def linearise(p: Process, wanted: Others, motion: Float[Array, "felt m"]) -> Partials:
    """Derivatives of the forces.

    `wanted` holds the changes of the other inputs, None for one that does not change. Of the earlier motions there are
    always derivatives.
    """

    def of_slice(own, inside, by_own):
        found = found_paths(p, own, motion[:2])
        chosen = stored(p.touching, lambda found: choices(found, p.conditions.width, p.step_angle)[0], found)
        near, far = (
            lambda *at, near=near: _of_slice(p, own, inside, wanted._replace(slices=by_own), motion, *at, near=near)
            for near in (True, False)
        )
        return lax.cond(p.near, near, far, found, chosen)

    by = of_slices(of_slice, p.slices, p.inside, wanted.slices)
    own = jax.tree.map(lambda x: jnp.moveaxis(x, 0, 1), by.others.slices)  # the force first, then the slice
    past, at_present, others = jax.tree.map(added, by._replace(others=by.others._replace(slices=None)))
    return Partials(past, at_present, others._replace(slices=own))


def _of_slice(p: Process, own, inside, wanted: Others, motion, found: Paths, chosen, *, near: bool) -> Partials:
    """Derivatives of the forces of a slice, near a border or far from all."""
    gap, rate, _ = least_so_far(found, chosen, p.conditions.width, p.step_angle)[-1]
    of_met, of_forces = _by_contact(p, own, inside, wanted, motion, gap, rate, near=near)
    back = functools.partial(_by_paths, width=p.conditions.width, step_angle=p.step_angle)
    # Once for each quantity that a tooth meets, and not for each force: far from borders it is one.
    of_met = [(*direct, *stored(p.touching, back, found, chosen, by_gap, by_rate)) for *direct, by_gap, by_rate in of_met]

    def of_force(by_met, by_inputs, by_angles, by_velocity, of_met):
        through, by_displacement, by_paths, by_width = jax.tree.map(lambda *d: sum(map(jnp.multiply, by_met, d)), *of_met)
        by_inputs = jax.tree.map(jnp.add, through, by_inputs)
        conditions = by_inputs.conditions
        if wanted.conditions.width is not None:
            conditions = conditions._replace(width=conditions.width + by_width)
        past, through_paths, by_commanded, by_excess, of_paths = _by_earlier(p, own, wanted, motion, found, by_paths)
        by_angles = jax.tree.map(lambda want, *by: sum(by), wanted.slices.angles, by_angles, of_paths)
        others = Others(
            Slice(by_angles, by_excess, by_inputs.slices.borders),
            by_commanded,
            jax.tree.map(lambda change, by: summed(by) if change.ndim < 2 else by, wanted.conditions, conditions),
        )
        by_displacement = jax.tree.map(lambda direct, through: summed(direct) + through, by_displacement, through_paths)
        return past, (*by_displacement, *map(summed, by_velocity)), others

    return stored(p.touching, _joined, *(stored(p.touching, of_force, *by, of_met) for by in of_forces))


def _joined(*of_forces) -> Partials:
    """From the derivatives of each force, all numbers apart."""

    def joined(*parts):
        return jnp.stack([jnp.stack(jax.tree.leaves(part)) for part in parts])

    pasts, motions, others = zip(*of_forces, strict=True)
    past = joined(*(by for by, _ in pasts)), joined(*(by for _, by in pasts))
    return Partials(past, joined(*motions), jax.tree.map(lambda *parts: jnp.stack(parts), *others))


def respond(
    by: Float[Array, "forces felt m"],
    direct: Float[Array, "forces m"],
    free: Float[Array, "felt m"],
    felt: Motion,
    sweeps: int,
    touching: Bool[Array, ""],
) -> Float[Array, "forces m"]:
    """Changes of the forces over a block that agree with the displacement they make [N].

    `by` are the derivatives of the forces by the present motion, `direct` is the change of the forces at a fixed motion,
    `free` that of the motion at a fixed force; `touching` as in `Process`.
    """

    def force(motion):
        return stored(touching, lambda u: direct + einsum("fkm,km->fm", by, u), motion)

    return _iterated(lambda change: force(free + felt.of_force(change).reshape(free.shape)), force(free), sweeps)


def _iterated(sweep, start, times: int):
    """`sweep` applied `times` times, none where that is negative."""
    # Unrolled while short: XLA runs straight code faster than a loop, and compiles a long loop faster.
    if times > 6:
        return lax.scan(lambda carry, _: (sweep(carry), None), start, length=times)[0]
    for _ in range(times):
        start = sweep(start)
    return start


def contract(by: Partials, past: tuple[Array, Array], others: Others) -> Float[Array, "forces m"]:
    """Change of the forces in each step: partial derivatives times changes, over all inputs but the present motion."""
    displacement, velocity = (
        einsum("fkm,km->fm", b.reshape(len(b), -1, b.shape[-1]), d.reshape(-1, d.shape[-1]))
        for b, d in zip(by.past, past, strict=True)
    )
    total = displacement + velocity
    for b, d in zip(jax.tree.leaves(by.others), jax.tree.leaves(others), strict=True):
        if d.ndim == 0:
            total = total + b * d
        elif d.size:
            # One number for all steps and teeth, or one for each.
            d = d.reshape(*d.shape, *[1] * (b.ndim - 1 - d.ndim))
            d = jnp.broadcast_to(d, (*b.shape[1:-1], d.shape[-1])).reshape(-1, d.shape[-1])
            b = b.reshape(len(b), -1, b.shape[-1])
            total = total + (einsum("fkm,k->fm", b, d[:, 0]) if d.shape[1] == 1 else einsum("fkm,km->fm", b, d))
    return total


def _by_contact(p: Process, own: Slice, inside, wanted: Others, motion, gap, rate, *, near: bool):
    """Of what a tooth meets, F_t and what else counts: derivatives of each by the wanted conditions and borders,
    displacement, gap and rate; and of each force by them, by conditions and borders, by the angles and by the velocity."""
    teeth, m = own.angles.cos.shape
    inputs = Others(own, p.earlier.commanded, p.conditions)
    needed = jax.tree.map(lambda _: None, wanted)
    needed = needed._replace(slices=needed.slices._replace(borders=wanted.slices.borders), conditions=wanted.conditions)
    inputs, fixed = _repeated(inputs, needed, (teeth, m))
    everywhere = tuple(jnp.broadcast_to(along, (teeth, m)) for along in motion)
    displacement, velocity = everywhere[:2], everywhere[2:]

    def met(inputs, displacement, gap, rate):
        slices, _, conditions = eqx.combine(inputs, fixed)
        found = contact(p, slices, inside, conditions, displacement, gap, rate, near=near)
        return found.tangential, found.engaged, found.turn if near else None

    def force(met, inputs, angles, velocity):
        law, depth, _, damping = eqx.combine(inputs, fixed).conditions
        tangential, engaged, turn = met
        return force_on_tool(angles, tangential, engaged, turn, law, depth, velocity, damping)

    def linear(*inputs):
        met_there, back = jax.vjp(met, *inputs)
        # One by one and not by vmap: with known ones and zeros, XLA leaves out most of the work.
        return met_there, [back(unit) for unit in _units(met_there)]

    met_there, of_met = stored(p.touching, linear, inputs, displacement, gap, rate)
    forces, back = jax.vjp(force, met_there, inputs, own.angles, velocity)
    of_forces = []
    for unit in _units(forces):
        by_met, by_inputs, by_angles, by_velocity = back(unit)
        of_forces.append((jax.tree.leaves(by_met), by_inputs, _only(wanted.slices.angles, by_angles), by_velocity))
    return of_met, of_forces


def _by_paths(paths: Paths, chosen: tuple[Choice, ...], by_gap: Float[Array, "teeth m"], by_rate, width, step_angle: float):
    """From derivatives by what the chosen pass leaves: those by the paths of all passes, and by the width.

    `_chip.thickness` in reverse.
    """
    others = passes(paths, width, step_angle)[1:]
    stages = least_so_far(paths, chosen, width, step_angle)[:-1]
    by, by_width, found = (by_gap, by_rate, jnp.zeros_like(by_gap)), jnp.zeros_like(by_gap), []
    for least, other, choice in reversed(list(zip(stages, others, chosen, strict=True))):
        by_difference = choice.slope * sum(b * (y - x) for b, x, y in zip(by, least, other, strict=True))
        by_width = by_width - by_difference * (least[2] - other[2]) / (width + 1e-15)
        found.append([b * choice.weight for b in by])
        found[-1][2] = found[-1][2] - by_difference
        by = [b * (1 - choice.weight) for b in by]
        by[2] = by[2] + by_difference
    found.append(by)
    by_paths = []
    for (gap, rate), by in zip(paths, reversed(found), strict=True):
        of_gap, of_rate, of_width = passes_by(gap, rate, width, step_angle)
        by_paths.append((by[0] + by[2] * of_gap, by[1] + by[2] * of_rate))
        by_width = by_width + by[2] * of_width
    return tuple(by_paths), by_width


def _by_earlier(p: Process, own: Slice, wanted: Others, displacement, found: Paths, by_paths):
    """From derivatives by the paths: those by the earlier motions, by the present displacement and by what else is wanted,
    summed over the teeth; by the excess of each and, where they are wanted, by the angles. `_chip.paths` in reverse."""
    (cos, sin), earlier = own.angles, p.earlier
    feed_per_tooth, feed_rate, tip_speed, radius, lead, _ = earlier.commanded
    curvature, slowness = 1 / (2 * radius), 1 / tip_speed
    by_displacement, by_past, by_earlier_rate, by_lead, by_excess = [], [], [], [], []
    by_feed = by_feed_rate = by_tip_speed = by_radius = jnp.zeros(())
    by_cos = by_sin = jnp.zeros(())
    for k, ((_, across), (by_gap, by_across)) in enumerate(zip(found, by_paths, strict=True)):
        vx, vy = (earlier.velocity[k, 0] + feed_rate) * slowness, earlier.velocity[k, 1] * slowness
        by_gap = jnp.where(jnp.abs(across) < radius, by_gap, 0.0)
        by_across = by_across + by_gap * (2 * across * curvature - (cos * vx - sin * vy))
        turning = by_gap * across
        by_each = by_gap * cos - by_across * sin, -by_gap * sin - by_across * cos, -turning * cos, turning * sin
        by_all = by_dx, by_dy, by_vx, _ = tuple(map(summed, by_each))
        # Teeth that are not equally spaced have earlier motions of their own; elsewhere nothing is to be done for each.
        (own_dx, own_dy, own_vx, own_vy), over_teeth = (by_all, _same) if lead is None else (by_each, summed)
        by_displacement.append((by_dx, by_dy))
        by_past.append((-own_dx, -own_dy))
        by_earlier_rate.append((own_vx * slowness, own_vy * slowness))
        by_excess.append(by_gap)
        by_lead.append(own_dx * feed_per_tooth)
        by_feed = by_feed + over_teeth((k + 1 if lead is None else lead[k]) * own_dx)
        by_feed_rate = by_feed_rate + by_vx * slowness
        by_tip_speed = by_tip_speed - over_teeth(own_vx * vx + own_vy * vy) * slowness
        by_radius = by_radius - summed(turning * across) * (curvature / radius)
        dx = displacement[0] - earlier.displacement[k, 0] + earlier.advance(k)
        dy = displacement[1] - earlier.displacement[k, 1]
        by_cos = by_cos + by_gap * dx - by_across * dy - turning * vx
        by_sin = by_sin - by_gap * dy - by_across * dx + turning * vy
    of_lead = None if wanted.commanded.lead is None else jnp.stack(by_lead)
    by_commanded = _only(wanted.commanded, Commanded(by_feed, by_feed_rate, by_tip_speed, by_radius, of_lead))
    excess = None if wanted.slices.excess is None else jnp.stack(by_excess)
    x, y = (sum(along) for along in zip(*by_displacement, strict=True))
    past = tuple(by_past), tuple(by_earlier_rate)
    return past, (x, y), by_commanded, excess, _only(wanted.slices.angles, Angles(by_cos, by_sin))


def _same(x):
    return x


def _only(wanted, by):
    """The derivatives by what changes, None for the others."""
    return jax.tree.map(lambda change, b: None if change is None else b, wanted, by, is_leaf=lambda x: x is None)


def _units(values):
    """For every array among `values`: all of them 0, and that one 1 everywhere."""
    leaves, tree = jax.tree.flatten(values)
    ones = [[jnp.full(x.shape, float(i == j)) for j, x in enumerate(leaves)] for i in range(len(leaves))]
    return [jax.tree.unflatten(tree, unit) for unit in ones]


def _repeated(inputs, wanted, shape: tuple[int, ...]):
    """The wanted inputs, with a value for every step (and tooth), and the others.

    The derivative of a step by its own input is one number only where no input is shared by the steps.
    """

    def repeat(x, want):
        if want is None:
            return None
        # All but the coefficients of a law end with steps (and teeth) already, or with ones in their place.
        own = x.ndim >= len(shape) and all(
            have in (1, size) for have, size in zip(x.shape[-len(shape) :], shape, strict=True)
        )
        x = x if own else x.reshape(*x.shape, *[1] * len(shape))
        return jnp.broadcast_to(x, (*x.shape[: -len(shape)], *shape))

    def keep(x, want):
        return x if want is None else None

    return tuple(jax.tree.map(f, inputs, wanted, is_leaf=lambda x: x is None) for f in (repeat, keep))
