"""The steady cut: a case without entry and exit along the feed, as stability sees it.

In a workpiece without borders across the feed nothing changes from one period to the next but the feed, so the cut has a
periodic orbit, and what the tool does in one period is a map of what it did before (`Period`). A period is a tooth period,
or a turn where the teeth are not equal. This file is the only one about stability that knows how the engine is called.
"""

import dataclasses
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.core import Tracer
from jaxtyping import Array, Float

from ._block import cutting
from ._case import Case
from ._check import concrete
from ._chip import Earlier
from ._march import Carry, Model, Past, at_rest, march, process
from ._simulate import model_of
from ._stock import Stock
from ._types import AXES


class ProcessMatrices(NamedTuple):
    """Derivatives of the mean force on the tool in each of the L steps of a period.

    Entry (i, j) of each matrix belongs to the force along i and the motion along j, i and j out of x and y.
    """

    now: Float[Array, "L 2 2"]
    """By the present displacement [N/m]."""
    now_rate: Float[Array, "L 2 2"]
    """By the present velocity [N s/m]: process damping."""
    earlier: Float[Array, "delays L 2 2"]
    """By the displacement one delay earlier [N/m]."""
    earlier_rate: Float[Array, "delays L 2 2"]
    """By the velocity then [N s/m]."""
    lags: Float[Array | np.ndarray, " delays"]
    """The delays in steps."""
    longest: float
    """What no delay exceeds, whatever the pitch of the teeth."""


class Orbit(NamedTuple):
    """What a period leaves to the next, as far as the motion depends on it: the state of the map over a period.

    All in metres: velocities are multiplied by the time step.
    """

    state: Float[Array, " states"]
    displacement: Float[Array, "blocks passes 2 m"]
    travel: Float[Array, "blocks passes 2 m"]
    """Velocity times the time step."""


def along_feed(stock: Stock) -> tuple[int, ...]:
    """Which borders of the stock run along the feed. Those across it are left out: the tool is far from its ends.

    Raises `ValueError` for an oblique border, along which the cut has no period.
    """
    normals = concrete(stock.normals)
    if normals is None:
        raise ValueError("stability: the borders of the stock are traced; call it outside jit")
    along, across = (np.abs(normals[:, i]) for i in range(2))
    if np.any((along > 1e-9) & (across > 1e-9)):
        raise ValueError(
            "stock: a border that is oblique to the feed is given; the cut then changes from tooth to tooth, and has no "
            "limit of stability. Use borders along x and y"
        )
    return tuple(int(i) for i in np.flatnonzero(along < 0.5))


def steady(case: Case, borders: tuple[int, ...]) -> Case:
    """The case with only these borders of its stock."""
    kept = np.array(borders, dtype=int)
    return dataclasses.replace(case, stock=Stock(case.stock.normals[kept], case.stock.offsets[kept]))


def with_cut(case: Case, speed, feed_rate, depth) -> Case:
    """The case with another spindle speed [rad/s], feed rate [m/s] and depth [m]."""
    where = lambda c: (c.cut.spindle_speed, c.cut.feed_rate, c.cut.depth)  # noqa: E731
    return eqx.tree_at(where, case, tuple(map(jnp.asarray, (speed, feed_rate, depth))))


TOGETHER = 16
"""Cuts for which a program is called at most."""


def one_by_one(function, cuts):
    """`function` of n cuts, arrays of shape (n,), as NumPy arrays. It takes up to `TOGETHER` at a time, and their number as
    an argument: one program serves every n."""
    n, parts = len(cuts[0]), []
    for first in range(0, n, TOGETHER):
        count = min(TOGETHER, n - first)
        part = np.minimum(np.arange(first, first + TOGETHER), n - 1)
        # A plain number would be compiled in.
        found = function(tuple(jnp.asarray(x, dtype=float)[part] for x in cuts), jnp.asarray(count))
        parts.append(jax.tree.map(lambda x, count=count: np.asarray(x)[:count], found))
    return jax.tree.map(lambda *x: np.concatenate(x), *parts)


def looped(function, cuts, count):
    """`function` of the first `count` cuts, one after the other; zeros for those after them."""
    shapes = jax.eval_shape(function, *(x[0] for x in cuts))
    start = jax.tree.map(lambda x: jnp.zeros((len(cuts[0]), *x.shape), x.dtype), shapes)

    def step(i, found):
        return jax.tree.map(lambda all, one: all.at[i].set(one), found, function(*(x[i] for x in cuts)))

    return lax.fori_loop(0, count, step, start)


def is_traced(case: Case) -> bool:
    """Whether some number of the case has no value yet."""
    return any(isinstance(leaf, Tracer) for leaf in jax.tree.leaves(case))


def seen(case: Case) -> tuple[int, ...]:
    """The directions, out of 0 (x) and 1 (y), in which the tool moves."""
    return tuple(i for i, axis in enumerate(AXES[:2]) if axis in case.at_tool.axes)


