"""The simulation: from a case to its traces.

Tooth periods are marched through one after the other (`_march`), each computed at once in one or a few blocks (`_block`).
Within a block the surfaces left by earlier passes are known, so chip thickness and force of all its steps are one
vectorised expression of the tool's displacement; the displacement follows from the force by the structure's exact
response. The two are iterated from the force one tooth period earlier: how many sweeps it takes depends on how strongly
the force feels the displacement within a block (`Settings.suited` chooses). The error that the sweeps leave is estimated
in every simulation, as its residual.
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

from ._block import Slice, cutting
from ._case import Case
from ._chip import Angles
from ._contact import borders_met
from ._cut import Cut
from ._forces import ForceLaw
from ._gain import RERUNS, gain_of, reachable
from ._march import Carry, Model, Past, Place, at_rest, felt, march, place_in, process, remembered
from ._response import block_response
from ._settings import STEPS_PER_SLICE, Settings, steps_of_lag
from ._stock import Stock
from ._structure import Structure
from ._tool import EndMill
from ._types import Scalar

STATUS = {
    0: "ok",
    1: "the fixed-point sweeps have not converged: give more sweeps, or more blocks per tooth period",
    2: "the tool left its path by more than its radius: the cut is unstable or the structure too soft",
    3: "the traces hold numbers that are not finite: the cut is unstable, or a parameter is out of its range",
    4: "over the depth the helix wraps by more time steps than the slices resolve: give more of them (simulation.slices)",
}
"""What each `Simulation.status` means and what to try."""


TOGETHER = 16
"""Tooth periods whose chip thickness is computed at once: as many as the cache takes."""

SINGLE_PRECISION = "millax runs in float32. For full accuracy call millax.set_up() before anything else"
"""The warning of every computation in float32."""


class SimulationError(RuntimeError):
    """A simulation that must not be used; the message says why and what to try."""


class Simulation(eqx.Module):
    """Traces of one simulated cut. Sample j belongs to the middle of time step j.

    **Attributes:**

    - `time`: t [s], shape (steps,).
    - `force`: mean force on the tool over each step, in the workpiece frame [N], shape (steps, 3).
    - `displacement`: deviation of the tool centre from its commanded path [m], shape (steps, axes).
    - `chip_thickness`: mean over each step, per tooth [m], shape (steps, teeth).
    - `residual`: error of the force that the sweeps leave, estimated, over the largest force [-].
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
    - `throw`: repeat the simulation with more sweeps where those of the settings do not converge, and raise
      `SimulationError` when the result must not be used. Under `jit`, `grad` or `vmap` neither can be done: look at
      `Simulation.status` there.

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
                SINGLE_PRECISION,
                stacklevel=2,
            )
        for _ in range(RERUNS if throw else 0):
            if int(sim.status) == 1:
                case = case.with_settings(sweeps=2 * case.settings.sweeps)
                sim = _simulate(case)
        status = int(sim.status)
        if throw and status:
            raise SimulationError(f"{STATUS[status]} (residual {float(sim.residual):.1e})")
    return sim


@eqx.filter_jit
def _simulate(case: Case) -> Simulation:
    tool, settings, structure = case.tool, case.settings, case.at_tool
    model = model_of(case)
    steps = settings.steps_per_tooth
    _, blocks, _, _, m = model.place.slices.angles.cos.shape
    forces = len(model.response.motion.by)
    sweeps = settings.sweeps if structure.coordinates else 1
    start = at_rest(model, settings.passes)
    periods = settings.steps // (blocks * m)
    end, traces = march(model, start, periods, sweeps=sweeps)
    state, force, motion, chip, error = traces
    *largest, moved = lax.stop_gradient(end.peaks)
    chip, error = lax.stop_gradient((chip, error))
    chip = _with_derivatives_of(chip, _chips(model, start, motion))
    if structure.mode_shapes is None and set(structure.axes) <= set("xy"):
        displacement = motion.displacement[..., tuple("xy".index(axis) for axis in structure.axes), :]
    else:
        displacement = moved = jax.vmap(jax.vmap(model.response.axes))(state, force)
    displacement = _trace(displacement.reshape(periods, blocks, len(structure.axes), m))
    largest = jnp.max(jnp.stack(jax.tree.leaves(largest)))
    residual = jnp.max(error) / jnp.where(largest > 0, largest, 1.0)
    return Simulation(
        time=(jnp.arange(settings.steps) + 0.5) * (case.cut.tooth_period(tool) / steps),
        force=jnp.stack([*(along.ravel() for along in force), *[jnp.zeros(settings.steps)] * (3 - forces)], axis=1),
        displacement=displacement,
        chip_thickness=_by_tooth(chip) if case.equal_teeth else _trace(chip),
        residual=residual,
        status=status_of(case, largest, moved, residual),
        axes=structure.axes,
    )


