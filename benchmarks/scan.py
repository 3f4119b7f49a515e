"""The obvious program in JAX: a `lax.scan` over time steps, earlier passes in a ring buffer.

The same model as the engine, from the engine's own formulas for one step, and the same agreement of force and
displacement within it. What differs is only the order of computation: one step after the other.
"""

from collections.abc import Callable

import jax
import jax.numpy as jnp
from jax import lax

import millax as mx
from millax._block import Conditions, Process, Slice, cutting
from millax._chip import Commanded, Earlier
from millax._simulate import _places

from .compiled import discrete, observed, time_step


def step_by_step(case: mx.Case, evaluations: int = 2) -> Callable[[], tuple[jax.Array, jax.Array]]:
    """The simulation of `case` (straight and equal teeth), ready to run: force (steps, 2) [N], displacement (steps, 2) [m].

    `evaluations`: how often the force of a step is computed, each time with the displacement it made before.
    """
    tool, cut, s = case.tool, case.cut, case.settings
    whole_period = case.with_settings(blocks=1)
    n, kept = s.steps_per_tooth, s.passes * s.steps_per_tooth
    dt, seen = time_step(case), jnp.asarray(observed(case))
    (half, half_in), (whole, whole_in) = (map(jnp.asarray, discrete(case, t)) for t in (dt / 2, dt))
    slices = jax.tree.map(lambda a: _by_step(a, n), _places(whole_period, n).slices)
    earlier = n * jnp.arange(1, s.passes + 1)
    always = jnp.asarray(True)

    def step(carry, index):
        state, force, history = carry
        feed, place = cut.feed_per_tooth(tool), index % n
        now: Slice = jax.tree.map(lambda a: a[place], slices)
        now = now._replace(borders=now.borders.moved((index // n) * feed))
        before = history[(index - earlier) % kept]
        commanded = Commanded(feed, cut.feed_rate, cut.spindle_speed * tool.radius, tool.radius)
        past = Earlier(before[:, :2, None], before[:, 2:, None], commanded)
        conditions = Conditions(case.force, cut.depth, s.width)
        inside = jnp.ones((1, tool.teeth, 1))
        process = Process(now, past, conditions, inside, always, always, step_angle=2 * jnp.pi / (tool.teeth * n))

        def motion(force):
            return seen @ (half @ state + half_in @ force)

        for _ in range(evaluations):
            (fx, fy), _ = cutting(process, motion(force)[:2, None])
            force = jnp.concatenate([fx, fy])
        middle = motion(force)
        history = history.at[index % kept].set(middle)
        return (whole @ state + whole_in @ force, force, history), (force, middle[:2])

    @jax.jit
    def run():
        start = (jnp.zeros(len(half)), jnp.zeros(2), jnp.zeros((kept, 4)))
        return lax.scan(step, start, jnp.arange(s.steps))[1]

    return run


def _by_step(a, n):
    """From one block of a whole tooth period to one row per step; what does not depend on the step is repeated."""
    a = a[0, 0]
    return jnp.moveaxis(a, -1, 0)[..., None] if a.shape[-1] == n else jnp.broadcast_to(a, (n, *a.shape))
