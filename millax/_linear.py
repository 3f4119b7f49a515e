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
from ._contact import Contact, plane_force
from ._response import Motion


class Partials(NamedTuple):
    """Derivatives of one force in each step by what belongs to the same step."""

    past_displacement: Float[Array, "passes 2 m"]
    """By the displacement in the earlier passes [N/m]."""
    past_velocity: Float[Array, "passes 2 m"]
    """By the velocity in the earlier passes [N s/m]."""
    displacement: Float[Array, "2 m"]
    """By the present displacement [N/m]."""


def linearise(p: Process, tangents: Process, displacement: Float[Array, "2 m"]) -> tuple[tuple[Partials, Partials], Pair]:
    """Derivatives of the forces along x and y, and their changes with those inputs that have a tangent [N].

    `tangents` holds the changes of the process, None for an input that does not change. Those of the earlier motions do not
    count here: their derivatives are returned instead.
    """
    others = tangents.earlier._replace(displacement=None, velocity=None)
    wanted = others._replace(displacement=p.earlier.displacement, velocity=p.earlier.velocity)
    partials, direct = [], []
    for by_earlier, by_conditions, by_displacement in _by_inputs(p, wanted, tangents.conditions, displacement):
        partials.append(Partials(by_earlier.displacement, by_earlier.velocity, by_displacement))
        by = by_earlier._replace(displacement=None, velocity=None), by_conditions
        direct.append(contract(by, (others, tangents.conditions)))
    return (partials[0], partials[1]), (direct[0], direct[1])


def respond(
    by: tuple[Partials, Partials], direct: Pair, displaced: Float[Array, " 2*m"], position: Motion, sweeps: int
) -> tuple[Float[Array, "2 m"], Pair]:
    """Changes of displacement [m] and force [N] over a block that agree with each other.

    `direct` is the change of the force at a fixed displacement, `displaced` that of the displacement at a fixed force.
    """

    def force(displacement) -> Pair:
        x, y = (d + contract(b.displacement[:, None], displacement[:, None]) for d, b in zip(direct, by, strict=True))
        return x, y

    def displacement(force: Pair):
        return (displaced + position.of_force(force)).reshape(2, -1)

    change = repeat(lambda change: force(displacement(change)), force(displaced.reshape(2, -1)), sweeps)
    return displacement(change), change


def contract(by, change) -> Float[Array, " m"]:
    """Change of a force in each step: partial derivatives times changes, over all inputs."""
    terms = [
        jnp.sum((b * d).reshape(-1, b.shape[-1]), axis=0)
        for b, d in zip(jax.tree.leaves(by), jax.tree.leaves(change), strict=True)
    ]
    return sum(terms[1:], terms[0]) if terms else jnp.zeros(())


def _by_inputs(p: Process, wanted_earlier: Earlier, wanted_conditions: Conditions, displacement):
    """For the force along x and then along y: derivatives by the earlier passes, by the conditions, by the displacement.

    The chain rule is spelt out. What goes through a condition is stored once, and differentiated without its other branch.
    """
    teeth, m = p.angles.cos.shape
    earlier, fixed_earlier = _repeated(p.earlier, wanted_earlier, (m,))
    conditions, fixed_conditions = _repeated(p.conditions, wanted_conditions, (teeth, m))
    everywhere = jnp.broadcast_to(displacement[:, None], (2, teeth, m))
    one, none = jnp.ones((teeth, m)), jnp.zeros((teeth, m))

    def of_contact(near: bool):
        """By conditions, displacement, gap and rate."""

        def met(conditions, displacement, gap, rate):
            return contact(eqx.combine(conditions, fixed_conditions), displacement, gap, rate, p.step_angle, near=near)

        def force(met, conditions):
            law, depth, *_ = eqx.combine(conditions, fixed_conditions)
            return plane_force(p.angles, met, law.kr, depth)

        met_there, back = jax.vjp(met, conditions, everywhere, gap, rate)
        by_tangential = back(Contact(one, none, none))
        by_turn = back(Contact(none, none, one)) if near else None
        _, project = jax.vjp(force, met_there, conditions)
        found = []
        for unit in ((one[0], none[0]), (none[0], one[0])):
            by_met, by_conditions = project(unit)
            total = jax.tree.map(lambda d, by=by_met: by.tangential * d, by_tangential)
            if near:
                total = jax.tree.map(lambda t, d, by=by_met: t + by.turn * d, total, by_turn)
            through, by_displacement, by_gap, by_rate = total
            by_conditions = jax.tree.map(jnp.add, through, by_conditions)
            found.append((by_conditions, jnp.sum(by_displacement, axis=1), by_gap, by_rate))
        return tuple(found)

    def of_paths(change):
        _, back = jax.vjp(lambda e, u: paths(p.angles, eqx.combine(e, fixed_earlier), u), earlier, displacement)
        return back(change)

    def of_no_paths(change):
        return jax.tree.map(jnp.zeros_like, (earlier, displacement))

    def least(paths):
        return thickness(paths, p.conditions.width, p.step_angle)

    (gap, rate), of_least = jax.vjp(least, found_paths(p, displacement))
    by = lax.cond(p.near, lambda: of_contact(near=True), lambda: of_contact(near=False))
    for by_conditions, by_displacement, by_gap, by_rate in by:
        (by_paths,) = of_least((by_gap, by_rate))
        by_earlier, through_paths = lax.cond(p.touching, of_paths, of_no_paths, by_paths)
        yield by_earlier, by_conditions, by_displacement + through_paths


def _repeated(inputs, wanted, shape: tuple[int, ...]):
    """The wanted inputs, with a value for every step (and tooth), and the others.

    The derivative of a step by its own input is one number only where no input is shared by the steps.
    """

    def repeat(x, want):
        return None if want is None else jnp.broadcast_to(x, (*x.shape[: -len(shape)], *shape))

    def keep(x, want):
        return x if want is None else None

    return tuple(jax.tree.map(f, inputs, wanted, is_leaf=lambda x: x is None) for f in (repeat, keep))
