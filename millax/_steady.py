"""The steady cut: a case without entry and exit along the feed, as stability sees it.

In a workpiece without borders across the feed nothing changes from one tooth period to the next but the feed, so the cut
has a periodic orbit, and what the tool does in one tooth period is a map of what it did before (`Period`). This file is the
only one about stability that knows how the engine is called.
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
from ._march import Carry, Model, Past, at_rest, march, place_in, process
from ._simulate import model_of
from ._stock import Stock
from ._types import AXES, Scalar


class ProcessMatrices(NamedTuple):
    """Derivatives of the mean force on the tool in each of L steps of a tooth period, of which the first axis is the pass.

    Entry (i, j) of each matrix belongs to the force along i and the motion along j, i and j out of x and y.
    """

    now: Float[Array, "L 2 2"]
    """By the present displacement [N/m]."""
    earlier: Float[Array, "passes L 2 2"]
    """By the displacement one, two ... tooth periods earlier [N/m]."""
    earlier_rate: Float[Array, "passes L 2 2"]
    """By the velocity then [N s/m]."""


class Orbit(NamedTuple):
    """What a tooth period leaves to the next, as far as the motion depends on it: the state of the map over a period.

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
    return tuple(i for i, axis in enumerate(AXES[:2]) if axis in case.structure.axes)


def process_matrices(case: Case, steps: int, passes: int = 1) -> ProcessMatrices:
    """The linearised cutting process of a tool that stays on its path, in steps of a tooth period.

    **Arguments:**

    - `case`: a steady one, see `steady`.
    - `steps`: into which the tooth period is divided, >= 10.
    - `passes`: earlier passes that count. While no tooth loses contact the force feels only the last one.
    """
    model = model_of(case.with_settings(steps_per_tooth=steps, blocks=1, passes=passes))
    place = jax.tree.map(lambda x: x[0, 0], model.place)
    still = jnp.zeros((passes, 2, steps))

    def force(now, past):
        forces, _ = cutting(process(model, place, past, jnp.zeros_like(model.depth)), now)
        return jnp.stack(forces[:2], axis=1)  # (steps, 2)

    # No step feels another: one change of a whole trace at a time gives the derivatives of all steps. All of them at once:
    # x and y of the present displacement, then of every earlier displacement, then of every earlier velocity.
    unit = jnp.eye(2 + 4 * passes).reshape(-1, 1 + 2 * passes, 2, 1) * jnp.ones(steps)
    by = jax.vmap(lambda d: jax.jvp(force, (still[0], Past(still, still)), _parted(d, passes))[1])(unit)
    by = jnp.moveaxis(by, 0, -1).reshape(steps, 2, 1 + 2 * passes, 2)
    now, earlier, rate = jnp.split(jnp.moveaxis(by, 2, 0), [1, 1 + passes])
    return ProcessMatrices(now[0], earlier, rate)


def _parted(change: Float[Array, "motions 2 L"], passes: int):
    """A change of the present displacement, and of the earlier motions."""
    return change[0], Past(change[1 : 1 + passes], change[1 + passes :])


class Period(eqx.Module):
    """The engine over one tooth period, as a map from `Orbit` to `Orbit`."""

    model: Model
    sweeps: int = eqx.field(static=True)
    passes: int = eqx.field(static=True)

    @staticmethod
    def of(case: Case) -> "Period":
        """For a steady case. Its settings count: steps, blocks, sweeps, passes, width and tolerance."""
        return Period(model_of(case), case.settings.sweeps if case.structure.coordinates else 1, case.settings.passes)

    def at_rest(self) -> Orbit:
        """The tool on its path."""
        still = at_rest(self.model, self.passes)
        return Orbit(still.state, *still.past)

    def __call__(self, orbit: Orbit) -> Orbit:
        """One tooth period later."""
        return self.after(orbit, 1)[0]

    def after(self, orbit: Orbit, periods: int) -> tuple[Orbit, Float[Array, "periods 2 steps"]]:
        """So many tooth periods later, and the displacement meanwhile [m]."""
        end, traces = march(self.model, self._carry(orbit), periods, sweeps=self.sweeps)
        displacement = jnp.moveaxis(traces.motion.displacement, 1, 2)
        return self._orbit(end), displacement.reshape(*displacement.shape[:2], -1)

    def under_rigid_force(self) -> Orbit:
        """The periodic motion under the force that a tool on its path would meet: close to the orbit."""
        model, still = self.model, self.at_rest()
        blocks, _, _, m = still.displacement.shape
        past = Past(still.displacement, still.travel)
        zero = jnp.zeros_like(model.depth)
        force, _ = jax.vmap(lambda place, past: cutting(process(model, place, past, zero), jnp.zeros((2, m))))(
            place_in(zero, model.place), past
        )

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
        repeated = tuple(
            jnp.broadcast_to(x[:, None], (blocks, self.passes, 2, m)) for x in (displacement, velocity * self._dt)
        )
        return Orbit(state, *repeated)

    @property
    def _dt(self) -> Scalar:
        """The time step [s], as the angle between two steps over the speed of the spindle."""
        return self.model.step_angle * self.model.radius / self.model.tip_speed

    def _carry(self, orbit: Orbit) -> Carry:
        return at_rest(self.model, self.passes)._replace(
            state=orbit.state, past=Past(orbit.displacement, orbit.travel / self._dt)
        )

    def _orbit(self, carry: Carry) -> Orbit:
        return Orbit(carry.state, carry.past.displacement, carry.past.velocity * self._dt)
