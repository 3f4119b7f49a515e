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

from ._block import Conditions, Process, contact, found_paths
from ._chip import Choice, Commanded, Paths, choices, least_so_far, passes
from ._contact import plane_force
from ._einsum import einsum
from ._math import stored, summed
from ._response import Motion


class Partials(NamedTuple):
    """Derivatives of the forces along x and y (first axis) in each step, by what belongs to the same step."""

    past: tuple[Float[Array, "2 2*passes m"], Float[Array, "2 2*passes m"]]
    """By the displacement [N/m] and the velocity [N s/m] in the earlier passes."""
    displacement: Float[Array, "2 2 m"]
    """By the present displacement [N/m]."""
    others: tuple[Commanded, Conditions]
    """By all else that changes, its own axes between the first and the last; None for what does not change."""


def linearise(p: Process, wanted: tuple[Commanded, Conditions], displacement: Float[Array, "2 m"]) -> Partials:
    """Derivatives of the forces along x and y.

    `wanted` holds the changes of the other inputs, None for one that does not change. Of the earlier motions there are
    always derivatives.
    """
    found = found_paths(p, displacement)
    chosen = stored(p.touching, lambda found: choices(found, p.conditions.width, p.step_angle)[0], found)
    near, far = (lambda *at, near=near: _of_all(p, wanted, displacement, *at, near=near) for near in (True, False))
    return lax.cond(p.near, near, far, found, chosen)


def _of_all(p: Process, wanted, displacement, found: Paths, chosen: tuple[Choice, ...], *, near: bool) -> Partials:
    """Derivatives of the forces, near a border or far from all."""
    gap, rate, _ = least_so_far(found, chosen, p.step_angle)[-1]
    of_met, of_forces = _by_contact(p, wanted[1], displacement, gap, rate, near=near)
    back = functools.partial(_by_paths, width=p.conditions.width, step_angle=p.step_angle)
    # Once for each quantity that a tooth meets, and not for each force: far from borders it is one.
    of_met = [(*direct, *stored(p.touching, back, found, chosen, by_gap, by_rate)) for *direct, by_gap, by_rate in of_met]

    def of_force(by_met, by_conditions, of_met):
        through, by_displacement, by_paths, by_width = jax.tree.map(lambda *d: sum(map(jnp.multiply, by_met, d)), *of_met)
        if wanted[1].width is not None:
            through = through._replace(width=through.width + by_width)
        by_conditions = jax.tree.map(_over_teeth, wanted[1], through, by_conditions)
        past, through_paths, by_earlier = _by_earlier(p, wanted[0], found, by_paths)
        by_displacement = jax.tree.map(lambda direct, through: summed(direct) + through, by_displacement, through_paths)
        return past, by_displacement, (by_earlier, by_conditions)

    return stored(p.touching, _joined, *(stored(p.touching, of_force, *by, of_met) for by in of_forces))


def _joined(of_x, of_y) -> Partials:
    """From the derivatives of each force, all numbers apart."""

    def both(x, y):
        return jnp.stack([jnp.stack(jax.tree.leaves(x)), jnp.stack(jax.tree.leaves(y))])

    (past_x, displacement_x, others_x), (past_y, displacement_y, others_y) = of_x, of_y
    past = both(past_x[0], past_y[0]), both(past_x[1], past_y[1])
    others = jax.tree.map(lambda x, y: jnp.stack([x, y]), others_x, others_y)
    return Partials(past, both(displacement_x, displacement_y), others)


def respond(
    by: Float[Array, "2 2 m"],
    direct: Float[Array, "2 m"],
    free: Float[Array, "2 m"],
    position: Motion,
    sweeps: int,
    touching: Bool[Array, ""],
) -> Float[Array, "2 m"]:
    """Changes of the forces over a block that agree with the displacement they make [N].

    `by` are the derivatives of the forces by the present displacement, `direct` is the change of the forces at a fixed
    displacement, `free` that of the displacement at a fixed force; `touching` as in `Process`.
    """

    def force(displacement):
        return stored(touching, lambda u: direct + einsum("fkm,km->fm", by, u), displacement)

    return _iterated(lambda change: force(free + position.of_force(change).reshape(2, -1)), force(free), sweeps)


def _iterated(sweep, start, times: int):
    """`sweep` applied `times` times, none where that is negative."""
    # Unrolled while short: XLA runs straight code faster than a loop, and compiles a long loop faster.
    if times > 6:
        return lax.scan(lambda carry, _: (sweep(carry), None), start, length=times)[0]
    for _ in range(times):
        start = sweep(start)
    return start


def contract(by: Partials, past: tuple[Array, Array], others: tuple[Commanded, Conditions]) -> Float[Array, "2 m"]:
    """Change of the forces in each step: partial derivatives times changes, over all inputs but the present displacement."""
    displacement, velocity = (
        einsum("fkm,km->fm", b, d.reshape(-1, d.shape[-1])) for b, d in zip(by.past, past, strict=True)
    )
    total = displacement + velocity
    for b, d in zip(jax.tree.leaves(by.others), jax.tree.leaves(others), strict=True):
        if d.ndim == 0:
            total = total + b * d
        elif d.size:
            # One number for all steps and teeth, or one for each.
            d = d.reshape(*d.shape, *[1] * (b.ndim - 1 - d.ndim))
            d = jnp.broadcast_to(d, (*b.shape[1:-1], d.shape[-1])).reshape(-1, d.shape[-1])
            b = b.reshape(2, -1, b.shape[-1])
            total = total + (einsum("fkm,k->fm", b, d[:, 0]) if d.shape[1] == 1 else einsum("fkm,km->fm", b, d))
    return total