def model_of(case: Case) -> Model:
    """All that the march through the tooth periods depends on."""
    tool, cut, settings = case.tool, case.cut, case.settings
    law = case.force.for_steps(tool.teeth)
    steps = settings.steps_per_tooth
    m = steps // settings.blocks
    dt = cut.tooth_period(tool) / steps
    response = block_response(
        case.at_tool, dt, m, forces=2 if law.ka is None else 3, felt=2 if law.process_damping is None else 4
    )
    lead = tool.lead(settings.passes)
    parts = 1 if lead is None else settings.blocks  # of a tooth period, which the march calls periods: see `Model`
    return Model(
        law=law,
        depth=cut.depth / settings.slices,
        width=settings.width,
        advance=cut.feed_per_tooth(tool) / parts,
        lead=lead,
        feed_per_tooth=cut.feed_per_tooth(tool),
        feed_rate=cut.feed_rate,
        tip_speed=cut.spindle_speed * tool.radius,
        radius=tool.radius,
        place=_places(case, m),
        response=response,
        contraction=lax.stop_gradient(jnp.sum(gain_of(tool, case.force, cut, settings.width, response.to_one_step()))),
        tolerance=reachable(settings.tolerance, dt.dtype),
        periods=jnp.asarray(settings.periods * parts, dt.dtype),
        steps_per_tooth=steps,
        step_angle=2 * np.pi / (tool.teeth * steps),
    )


def _chips(model: Model, start: Carry, motion: Past) -> Float[Array, "periods blocks teeth m"]:
    """Chip thickness of known motions."""

    def of_period(inputs):
        period, past, motion = inputs
        return jax.vmap(lambda place, past, motion: cutting(process(model, place, past, period), felt(model, motion))[1])(
            place_in(period, model.place), past, motion
        )

    number = jnp.arange(len(motion.velocity), dtype=model.response.felt.free.dtype)
    return _map_periods(of_period, (number, remembered(start.past, motion), motion))


def _map_periods(function, inputs):
    """`function` of every period, a few of them at a time."""
    # lax.map with a batch size would compile the function once more for the remainder: it is filled up instead.
    periods = len(jax.tree.leaves(inputs)[0])
    together = min(TOGETHER, periods)
    missing = -periods % together

    def fill(x):
        return jnp.pad(x, [(0, missing)] + [(0, 0)] * (x.ndim - 1), mode="edge").reshape(-1, together, *x.shape[1:])

    found = lax.map(jax.vmap(function), jax.tree.map(fill, inputs))
    return jax.tree.map(lambda x: x.reshape(x.shape[0] * x.shape[1], *x.shape[2:])[:periods], found)


def status_of(case: Case, force, displacement, residual) -> Int[Array, ""]:
    """The status of a simulation with these traces, or with their peaks: the most serious that applies."""
    tool, settings = case.tool, case.settings
    largest, moved = jnp.max(jnp.abs(force)), jnp.max(jnp.abs(displacement), initial=0.0)
    finite = jnp.isfinite(largest) & jnp.isfinite(moved)
    converged = residual <= reachable(settings.tolerance, force.dtype)
    sliced = steps_of_lag(tool, case.cut, settings.steps_per_tooth) <= STEPS_PER_SLICE * settings.slices
    found = jnp.where(sliced, jnp.where(converged, 0, 1), 4)
    return jnp.where(~finite, 3, jnp.where(moved > tool.radius, 2, found))


