"""One block of time steps, linearised: how force and displacement change together.

At the solution f = F(u, past, p), and u = u(f, p). So df = F_p dp + F_past dpast + F_u (du + G df), with du the change of
the displacement at a fixed force and G the response within the block. Steps do not feel each other in F, so F has one
derivative for each step and input. The chain rule is spelt out, from the forces back to the paths of the teeth, and the
links are stored; what a tooth meets is differentiated automatically.
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float

from ._block import Conditions, Process, contact, found_paths
from ._chip import Choice, Earlier, Paths, choices, least_so_far, passes
from ._contact import plane_force
from ._math import stored


class Partials(NamedTuple):
    """Derivatives of the forces along x and y (first axis) in each step, by what belongs to the same step."""

    past_displacement: Float[Array, "2 passes 2 m"]
    """By the displacement in the earlier passes [N/m]."""
    past_velocity: Float[Array, "2 passes 2 m"]
    """By the velocity in the earlier passes [N s/m]."""
    displacement: Float[Array, "2 2 m"]
    """By the present displacement [N/m]."""
    touching: Bool[Array, ""]
    """See `Process`: where it is false, all derivatives are zero."""


def linearise(p: Process, tangents: Process, displacement: Float[Array, "2 m"]) -> tuple[Partials, Float[Array, "2 m"]]:
    """Derivatives of the forces along x and y, and their changes with those inputs that have a tangent [N].

    `tangents` holds the changes of the process, None for an input that does not change. Those of the earlier motions do not
    count here: their derivatives are returned instead.
    """
    width = p.conditions.width
    found = found_paths(p, displacement)
    chosen = stored(p.touching, lambda found: choices(found, width, p.step_angle), found)
    gap, rate, _ = least_so_far(found, chosen, p.step_angle)[-1]
    near, far = (
        lambda gap, rate, near=near: _by_contact(p, tangents.conditions, displacement, gap, rate, near=near)
        for near in (True, False)
    )
    by_conditions, by_displacement, by_gap, by_rate = lax.cond(p.near, near, far, gap, rate)
    by_paths, by_width = stored(
        p.touching,
        lambda found, chosen, by_gap, by_rate: _by_paths(found, chosen, by_gap, by_rate, width, p.step_angle),
        found,
        chosen,
        by_gap,
        by_rate,
    )
    by_earlier, through_paths = stored(p.touching, lambda *at: _by_earlier(p, *at), found, by_paths)

    if by_conditions.width is not None:
        by_conditions = by_conditions._replace(width=by_conditions.width + by_width)
    others = tangents.earlier._replace(displacement=None, velocity=None)
    by_others = by_earlier._replace(**{name: None for name, change in others._asdict().items() if change is None})
    direct = contract((by_others, by_conditions), (others, tangents.conditions))
    return Partials(by_earlier.displacement, by_earlier.velocity, by_displacement + through_paths, p.touching), direct


def respond(
    by: Float[Array, "2 2 m"],
    direct: Float[Array, "2 m"],
    free: Float[Array, "2 m"],
    position: Float[Array, "2*m 2*m"],
    sweeps: int,
) -> Float[Array, "2 m"]:
    """Changes of the forces over a block that agree with the displacement they make [N].

    `by` are the derivatives of the forces by the present displacement, `direct` is the change of the forces at a fixed
    displacement, `free` that of the displacement at a fixed force, and `position` what a force adds to it (`Motion.joined`).
    """

    def force(displacement):
        return direct + by[:, 0] * displacement[0] + by[:, 1] * displacement[1]

    return _iterated(lambda change: force(free + (change.ravel() @ position).reshape(2, -1)), force(free), sweeps)


def _iterated(sweep, start, times: int):
    """`sweep` applied `times` times, none where that is negative."""
    # Unrolled while short: XLA runs straight code faster than a loop, and compiles a long loop faster.
    if times > 6:
        return lax.scan(lambda carry, _: (sweep(carry), None), start, length=times)[0]
    for _ in range(times):
        start = sweep(start)
    return start


def contract(by, change) -> Float[Array, "2 m"]:
    """Changes of both forces in each step: partial derivatives times changes, over all inputs."""
    terms = [
        jnp.sum((b * d.reshape(*d.shape, *[1] * (b.ndim - 1 - d.ndim))).reshape(2, -1, b.shape[-1]), axis=1)
        for b, d in zip(jax.tree.leaves(by), jax.tree.leaves(change), strict=True)
    ]
    return sum(terms[1:], terms[0]) if terms else jnp.zeros(())


def _by_contact(p: Process, wanted: Conditions, displacement, gap, rate, *, near: bool):
    """Derivatives of both forces (first axis) by the wanted conditions, and by displacement, g and its rate."""
    teeth, m = p.angles.cos.shape
    conditions, fixed = _repeated(p.conditions, wanted, (teeth, m))
    everywhere = jnp.broadcast_to(displacement[:, None], (2, teeth, m))

    def met(conditions, displacement, gap, rate):
        found = contact(p, eqx.combine(conditions, fixed), displacement, gap, rate, near=near)
        return (found.tangential, found.turn) if near else (found.tangential,)

    def force(met, conditions):
        law, depth, *_ = eqx.combine(conditions, fixed)
        tangential, turn = met if near else (*met, jnp.zeros((teeth, m)))
        return plane_force(p.angles, tangential, turn, law.kr, depth)

    def of_met(*inputs):
        met_there, back = jax.vjp(met, *inputs)
        # One by one and not by vmap: with known ones and zeros, XLA leaves out most of the work.
        return met_there, [back(unit) for unit in _units(len(met_there), (teeth, m))]

    met_there, by = stored(p.touching, of_met, conditions, everywhere, gap, rate)
    _, back = jax.vjp(force, met_there, conditions)
    found = []
    for unit in _units(2, (m,)):
        by_met, by_conditions = back(unit)
        through, *others = jax.tree.map(lambda *d, by_met=by_met: sum(map(jnp.multiply, by_met, d)), *by)
        found.append((jax.tree.map(jnp.add, through, by_conditions), *others))
    by_conditions, by_displacement, by_gap, by_rate = jax.tree.map(lambda x, y: jnp.stack([x, y]), *found)

    def summed(by, change):
        return jnp.sum(by, axis=-2) if change.ndim < 2 else by  # all teeth share a number

    return jax.tree.map(summed, by_conditions, wanted), jnp.sum(by_displacement, axis=2), by_gap, by_rate


def _by_paths(
    paths: Paths, chosen: tuple[Choice, ...], by_gap: Float[Array, "2 teeth m"], by_rate, width, step_angle: float
):
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

    return tuple(map(by_path, paths, reversed(found))), jnp.sum(by_width, axis=1)


def _by_earlier(p: Process, found: Paths, by_paths):
    """From derivatives by the paths: those by what they follow from, summed over the teeth. `_chip.paths` in reverse."""
    earlier, (cos, sin) = p.earlier, p.angles
    curvature, slowness = 1 / (2 * earlier.radius), 1 / earlier.tip_speed
    by_displacement, by_velocity = [], []
    by_feed = by_feed_rate = by_tip_speed = by_radius = jnp.zeros(())
    for k, ((_, across), (by_gap, by_across)) in enumerate(zip(found, by_paths, strict=True)):
        vx, vy = (earlier.velocity[k, 0] + earlier.feed_rate) * slowness, earlier.velocity[k, 1] * slowness
        by_gap = jnp.where(jnp.abs(across) < earlier.radius, by_gap, 0.0)
        by_across = by_across + by_gap * (2 * across * curvature - (cos * vx - sin * vy))
        turning = by_gap * across
        by_dx, by_dy, by_vx, by_vy = (
            jnp.sum(by, axis=1)
            for by in (
                by_gap * cos - by_across * sin,
                -by_gap * sin - by_across * cos,
                -turning * cos,
                turning * sin,
            )
        )
        by_displacement.append(jnp.stack([by_dx, by_dy], axis=1))
        by_velocity.append(jnp.stack([by_vx, by_vy], axis=1) * slowness)
        by_feed = by_feed + (k + 1) * by_dx
        by_feed_rate = by_feed_rate + by_vx * slowness
        by_tip_speed = by_tip_speed - (by_vx * vx + by_vy * vy) * slowness
        by_radius = by_radius - jnp.sum(turning * across, axis=1) * (curvature / earlier.radius)
    by_earlier = Earlier(
        -jnp.stack(by_displacement, axis=1),
        jnp.stack(by_velocity, axis=1),
        by_feed,
        by_feed_rate,
        by_tip_speed,
        by_radius,
    )
    return by_earlier, sum(by_displacement)


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
