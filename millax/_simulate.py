"""The simulation: one scan over tooth periods, each computed at once.

Within a block (a tooth period or a part of one) the surfaces left by earlier passes are known, so chip thickness and
force of all its steps are one vectorised expression of the tool's displacement. The displacement follows from the force
by the structure's exact response. The two are iterated, force -> displacement -> force, from the force one tooth period
earlier: the map is strictly causal, so the iteration always converges; how many sweeps it needs depends on how strongly
the force feels the displacement within a block (`Settings.suited` chooses). What the last sweep changed is reported as
the residual.
"""

import warnings
from typing import overload

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.core import Tracer
from jaxtyping import Array, Float, Int

from ._block import Process, solve
from ._case import Case
from ._chip import Angles, past_surfaces
from ._contact import Borders, borders_met
from ._cut import Cut
from ._forces import ForceLaw
from ._response import block_response
from ._settings import RESIDUAL_TOLERANCE, Settings
from ._stock import Stock
from ._structure import Structure
from ._tool import EndMill
from ._types import Scalar

STATUS = {
    0: "ok",
    1: "the fixed-point sweeps have not converged: give more sweeps, or more blocks per tooth period",
    2: "the tool left its path by more than its radius: the cut is unstable or the structure too soft",
    3: "the traces hold numbers that are not finite: the cut is unstable, or a parameter is out of its range",
}
"""What each `Simulation.status` means and what to try."""


class SimulationError(RuntimeError):
    """A simulation that must not be used; the message says why and what to try."""


class Simulation(eqx.Module):
    """Traces of one simulated cut. Sample j belongs to the middle of time step j.

    **Attributes:**

    - `time`: t [s], shape (steps,).
    - `force`: mean force on the tool over each step, in the workpiece frame [N], shape (steps, 3).
    - `displacement`: deviation of the tool centre from its commanded path [m], shape (steps, axes).
    - `chip_thickness`: mean over each step, per tooth [m], shape (steps, teeth).
    - `residual`: largest change of the force in the last sweep over the largest force [-].
    - `status`: 0 where the simulation can be trusted; otherwise a key of `millax.STATUS`.
    - `axes`: the columns of `displacement`. Static.
    """

    time: Float[Array, " steps"]
    force: Float[Array, "steps 3"]
    displacement: Float[Array, "steps axes"]
    chip_thickness: Float[Array, "steps teeth"]
    residual: Scalar
    status: Int[Array, ""]
    axes: tuple[str, ...] = eqx.field(static=True)


@overload
def simulate(case: Case, /, *, throw: bool = True) -> Simulation: ...


@overload
def simulate(
    tool: EndMill,
    force: ForceLaw,
    structure: Structure,
    cut: Cut,
    stock: Stock,
    settings: Settings,
    /,
    *,
    throw: bool = True,
) -> Simulation: ...


def simulate(*parts, throw: bool = True) -> Simulation:
    """Simulate a cut.

    **Arguments:**

    - A `Case`, or the objects it is made of: tool, force law, structure, cut, stock, settings.
    - `throw`: raise `SimulationError` when the result must not be used. Under `jit`, `grad` or `vmap` nothing can be
      raised: look at `Simulation.status` there.

    Warns when it runs in float32 (JAX's default): forces are then good to about 1e-3.
    """
    if len(parts) == 1:
        (case,) = parts
    else:
        tool, force, structure, cut, stock, settings = parts
        case = Case(tool, force, cut, stock, structure, settings)
    sim = _simulate(case)
    if not isinstance(sim.status, Tracer):
        if sim.force.dtype == jnp.float32:
            warnings.warn(
                'millax runs in float32. For full accuracy: jax.config.update("jax_enable_x64", True) before anything else',
                stacklevel=2,
            )
        status = int(sim.status)
        if throw and status:
            raise SimulationError(f"{STATUS[status]} (residual {float(sim.residual):.1e})")
    return sim