def _by_contact(p: Process, wanted: Conditions, displacement, gap, rate, *, near: bool):
    """Of what a tooth meets, F_t and near a border its place: derivatives of each by the wanted conditions, displacement, g
    and its rate; and of each force by them and by the conditions."""
    teeth, m = p.angles.cos.shape
    conditions, fixed = _repeated(p.conditions, wanted, (teeth, m))
    everywhere = tuple(jnp.broadcast_to(along, (teeth, m)) for along in displacement)

    def met(conditions, displacement, gap, rate):
        found = contact(p, eqx.combine(conditions, fixed), displacement, gap, rate, near=near)
        return (found.tangential, found.turn) if near else (found.tangential,)

    def force(met, conditions):
        law, depth, *_ = eqx.combine(conditions, fixed)
        tangential, turn = met if near else (*met, jnp.zeros((teeth, m)))
        return plane_force(p.angles, tangential, turn, law.kr, depth)

    def linear(*inputs):
        met_there, back = jax.vjp(met, *inputs)
        # One by one and not by vmap: with known ones and zeros, XLA leaves out most of the work.
        return met_there, [back(unit) for unit in _units(len(met_there), (teeth, m))]

    met_there, of_met = stored(p.touching, linear, conditions, everywhere, gap, rate)
    _, back = jax.vjp(force, met_there, conditions)
    return of_met, [back(unit) for unit in _units(2, (m,))]


def _over_teeth(change, *by):
    """Derivatives by a quantity that changes so: summed where all teeth share it."""
    return sum(map(summed, by)) if change.ndim < 2 else sum(by)


def _by_paths(paths: Paths, chosen: tuple[Choice, ...], by_gap: Float[Array, "teeth m"], by_rate, width, step_angle: float):
    """From derivatives by what the chosen pass leaves: those by the paths of all passes, and by the width.

    `_chip.thickness` in reverse.
    """
    others = passes(paths, step_angle)[1:]
    stages = least_so_far(paths, chosen, step_angle)[:-1]
    by, by_width, found = (by_gap, by_rate, jnp.zeros_like(by_gap)), jnp.zeros_like(by_gap), []
    for least, other, choice in reversed(list(zip(stages, others, chosen, strict=True))):
        by_difference = choice.slope * sum(b * (y - x) for b, x, y in zip(by, least, other, strict=True))
        by_width = by_width - by_difference * (least[2] - other[2]) / (width + 1e-15)
        found.append([b * choice.weight for b in by])
        found[-1][2] = found[-1][2] - by_difference
        by = [b * (1 - choice.weight) for b in by]
        by[2] = by[2] + by_difference
    found.append(by)

    def by_path(path, by):
        (gap, rate), half = path, step_angle / 2
        whole = gap > jnp.abs(rate) * half
        by_gap = by[0] + by[2] * jnp.where(whole, 1.0, 0.5)
        return by_gap, by[1] + by[2] * jnp.where(whole, 0.0, jnp.sign(rate) * half / 2)

    return tuple(map(by_path, paths, reversed(found))), by_width


def _by_earlier(p: Process, wanted: Commanded, found: Paths, by_paths):
    """From derivatives by the paths: those by the earlier motions, by the present displacement and by what else is wanted,
    summed over the teeth. `_chip.paths` in reverse."""
    (cos, sin), velocity = p.angles, p.earlier.velocity
    _, feed_rate, tip_speed, radius = p.earlier.commanded
    curvature, slowness = 1 / (2 * radius), 1 / tip_speed
    by_displacement, by_velocity = [], []
    by_feed = by_feed_rate = by_tip_speed = by_radius = jnp.zeros(())
    for k, ((_, across), (by_gap, by_across)) in enumerate(zip(found, by_paths, strict=True)):
        vx, vy = (velocity[k, 0] + feed_rate) * slowness, velocity[k, 1] * slowness
        by_gap = jnp.where(jnp.abs(across) < radius, by_gap, 0.0)
        by_across = by_across + by_gap * (2 * across * curvature - (cos * vx - sin * vy))
        turning = by_gap * across
        by_dx, by_dy = summed(by_gap * cos - by_across * sin), summed(-by_gap * sin - by_across * cos)
        by_vx, by_vy = summed(-turning * cos), summed(turning * sin)
        by_displacement.append((by_dx, by_dy))
        by_velocity.append((by_vx * slowness, by_vy * slowness))
        by_feed = by_feed + (k + 1) * by_dx
        by_feed_rate = by_feed_rate + by_vx * slowness
        by_tip_speed = by_tip_speed - (by_vx * vx + by_vy * vy) * slowness
        by_radius = by_radius - summed(turning * across) * (curvature / radius)
    by = Commanded(by_feed, by_feed_rate, by_tip_speed, by_radius)
    by = jax.tree.map(lambda change, b: None if change is None else b, wanted, by, is_leaf=lambda x: x is None)
    x, y = (sum(along) for along in zip(*by_displacement, strict=True))
    return (tuple((-dx, -dy) for dx, dy in by_displacement), tuple(by_velocity)), (x, y), by


def _units(n: int, shape: tuple[int, ...]):
    """n times n quantities, of which one after the other is 1 everywhere and the rest 0."""
    return [tuple(jnp.full(shape, float(i == j)) for j in range(n)) for i in range(n)]


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
