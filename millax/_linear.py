"""One block of time steps, linearised: how force and displacement change together.

At the solution f = F(u, past, p), and u = u(f, p). So df = F_p dp + F_past dpast + F_u (du + G df), with du the change of
the displacement at a fixed force and G the response within the block. Steps do not feel each other in F, so reverse passes
for the force along x and along y give all its partial derivatives, step by step; the rest is multiplications with these.
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float

from ._block import Conditions, Pair, Process, contact, found_paths, repeat
from ._chip import Earlier, paths, thickness
from ._contact import plane_force
from ._response import Motion


class Partials(NamedTuple):
    """Derivatives of the forces along x and y (first axis) in each step, by what belongs to the same step."""

    past_displacement: Float[Array, "2 passes 2 m"]
    """By the displacement in the earlier passes [N/m]."""
    past_velocity: Float[Array, "2 passes 2 m"]
    """By the velocity in the earlier passes [N s/m]."""
    displacement: Float[Array, "2 2 m"]
    """By the present displacement [N/m]."""


def linearise(p: Process, tangents: Process, displacement: Float[Array, "2 m"]) -> tuple[Partials, Float[Array, "2 m"]]:
    """Derivatives of the forces along x and y, and their changes with those inputs that have a tangent [N].

    `tangents` holds the changes of the process, None for an input that does not change. Those of the earlier motions do not
    count here: their derivatives are returned instead.
    """
    others = tangents.earlier._replace(displacement=None, velocity=None)
    wanted = others._replace(displacement=p.earlier.displacement, velocity=p.earlier.velocity)
    by_earlier, by_conditions, by_displacement = _by_inputs(p, wanted, tangents.conditions, displacement)
    by_others = by_earlier._replace(displacement=None, velocity=None)
    direct = contract((by_others, by_conditions), (others, tangents.conditions))
    return Partials(by_earlier.displacement, by_earlier.velocity, by_displacement), direct


def respond(
    by: Float[Array, "2 2 m"], direct: Float[Array, "2 m"], displaced: Float[Array, " 2*m"], position: Motion, sweeps: int
) -> tuple[Float[Array, "2 m"], Pair]:
    """Changes of displacement [m] and force [N] over a block that agree with each other.

    `by` are the derivatives of the forces by the present displacement, `direct` is the change of the forces at a fixed
    displacement, `displaced` that of the displacement at a fixed force.
    """

    def force(displacement) -> Pair:
        x, y = (direct[i] + by[i, 0] * displacement[0] + by[i, 1] * displacement[1] for i in (0, 1))
        return x, y

    def displacement(force: Pair):
        return (displaced + position.of_force(force)).reshape(2, -1)

    change = repeat(lambda change: force(displacement(change)), force(displaced.reshape(2, -1)), sweeps)
    return displacement(change), change


def contract(by, change) -> Float[Array, "2 m"]:
    """Changes of both forces in each step: partial derivatives times changes, over all inputs."""
    terms = [
        jnp.sum((b * d.reshape(*d.shape, *[1] * (b.ndim - 1 - d.ndim))).reshape(2, -1, b.shape[-1]), axis=1)
        for b, d in zip(jax.tree.leaves(by), jax.tree.leaves(change), strict=True)
    ]
    return sum(terms[1:], terms[0]) if terms else jnp.zeros(())


def _by_inputs(p: Process, wanted_earlier: Earlier, wanted_conditions: Conditions, displacement):
    """For the forces along x and y (first axis): derivatives by the earlier passes, the conditions, the displacement.

    The chain rule is spelt out. What goes through a condition is stored once, and differentiated without its other branch.
    """
    teeth, m = p.angles.cos.shape
    earlier, fixed_earlier = _repeated(p.earlier, wanted_earlier, (m,))
    conditions, fixed_conditions = _repeated(p.conditions, wanted_conditions, (teeth, m))
    width = p.conditions.width if conditions.width is None else conditions.width
    everywhere = jnp.broadcast_to(displacement[:, None], (2, teeth, m))

    def of_contact(near: bool):
        """By conditions, displacement, gap and rate."""

        def met(conditions, displacement, gap, rate):
            found = contact(eqx.combine(conditions, fixed_conditions), displacement, gap, rate, p.step_angle, near=near)
            return (found.tangential, found.turn) if near else (found.tangential,)

        def force(met, conditions):
            law, depth, *_ = eqx.combine(conditions, fixed_conditions)
            tangential, turn = met if near else (*met, jnp.zeros((teeth, m)))
            return plane_force(p.angles, tangential, turn, law.kr, depth)

        met_there, of_met = jax.vjp(met, conditions, everywhere, gap, rate)
        _, of_force = jax.vjp(force, met_there, conditions)
        # One by one and not by vmap: with known ones and zeros, XLA leaves out most of the work.
        by = [of_met(unit) for unit in _units(len(met_there), (teeth, m))]
        found = []
        for unit in _units(2, (m,)):
            by_met, by_conditions = of_force(unit)
            through, *others = jax.tree.map(lambda *d, by_met=by_met: sum(map(jnp.multiply, by_met, d)), *by)
            found.append((jax.tree.map(jnp.add, through, by_conditions), *others))
        by_conditions, by_displacement, *by_path = jax.tree.map(lambda x, y: jnp.stack([x, y]), *found)
        return by_conditions, jnp.sum(by_displacement, axis=2), *by_path

    def of_paths(change):
        _, back = jax.vjp(lambda e, u: paths(p.angles, eqx.combine(e, fixed_earlier), u), earlier, displacement)
        return jax.vmap(back)(change)

    def of_no_paths(change):
        return jax.tree.map(lambda x: jnp.zeros((2, *x.shape)), (earlier, displacement))

    def least(paths, width):
        return thickness(paths, width, p.step_angle)

    (gap, rate), of_least = jax.vjp(least, found_paths(p, displacement), width)
    near, far = (lambda near=near: of_contact(near) for near in (True, False))
    by_conditions, by_displacement, by_gap, by_rate = lax.cond(p.near, near, far)
    by_paths, by_width = jax.vmap(of_least)((by_gap, by_rate))
    if by_conditions.width is not None:
        by_conditions = by_conditions._replace(width=by_conditions.width + by_width)
    by_earlier, through_paths = lax.cond(p.touching, of_paths, of_no_paths, by_paths)
    return by_earlier, by_conditions, by_displacement + through_paths


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