@eqx.filter_jit
def _simulate(case: Case) -> Simulation:
    tool, law, cut, structure, settings = case.tool, case.force, case.cut, case.structure, case.settings
    teeth, steps, blocks = tool.teeth, settings.steps_per_tooth, settings.blocks
    m = steps // blocks
    step_angle = 2 * np.pi / (teeth * steps)
    tau = cut.tooth_period(tool)
    feed_per_tooth = cut.feed_per_tooth(tool)
    tip_speed = cut.spindle_speed * tool.radius
    response = block_response(structure, tau / steps, m)
    angles, borders = _geometry(case, m)
    rigid = structure.coordinates == 0

    def block(state, inputs):
        angles, borders, (displacement, velocity), guess, travelled = inputs
        past = past_surfaces(angles, displacement, velocity, feed_per_tooth, cut.feed_rate, tip_speed)
        borders = borders.moved(travelled)
        process = Process(law, angles, past, borders, tool.radius, cut.depth, settings.width, step_angle=step_angle)
        force, chip, change = solve(process, response.position, state, guess, sweeps=1 if rigid else settings.sweeps)
        motion = (response.position(state, force), response.velocity(state, force))
        traces = (jnp.stack(force), response.axes(state, force), chip)
        return response.end(state, force), (motion, force, traces, jnp.zeros(()) if rigid else change)

    def period(carry, index):
        state, past, guess = carry
        travelled = jnp.full(blocks, index * feed_per_tooth)
        state, (motion, guess, traces, change) = lax.scan(block, state, (angles, borders, past, guess, travelled))
        # Per block: the newest pass in front, the oldest forgotten.
        past = jax.tree.map(lambda new, old: jnp.concatenate([new[:, None], old[:, :-1]], axis=1), motion, past)
        return (state, past, guess), (traces, jnp.max(change))

    rest = jnp.zeros((blocks, settings.passes, 2, m))
    start = (jnp.zeros(2 * structure.coordinates), (rest, rest), (rest[:, 0, 0], rest[:, 0, 1]))
    index = jnp.arange(settings.periods, dtype=tau.dtype)
    _, ((force, axes, chip), change) = lax.scan(period, start, index)

    force = _trace(force)
    displacement = _trace(axes)
    largest = jnp.max(jnp.abs(force))
    residual = jnp.max(change) / jnp.where(largest > 0, largest, 1.0)
    finite = jnp.isfinite(largest) & jnp.all(jnp.isfinite(displacement))
    strayed = jnp.any(jnp.abs(displacement) > tool.radius)
    tolerance = max(RESIDUAL_TOLERANCE, 32 * float(jnp.finfo(force.dtype).eps))
    status = jnp.where(~finite, 3, jnp.where(strayed, 2, jnp.where(residual > tolerance, 1, 0)))
    return Simulation(
        time=(jnp.arange(settings.steps) + 0.5) * (tau / steps),
        force=jnp.pad(force, ((0, 0), (0, 1))),
        displacement=displacement,
        chip_thickness=_by_tooth(chip, teeth),
        residual=lax.stop_gradient(residual),
        status=status,
        axes=structure.axes,
    )


def _geometry(case: Case, m: int) -> tuple[Angles, Borders]:
    """Directions and borders of every block of the first tooth period; in later ones only the feed has gone on."""
    tool, cut, settings = case.tool, case.cut, case.settings
    steps = settings.steps_per_tooth
    step_angle = 2 * np.pi / (tool.teeth * steps)
    step = np.arange(steps).reshape(settings.blocks, 1, 1, m)
    phi = np.arange(tool.teeth)[:, None] * (2 * np.pi / tool.teeth) + (step + 0.5) * step_angle
    advance = cut.feed_per_tooth(tool) / steps
    centres = [(cut.start[0] + advance * (step + end), cut.start[1]) for end in (0, 1)]
    angles = Angles(jnp.asarray(np.cos(phi[:, 0])), jnp.asarray(np.sin(phi[:, 0])))
    return angles, borders_met(case.stock, tool.radius, centres, phi, step_angle)


def _trace(blocks: Float[Array, "periods blocks columns m"]) -> Float[Array, "steps columns"]:
    """Blocks of traces, one row per column, as one array with time first."""
    periods, per_period, columns, m = blocks.shape
    return jnp.moveaxis(blocks, 2, 3).reshape(periods * per_period * m, columns)


def _by_tooth(chip: Float[Array, "periods blocks teeth m"], teeth: int) -> Float[Array, "steps teeth"]:
    """From places around the tool to teeth: in period b the tooth i stands at place i + b."""
    periods = chip.shape[0]
    place = (np.arange(teeth)[None, :] + np.arange(periods)[:, None]) % teeth
    chip = jnp.moveaxis(chip, 2, 1).reshape(periods, teeth, -1)
    return _trace(jnp.take_along_axis(chip, jnp.asarray(place)[:, :, None], axis=1)[:, None])