def process_matrices(case: Case, steps: int) -> ProcessMatrices:
    """The linearised cutting process of a tool that stays on its path.

    **Arguments:**

    - `case`: a steady one, see `steady`.
    - `steps`: into which a tooth period is divided, >= 10.

    Teeth of equal radii feel only the last pass; others as many as the settings of the case remember.
    """
    passes = 1 if case.tool.equal_radii else case.settings.passes
    model = model_of(case.with_settings(steps_per_tooth=steps, blocks=1, passes=passes))
    teeth = case.tool.teeth
    shape = (passes, 2, steps) if model.lead is None else (passes, 2, teeth, steps)
    earlier = int(np.prod(shape[:-1]))
    felt = model.response.feels

    def force(place, motions):
        now, past, rate = motions[:felt], motions[felt : felt + earlier], motions[felt + earlier :]
        found = process(model, place, jax.tree.map(lambda x: x[0], at_rest(model, passes).past), jnp.zeros_like(model.depth))
        found = dataclasses.replace(
            found, earlier=Earlier(past.reshape(shape), rate.reshape(shape), found.earlier.commanded)
        )
        return jnp.stack(cutting(found, now)[0][:2])  # (2, steps)

    # No step feels another: one change of a whole trace at a time gives the derivatives of all steps.
    still = jnp.zeros((felt + 2 * earlier, steps))
    unit = jnp.eye(len(still))[..., None] * jnp.ones(steps)

    def by_motions(place):
        return jax.vmap(lambda d: jax.jvp(lambda x: force(place, x), (still,), (d,))[1], out_axes=-1)(unit)

    by = jax.vmap(by_motions, out_axes=1)(jax.tree.map(lambda x: x[:, 0], model.place))  # (2, periods, steps, motions)
    by = jnp.moveaxis(by.reshape(2, -1, len(still)), 0, 1)
    now, past, rate = jnp.split(by, [felt, felt + earlier], axis=-1)

    def by_delay(matrices):
        split = matrices.reshape(*matrices.shape[:2], passes, 2, -1)
        return jnp.moveaxis(split, (2, 4, 3), (0, 1, 4)).reshape(-1, len(by), 2, 2)

    lags = np.arange(1.0, passes + 1) * steps if model.lead is None else model.lead.ravel() * steps
    longest = passes * steps if model.lead is None else -(-passes // teeth) * teeth * steps
    now_rate = now[..., 2:] if felt == 4 else jnp.zeros_like(now)
    return ProcessMatrices(now[..., :2], now_rate, by_delay(past), by_delay(rate), lags, float(longest))


class Period(eqx.Module):
    """The engine over one period, as a map from `Orbit` to `Orbit`."""

    model: Model
    sweeps: int = eqx.field(static=True)
    passes: int = eqx.field(static=True)
    tooth_periods: int = eqx.field(static=True)
    """How long a period is."""

    @staticmethod
    def of(case: Case) -> "Period":
        """For a steady case. Its settings count: steps, blocks, sweeps, passes, width and tolerance."""
        sweeps = case.settings.sweeps if case.at_tool.coordinates else 1
        return Period(model_of(case), sweeps, case.settings.passes, 1 if case.equal_teeth else case.tool.teeth)

    def at_rest(self) -> Orbit:
        """The tool on its path."""
        still = at_rest(self.model, self.passes)
        return Orbit(still.state, *still.past)

    def __call__(self, orbit: Orbit) -> Orbit:
        """One period later."""
        return self.after(orbit, 1)[0]

    def after(self, orbit: Orbit, periods: int) -> tuple[Orbit, Float[Array, "periods 2 steps"]]:
        """So many periods later, and the displacement meanwhile [m]."""
        end, traces = march(self.model, self._carry(orbit), periods * self._marched, sweeps=self.sweeps)
        displacement = traces.motion.displacement
        displacement = displacement.reshape(periods, -1, *displacement.shape[2:])
        return self._orbit(end), jnp.moveaxis(displacement, 2, 1).reshape(periods, 2, -1)

    def under_rigid_force(self) -> Orbit:
        """The periodic motion under the force that a tool of equal teeth would meet on its path: close to the orbit."""
        model, still = self.model, self.at_rest()
        shape = still.displacement.shape
        past = Past(still.displacement[0], still.travel[0])
        zero = jnp.zeros_like(model.depth)
        places = jax.tree.map(lambda x: x[0], model.place)
        motionless = jnp.zeros((model.response.feels, shape[-1]))
        force, _ = jax.vmap(lambda place: cutting(process(model, place, past, zero), motionless))(places)

        def motion(state):
            def block(state, force):
                displacement, velocity, end = model.response.parted(model.response.motion(state, force))
                return end, (displacement, velocity)

            return lax.scan(block, state, force)

        n = len(still.state)
        pushed, _ = motion(still.state)
        free = jax.jacfwd(lambda state: motion(state)[0])(still.state)
        state = jnp.linalg.solve(jnp.eye(n) - free, pushed) if n else still.state
        _, (displacement, velocity) = motion(state)
        return Orbit(state, *(jnp.broadcast_to(x[:, None], shape) for x in (displacement, velocity * model.dt)))

    @property
    def _marched(self) -> int:
        """What `_march` calls periods in one of these."""
        return len(self.model.place.lowest)

    def _carry(self, orbit: Orbit) -> Carry:
        return at_rest(self.model, self.passes)._replace(
            state=orbit.state, past=Past(orbit.displacement, orbit.travel / self.model.dt)
        )

    def _orbit(self, carry: Carry) -> Orbit:
        return Orbit(carry.state, carry.past.displacement, carry.past.velocity * self.model.dt)
