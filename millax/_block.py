"""One block of time steps: the force and the displacement that agree with each other.

Given the surfaces left by earlier passes, the force in each step is a function of the displacement in that same step
(`cutting`), and the displacement follows from the forces by the response of the structure. Fixed-point sweeps, force ->
displacement -> force, solve the two together. The map is strictly causal, so they always converge.

Derivatives are not taken through the sweeps. At the solution f = F(u(f, p), p), so df = F_p dp + F_u (u_p dp + G df) with
G the response matrix. F_u couples only the two axes of one step, so two directional derivatives give all of it, and the
linear equation for df is swept like the force itself: one differentiation of `cutting`, however many sweeps there are.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float

from ._chip import Angles, PastSurfaces, thickness
from ._contact import Borders, crossing, plane_force
from ._forces import ForceLaw
from ._response import Motion
from ._types import Scalar

Pair = tuple[Float[Array, " m"], Float[Array, " m"]]
"""Force along x and y in each step. Kept apart: joined in one array, XLA computes them in a loop it cannot vectorise."""


class Process(eqx.Module):
    """Everything that turns the tool's displacement in a block into the cutting force."""

    law: ForceLaw
    angles: Angles
    past: PastSurfaces
    borders: Borders
    radius: Scalar
    depth: Scalar
    width: Scalar
    step_angle: float = eqx.field(static=True)


def cutting(process: Process, displacement: Float[Array, "2 m"]) -> tuple[Pair, Float[Array, "teeth m"]]:
    """Mean force on the tool in each step [N], and the mean chip thickness of each tooth [m]."""
    p = process
    gap, rate = thickness(p.angles, p.past, displacement, p.radius, p.width, p.step_angle)
    contact = crossing(p.law, p.borders, displacement, gap, rate, p.step_angle, p.width)
    return plane_force(p.angles, contact, p.law.kr, p.depth), contact.thickness


@eqx.filter_custom_jvp
def solve(process: Process, position: Motion, state: Float[Array, " states"], guess: Pair, *, sweeps: int):
    """Forces over the block after `sweeps` sweeps from `guess` [N], the chip thickness that made them [m], and the largest
    change of the forces in the last sweep [N]."""

    def sweep(force, _):
        return cutting(process, position(state, force))[0], None

    previous, _ = _repeat(sweep, guess, sweeps - 1)
    force, chip = cutting(process, position(state, previous))
    change = jnp.maximum(*(jnp.max(jnp.abs(new - old)) for new, old in zip(force, previous, strict=True)))
    return force, chip, change


@solve.def_jvp
def _solve_jvp(primals, tangents, *, sweeps):
    process, position, state, guess = primals
    force, chip, change = solve(process, position, state, guess, sweeps=sweeps)

    def of_parameters(process, position, state):
        return cutting(process, position(state, force))

    value, direct = eqx.filter_jvp(of_parameters, (process, position, state), tangents[:3])
    # None stands for no dependence at all, as of the thickness on the force law.
    direct = jax.tree.map(lambda v, d: jnp.zeros_like(v) if d is None else d, value, direct)

    def of_displacement(direction):
        u = position(state, force)
        return jax.jvp(lambda u: cutting(process, u), (u,), (jnp.zeros_like(u).at[direction].set(1.0),))[1]

    by_x, by_y = of_displacement(0), of_displacement(1)

    def respond(df):
        """Changes of force and chip thickness, given those of the force in the displacement."""
        dx, dy = position.forced[0] @ df[0] + position.forced[1] @ df[1]
        return jax.tree.map(lambda d, x, y: d + x * dx + y * dy, direct, by_x, by_y)

    df, _ = _repeat(lambda df, _: (respond(df)[0], None), direct[0], sweeps)
    return (force, chip, change), (df, respond(df)[1], jnp.zeros_like(change))


def _repeat(sweep, start, times):
    # Unrolled while short: XLA runs straight code faster than a loop, and compiles a long loop faster.
    return lax.scan(sweep, start, length=times, unroll=6)
