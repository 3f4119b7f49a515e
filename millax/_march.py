"""Marching through the tooth periods, and how all of it changes with the inputs.

The state of the structure and the passes that are remembered go from one tooth period to the next; within a period each
block is solved at once (`_block.solve`).

The derivative follows the computation, not the program. With the motion known, a linear march goes through the periods once
more: in each the process is linearised once, however many inputs there are, and of the structure's matrices only their
products with known states and forces change. Forward derivatives store nothing beyond the traces; reverse ones store the
linearised process, or, in a long simulation, only the state at the start of every `STRETCH` periods.
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float

from ._block import Conditions, Forces, Process, Slice, anywhere, difference, norm, product, solve
from ._chip import Commanded, Earlier
from ._einsum import LONGEST
from ._forces import ForceLaw
from ._history import earlier_motion
from ._linear import Others, contract, linearise, respond
from ._math import stored
from ._response import BlockResponse
from ._types import Scalar

STRETCH = 1024
"""Tooth periods between two checkpoints of the reverse derivative."""


class Place(NamedTuple):
    """Where the teeth are in the steps of a block, in each slice of the tool; but for the feed."""

    slices: Slice
    lowest: Float[Array, "slices 2 borders teeth"]
    """Smallest distance of each tooth from each border, outside is negative: all around, and in the front half [m]."""
    highest: Float[Array, "slices 2 borders teeth"]
    """Largest distance, the same [m]."""


class Model(NamedTuple):
    """All that a simulation depends on.

    What is called a period here is a tooth period, cut into blocks. Where the teeth are not equally spaced, a surface may
    have been left less than that before it is met: then a period is as long as a block, and there is one block in it.

    `place` has an entry per block, and before that one per period of a turn, or a single one where all teeth are equal: then
    every period is like the one before.
    """

    law: ForceLaw
    depth: Scalar
    """Of a slice [m]."""
    width: Scalar
    advance: Scalar
    """Feed in a period [m]."""
    lead: Float[Array, "passes teeth"] | None
    """See `Commanded`."""
    feed_per_tooth: Scalar
    feed_rate: Scalar
    tip_speed: Scalar
    radius: Scalar
    place: Place
    response: BlockResponse
    contraction: Scalar
    """By how much a sweep makes the error in a block smaller, expected [-]."""
    tolerance: Scalar
    """Error of the force in a block that may be left, over the largest force [-]."""
    periods: Scalar
    """Periods that count. A march in several stretches goes on for a few more."""
    steps_per_tooth: int
    step_angle: float

    @property
    def dt(self) -> Scalar:
        """The time step [s], as the angle between two steps over the speed of the spindle."""
        return self.step_angle * self.radius / self.tip_speed


class Past(NamedTuple):
    """Motions of the tool in one period, or in several remembered ones, the newest in front."""

    displacement: Float[Array, "... 2 m"]
    velocity: Float[Array, "... 2 m"]


class Carry(NamedTuple):
    """What one tooth period leaves to the next; all but the state has one entry per block."""

    state: Float[Array, " states"]
    past: Past
    last: Forces
    """Forces in the last period [N]."""
    before: Forces
    """And in the one before [N]."""
    trend: Scalar
    """How much of the change from one period to the next comes again in the next one [-]."""
    largest: Scalar
    """Largest force so far, root mean square of its components over a block [N]."""
    peaks: tuple[Forces, Float[Array, "2 m"]]
    """Largest absolute values so far in each step of a block: of the forces [N], of the displacement [m]."""
    contraction: Scalar
    """See `Solution`: the largest so far."""


class Traces(NamedTuple):
    """What is kept of every block of every period."""

    state: Float[Array, "periods blocks states"]
    force: Forces
    motion: Past
    thickness: Float[Array, "periods blocks teeth m"]
    """Without derivatives."""
    error: Float[Array, "periods blocks"]
    """See `Solution`. Without derivatives."""


def at_rest(model: Model, passes: int) -> Carry:
    """The tool before the first period."""
    turn, blocks, _, teeth, m = model.place.slices.angles.cos.shape
    # Teeth that are not equally spaced look back to a time between the samples; that many passes take so many turns at most.
    kept = passes if model.lead is None else -(-passes // teeth) * turn
    still = jnp.zeros((blocks, kept, 2, m))
    none = tuple(jnp.zeros((blocks, m)) for _ in model.response.motion.by)
    zero = jnp.zeros_like(model.contraction)
    state = jnp.zeros(len(model.response.motion.free))
    peaks = (tuple(along[0] for along in none), still[0, 0])
    return Carry(state, Past(still, still), none, none, zero, zero, peaks, model.contraction)


def march(model: Model, start: Carry, periods: int, *, sweeps: int) -> tuple[Carry, Traces]:
    """Simulate so many periods: what they leave, and their traces."""
    # Stretches of equal length, with a few periods more than asked for, so that one program serves them all.
    stretches = -(-periods // STRETCH)
    length = -(-periods // stretches)
    number = jnp.arange(stretches * length, dtype=model.response.felt.free.dtype).reshape(stretches, length)
    if stretches == 1:
        return stretch(model, start, number[0], sweeps=sweeps)
    checkpointed = jax.checkpoint(lambda carry, number: stretch(model, carry, number, sweeps=sweeps))
    end, traces = lax.scan(checkpointed, start, number)
    return end, jax.tree.map(lambda x: x.reshape(-1, *x.shape[2:])[:periods], traces)


def process(model: Model, place: Place, past: Past, period: Scalar) -> Process:
    """What turns displacement into force in one block of one tooth period."""
    slices, commanded, conditions = surroundings(model, place, period)
    reached = _within_reach(model, place, period * model.advance, past.displacement)
    return Process(slices, Earlier(*met_motions(model, past), commanded), conditions, *reached, step_angle=model.step_angle)


def surroundings(model: Model, place: Place, period: Scalar) -> Others:
    """What the force depends on beside the present and the earlier displacement of the tool."""
    lead = None if model.lead is None else model.lead[..., None]
    commanded = Commanded(model.feed_per_tooth, model.feed_rate, model.tip_speed, model.radius, lead)
    slices = place.slices._replace(borders=place.slices.borders.moved(period * model.advance))
    damping = None if model.law.process_damping is None else model.law.process_damping / model.tip_speed
    return Others(slices, commanded, Conditions(model.law, model.depth, model.width, damping))


def met_motions(model: Model, past: Past) -> Past:
    """Of the remembered motions those that count in a block: in the steps in which the surfaces were left that it meets."""
    return past if model.lead is None else Past(*earlier_motion(*past, model.lead * model.steps_per_tooth, model.dt))


def place_in(period: Scalar, places: Place) -> Place:
    """The places of a period, one per block."""

    def of(x):
        turn = len(x)
        return x[0] if turn == 1 else lax.dynamic_index_in_dim(x, period.astype(int) % turn, keepdims=False)

    return jax.tree.map(of, places)


@eqx.filter_custom_jvp
def stretch(model: Model, start: Carry, number: Float[Array, " periods"], *, sweeps: int) -> tuple[Carry, Traces]:
    """Periods with these numbers, from what the one before left."""
    response = model.response

    def block(carry, inputs):
        state, trend, largest, peaks, contraction, period = carry
        place, past, last, before = inputs
        newest = difference(last, before)
        free = response.motion.of_state(state)
        solution = solve(
            process(model, place, past, period),
            response.felt,
            response.felt_in(free),
            tuple(now + trend * new for now, new in zip(last, newest, strict=True)),
            contraction=contraction,
            allowed=model.tolerance * largest,
            sweeps=sweeps,
        )
        force = solution.force
        displacement, velocity, end = response.parted(free + response.motion.of_force(force))
        trend = _trend(difference(force, last), newest)
        largest = jnp.maximum(largest, norm(force) / (len(force) * len(force[0])) ** 0.5)
        counts = period < model.periods
        peaks = jax.tree.map(
            lambda peak, x: jnp.where(counts, jnp.maximum(peak, jnp.abs(x)), peak), peaks, (force, displacement)
        )
        contraction = jnp.maximum(contraction, solution.contraction)
        traces = Traces(state, force, Past(displacement, velocity), solution.thickness, solution.error)
        return (end, trend, largest, peaks, contraction, period), (force, traces)

    def tooth_period(carry, period):
        inputs = (place_in(period, model.place), carry.past, carry.last, carry.before)
        start = (carry.state, carry.trend, carry.largest, carry.peaks, carry.contraction, period)
        (state, *adapted, _), (force, traces) = lax.scan(block, start, inputs)
        return Carry(state, _shifted(carry.past, traces.motion), force, carry.last, *adapted), traces

    return lax.scan(tooth_period, start, number)


def _trend(change: Forces, newest: Forces) -> Scalar:
    """How much of the newest change between periods came again: least squares over a block."""
    size = product(newest, newest)
    return jnp.clip(product(change, newest) / jnp.where(size > 0, size, 1.0), -1.0, 1.0)


@stretch.def_jvp
def _stretch_jvp(primals, tangents, *, sweeps):
    model, start, number = primals
    end, traces = stretch(model, start, number, sweeps=sweeps)
    by_model, by_start, _ = tangents
    response = model.response

    def changes(place, by_place, period):
        """Of what the force depends on beside the motion of the tool."""

        def of(model, place):
            return surroundings(model, place, period)

        return eqx.filter_jvp(of, (model, place), (by_model, by_place))[1]

    def met_changes(past, change):
        """Of the motions that count in a block, by that of the remembered ones."""
        return change if model.lead is None else eqx.filter_jvp(met_motions, (model, past), (by_model, change))[1]

    # How the motion changes at a known state and force. The large matrices of long blocks are better multiplied by all at
    # once.
    by_response = _or_zero(response.motion, by_model.response.motion)
    known, extra = (traces.state, traces.force), by_response
    if len(by_response.by[0]) > LONGEST:
        known, extra = (jax.vmap(jax.vmap(by_response))(*known),), lambda known: known

    def block(carry, inputs):
        change, period = carry
        (touching, by), past, by_past, known, place, by_place = inputs
        direct = stored(touching, contract, by, met_changes(past, by_past), changes(place, by_place, period))
        free = extra(*known) + response.motion.of_state(change)
        force = tuple(respond(by.motion, direct, response.felt_in(free), response.felt, sweeps, touching))
        displacement, velocity, end = response.parted(free + response.motion.of_force(force))
        return (end, period), (change, force, Past(displacement, velocity))

    def linearised(place, by_place, past, motion, period):
        p = process(model, place, past, period)
        return p.touching, linearise(p, changes(place, by_place, period), felt(model, motion))

    def tooth_period(carry, inputs):
        state, by_past = carry
        past, motion, known, period = inputs
        place, by_place = place_in(period, model.place), place_in(period, by_model.place)
        by = jax.vmap(linearised, (0, 0, 0, 0, None))(place, by_place, past, motion, period)
        needed = None if model.lead is None else past
        (state, _), traces = lax.scan(block, (state, period), (by, needed, by_past, known, place, by_place))
        return (state, _shifted(by_past, traces[2])), traces

    zero = _or_zero((start.state, start.past), (by_start.state, by_start.past))
    (state, past), (states, forces, motion) = lax.scan(
        tooth_period, zero, (remembered(start.past, traces.motion), traces.motion, known, number)
    )
    nothing = jax.tree.map(jnp.zeros_like, (end[2:], traces.thickness, traces.error))
    return (end, traces), (Carry(state, past, *nothing[0]), Traces(states, forces, motion, *nothing[1:]))


def felt(model: Model, motion: Past) -> Float[Array, "... felt m"]:
    """What the force feels of a motion."""
    return motion.displacement if model.law.process_damping is None else jnp.concatenate(motion, axis=-2)


def _or_zero(values, tangents):
    """Tangents, with zeros where there is none."""
    return jax.tree.map(lambda v, d: jnp.zeros_like(v) if d is None else d, values, tangents)


def remembered(past: Past, motion: Past) -> Past:
    """The earlier passes as every period finds them."""

    def of(past, motion):  # (blocks, passes, 2, m) before the first period, and (periods, blocks, 2, m)
        passes = past.shape[1]
        whole = jnp.concatenate([jnp.moveaxis(past, 1, 0)[::-1], motion])
        return jnp.stack([whole[passes - 1 - k : len(whole) - 1 - k] for k in range(passes)], axis=2)

    return jax.tree.map(of, past, motion)


def _shifted(past: Past, motion: Past) -> Past:
    """The newest pass in front, the oldest forgotten."""
    return jax.tree.map(lambda old, new: jnp.concatenate([new[:, None], old[:, :-1]], axis=1), past, motion)


def _within_reach(model: Model, place: Place, travelled, displacement) -> tuple[Array, Bool[Array, ""], Bool[Array, ""]]:
    """Where no tooth meets a border, which ones are inside all borders, shape (slices, teeth, 1); whether one may meet the
    stock at all, and whether one may meet a border: judged from earlier displacements."""
    longest = 1.0 if model.lead is None else jnp.max(model.lead[0])
    feed = model.feed_per_tooth * longest
    place, travelled, feed, displacement = lax.stop_gradient((place, travelled, feed, displacement))
    newest = displacement[0]
    moved = jnp.max(jnp.abs(newest))
    change = jnp.max(jnp.abs(displacement[1:] - newest)) if len(displacement) > 1 else moved
    # The tool is where it was one period earlier, give or take some of what it changed by.
    reach = 2 * feed + 4 * change
    if place.slices.excess is not None:
        reach = reach + jnp.max(jnp.abs(lax.stop_gradient(place.slices.excess)))
    normals = place.slices.borders.normals[0, ..., 0]  # the same in all slices
    shift = normals[0] * (travelled + newest[0]) + normals[1] * newest[1]
    lowest = place.lowest - jnp.max(shift, axis=1, keepdims=True)
    highest = place.highest - jnp.min(shift, axis=1, keepdims=True)
    anyone, in_front = jnp.any((lowest < reach) & (highest > -reach), axis=(0, 2, 3))
    # Behind the tool nothing is left to cut, unless its vibration comes near the feed.
    near = in_front | (anyone & (change > feed / 20))
    inside = jnp.all(highest[:, 0] > -reach, axis=1)
    # Of the second part, which always holds, XLA does not know that: without it there would be no condition left in an
    # endless workpiece, and `stored` would store nothing.
    touching = jnp.any(inside) & ~(travelled < 0)
    # How far a tool that has not moved yet will give way is not known. A rigid one never does.
    unknown = moved == 0 if len(model.response.motion.free) else False
    return inside[..., None].astype(feed.dtype), anywhere(touching | unknown), anywhere(near | unknown)