@jax.custom_jvp
def _with_derivatives_of(value, model):
    """`value`, which is `model` computed before: where nobody asks for derivatives, `model` need not be computed."""
    return value


@_with_derivatives_of.defjvp
def _derivatives_of_model(primals, tangents):
    return primals[0], tangents[1]


def _places(case: Case, m: int) -> Place:
    """Directions and borders of every block of the first period, in later ones only the feed has gone on; or of every period
    of a turn where the teeth are not equal."""
    tool, cut, settings = case.tool, case.cut, case.settings
    steps = settings.steps_per_tooth
    step_angle = 2 * np.pi / (tool.teeth * steps)
    period = steps if tool.pitch is None else m  # see `Model`
    turn = 1 if case.equal_teeth else tool.teeth * steps // period
    # Axes: periods, blocks, slices, borders, teeth, steps of a block.
    step = np.arange(period).reshape(1, -1, 1, 1, 1, m)
    begin = np.arange(turn).reshape(-1, 1, 1, 1, 1, 1) * period
    phi = tool.spacing[:, None] + (begin + step + 0.5) * step_angle
    lag = tool.lag((jnp.arange(settings.slices) + 0.5) * (cut.depth / settings.slices))
    if settings.slices > 1 or tool.helix is not None:
        phi = phi - lag[:, None, None, None]
    deviation = tool.deviation(lag)
    radius = tool.radius if deviation is None else (tool.radius + deviation)[:, None, :, None]
    advance = cut.feed_per_tooth(tool) / steps
    centres = [(cut.start[0] + advance * (step + end), cut.start[1]) for end in (0, 1)]
    angles = Angles(jnp.cos(phi[..., 0, :, :]), jnp.sin(phi[..., 0, :, :]))
    borders = borders_met(case.stock, radius, centres, phi, step_angle)
    arc = tool.radius * step_angle**2 / 8  # height of the path of a tip over its chord in a step
    inner = jnp.minimum(borders.before, borders.after) - arc
    outer = jnp.maximum(borders.before, borders.after) + arc
    front = jnp.cos(phi) > -0.5
    lowest = [jnp.min(d, axis=-1) for d in (inner, jnp.where(front, inner, jnp.inf))]
    highest = [jnp.max(d, axis=-1) for d in (outer, jnp.where(front, outer, -jnp.inf))]
    slices = Slice(angles, _excess(deviation, settings.passes, angles.cos.shape), borders)
    return Place(slices, jnp.stack(lowest, axis=3), jnp.stack(highest, axis=3))


def _excess(deviation, passes: int, shape) -> Float[Array, "turn blocks slices passes teeth 1"] | None:
    """By how much each tooth reaches farther than the one that cut before it, one pass earlier and so on [m]."""
    if deviation is None:
        return None
    before = jnp.stack([jnp.roll(deviation, -k, axis=-1) for k in range(1, passes + 1)], axis=-2)
    return jnp.broadcast_to((deviation[..., None, :] - before)[..., None], (*shape[:2], *before.shape, 1))


def _trace(blocks: Float[Array, "periods blocks columns m"]) -> Float[Array, "steps columns"]:
    """Blocks of traces, one row per column, as one array with time first."""
    periods, per_period, columns, m = blocks.shape
    return jnp.moveaxis(blocks, 2, 3).reshape(periods * per_period * m, columns)


def _by_tooth(chip: Float[Array, "periods blocks teeth m"]) -> Float[Array, "steps teeth"]:
    """From places around the tool to teeth: in period b the tooth i stands at place i + b."""
    periods, _, teeth, _ = chip.shape
    turns = jnp.pad(chip, ((0, -periods % teeth), (0, 0), (0, 0), (0, 0))).reshape(-1, teeth, *chip.shape[1:])
    turned = jnp.stack([jnp.roll(turns[:, b], -b, axis=2) for b in range(teeth)], axis=1)
    return _trace(turned.reshape(-1, *chip.shape[1:])[:periods])
