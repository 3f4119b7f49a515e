"""Marching through the tooth periods, and how all of it changes with the inputs.

The state of the structure and the passes that are remembered go from one tooth period to the next; within a period each
block is solved at once (`_block.solve`).

The derivative follows the computation, not the program. Once the motion is known, the process is linearised in all
periods at once, and the changes then go through a linear march of their own: however many inputs there are, the process is
differentiated once, and of the structure's matrices only their products with known states and forces change. Forward
derivatives store nothing beyond the traces; reverse ones store the linearised process, or, in a long simulation, only the
state at the start of every `STRETCH` periods.
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float

from ._block import Conditions, Guess, Pair, Process, solve
from ._chip import Angles, Earlier
from ._contact import Borders
from ._forces import ForceLaw
from ._linear import contract, linearise, respond
from ._response import BlockResponse
from ._types import Scalar

STRETCH = 1024
"""Tooth periods between two checkpoints of the reverse derivative."""

TOGETHER = 16
"""Tooth periods linearised at once: as many as the cache takes."""


class Place(NamedTuple):
    """Where the teeth are in the steps of a block, the same in every tooth period but for the feed."""

    angles: Angles
    borders: Borders
    nearest: Float[Array, "2 borders"]
    """Smallest distance from each border, outside is negative: of any tooth, and of those in the front half [m]."""
    farthest: Float[Array, " borders"]
    """Largest distance of a tooth from each border [m]."""


class Model(NamedTuple):
    """All that a simulation depends on. `place` has one entry per block."""

    law: ForceLaw
    depth: Scalar
    width: Scalar
    feed_per_tooth: Scalar
    feed_rate: Scalar
    tip_speed: Scalar
    radius: Scalar
    place: Place
    response: BlockResponse
    step_angle: float


class Past(NamedTuple):
    """Motions of the tool in one period, or in several remembered ones."""

    displacement: Float[Array, "... 2 m"]
    velocity: Float[Array, "... 2 m"]


class Carry(NamedTuple):
    """What one tooth period leaves to the next; all but the state has one entry per block."""

    state: Float[Array, " states"]
    past: Past
    guess: Guess


class Traces(NamedTuple):
    """What is kept of every block of every period."""

    state: Float[Array, "periods blocks states"]
    force: Pair
    motion: Past
    thickness: Float[Array, "periods blocks teeth m"]
    """Without derivatives."""
    changes: tuple[Float[Array, "periods blocks"], Float[Array, "periods blocks"]]
    """See `Solution`. Without derivatives."""


def at_rest(blocks: int, passes: int, m: int, states: int) -> Carry:
    """The tool before the first period."""
    still, nothing = jnp.zeros((blocks, passes, 2, m)), jnp.zeros((blocks, m))
    return Carry(jnp.zeros(states), Past(still, still), Guess((nothing, nothing), jnp.zeros((blocks, 2 * m))))


def march(model: Model, start: Carry, periods: int, *, sweeps: int) -> Traces:
    """Simulate `periods` tooth periods."""
    # Stretches of equal length, with a few periods more than asked for, so that one program serves them all.
    stretches = -(-periods // STRETCH)
    length = -(-periods // stretches)
    number = jnp.arange(stretches * length, dtype=model.response.position.free.dtype).reshape(stretches, length)
    if stretches == 1:
        return stretch(model, start, number[0], sweeps=sweeps)[1]
    checkpointed = jax.checkpoint(lambda carry, number: stretch(model, carry, number, sweeps=sweeps))
    traces = lax.scan(checkpointed, start, number)[1]
    return jax.tree.map(lambda x: x.reshape(-1, *x.shape[2:])[:periods], traces)


def process(model: Model, place: Place, past: Past, period: Scalar) -> Process:
    """What turns displacement into force in one block of one tooth period."""
    travelled = period * model.feed_per_tooth
    earlier = Earlier(*past, model.feed_per_tooth, model.feed_rate, model.tip_speed, model.radius)
    conditions = Conditions(model.law, model.depth, model.width, place.borders.moved(travelled))
    touching, near = _within_reach(model, place, travelled, past.displacement)
    return Process(place.angles, earlier, conditions, touching, near, step_angle=model.step_angle)


@eqx.filter_custom_jvp
def stretch(model: Model, start: Carry, number: Float[Array, " periods"], *, sweeps: int) -> tuple[Carry, Traces]:
    """Tooth periods with these numbers, from what the one before left."""
    position, velocity, end = model.response.position, model.response.velocity, model.response.end

    def block(carry, inputs):
        state, period = carry
        place, past, guess = inputs
        solution = solve(process(model, place, past, period), position, state, guess, sweeps=sweeps)
        force = solution.end.force
        motion = Past(solution.displacement, velocity(state, force).reshape(2, -1))
        return (end(state, force), period), (
            solution.end,
            Traces(state, force, motion, solution.thickness, solution.changes),
        )

    def tooth_period(carry, period):
        (state, _), (guess, traces) = lax.scan(block, (carry.state, period), (model.place, carry.past, carry.guess))
        return Carry(state, _shifted(carry.past, traces.motion), guess), traces

    return lax.scan(tooth_period, start, number)


@stretch.def_jvp
def _stretch_jvp(primals, tangents, *, sweeps):
    model, start, number = primals
    end, traces = stretch(model, start, number, sweeps=sweeps)
    by_model, by_start, _ = tangents
    response, states, forces = model.response, traces.state, traces.force

    def motions(response):
        """Of all blocks, from known states and forces."""
        return tuple(
            jax.vmap(jax.vmap(part))(states, forces) for part in (response.position, response.velocity, response.end)
        )

    value, extra = eqx.filter_jvp(motions, (response,), (by_model.response,))
    extra = _or_zero(value, extra)

    def linearised(inputs):
        """Derivatives by past and present displacement in one period, and the direct effect of the model."""
        period, past, displacement = inputs

        def of_block(place, by_place, past, displacement):
            def of_model(model, place):
                return process(model, place, past, period)

            # The value is computed apart: under a derivative, `anywhere` would decide for every member on its own.
            _, change = eqx.filter_jvp(of_model, (model, place), (by_model, by_place))
            return linearise(of_model(model, place), change, displacement)

        return jax.vmap(of_block)(model.place, by_model.place, past, displacement)

    pasts = remembered(start.past, traces.motion)
    by, direct = map_periods(linearised, (number, pasts, traces.motion.displacement))

    def block(change, inputs):
        by, direct, past, (position, velocity, end) = inputs
        direct = direct + contract(by[:2], tuple(past))
        displaced = position + response.position.of_state(change)
        displacement, force = respond(by.displacement, direct, displaced, response.position, sweeps)
        velocity = velocity + response.velocity(change, force)
        motion = Past(displacement, velocity.reshape(2, -1))
        return end + response.end(change, force), (change, force, motion)

    def tooth_period(carry, inputs):
        state, past = carry
        by, direct, extra = inputs
        state, traces = lax.scan(block, state, (by, direct, past, extra))
        return (state, _shifted(past, traces[2])), traces

    zero = _or_zero((start.state, start.past), (by_start.state, by_start.past))
    (state, past), (states, forces, motion) = lax.scan(tooth_period, zero, (by, direct, extra))
    nothing = jax.tree.map(jnp.zeros_like, (end.guess, traces.thickness, traces.changes))
    return (end, traces), (Carry(state, past, nothing[0]), Traces(states, forces, motion, *nothing[1:]))


def map_periods(function, inputs):
    """`function` of every period, a few of them at a time."""
    # lax.map with a batch size would compile the function once more for the remainder: it is filled up instead.
    periods = len(jax.tree.leaves(inputs)[0])
    together = min(TOGETHER, periods)
    missing = -periods % together

    def fill(x):
        return jnp.pad(x, [(0, missing)] + [(0, 0)] * (x.ndim - 1), mode="edge").reshape(-1, together, *x.shape[1:])

    found = lax.map(jax.vmap(function), jax.tree.map(fill, inputs))
    return jax.tree.map(lambda x: x.reshape(-1, *x.shape[2:])[:periods], found)


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


def _within_reach(model: Model, place: Place, travelled, displacement) -> tuple[Bool[Array, ""], Bool[Array, ""]]:
    """Whether a tooth may meet the stock at all, and whether one may meet a border, judged from earlier displacements."""
    place, travelled, feed, displacement = lax.stop_gradient((place, travelled, model.feed_per_tooth, displacement))
    newest = displacement[0]
    moved = jnp.max(jnp.abs(newest))
    change = jnp.max(jnp.abs(newest - displacement[1])) if len(displacement) > 1 else moved
    reach = 2 * (feed + moved)
    gone = place.borders.normals[0].ravel() * travelled
    ahead = place.nearest[1] - gone < reach
    # Behind the tool nothing is left to cut, unless its vibration comes near the feed.
    behind = (place.nearest[0] - gone < reach) & (change > feed / 20)
    touching = jnp.all(place.farthest - gone > -reach)
    # How far a tool that has not moved yet will give way is not known. A rigid one never does.
    unknown = moved == 0 if len(model.response.end.free) else False
    return anywhere(touching | unknown), anywhere(jnp.any(ahead | behind) | unknown)


@jax.custom_batching.custom_vmap
def anywhere(flag: Bool[Array, ""]) -> Bool[Array, ""]:
    """The flag itself; in a batch, whether any member has it: all then take the same way, and XLA only that one."""
    return flag


@anywhere.def_vmap
def _anywhere_in_batch(size, batched, flags):
    return anywhere(jnp.any(flags)), False  # once more, for batches of batches
