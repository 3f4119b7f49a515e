"""A stability diagram from the time domain: 100 spindle speeds by 100 depths, 0.5 s of cutting in each point."""

import time

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

import millax as mx

from .. import compiled, grid
from ..figures import Figure
from ..scan import step_by_step
from ..slot import SPEED, light, limit_depth
from ..timing import interleaved
from .batch import CHUNK
from .run import Run
from .single import SPACING

SIDE = 100
ROWS = 4
"""Speeds computed unless the run is long; the rest is extrapolated."""


def figures(run: Run):
    case = light(duration=0.5 * run.duration)
    speeds = SPEED * jnp.linspace(0.8, 1.6, SIDE)
    depths = limit_depth(case) * jnp.linspace(0.2, 5.0, SIDE)
    rows = speeds if run.long else speeds[:: SIDE // ROWS]
    points = jnp.stack([axis.ravel() for axis in jnp.meshgrid(rows, depths, indexing="ij")], axis=1)

    def point(numbers):
        changed = eqx.tree_at(lambda c: (c.cut.spindle_speed, c.cut.depth), case, (numbers[0], numbers[1]))
        sim = mx.simulate(changed, throw=False)
        last = sim.displacement[-10 * case.settings.steps_per_tooth :]
        return jnp.std(last, axis=0), sim.status

    diagram = jax.jit(lambda points: jax.lax.map(point, points, batch_size=CHUNK))
    jax.block_until_ready(diagram(points[:CHUNK]))
    jax.block_until_ready(diagram(points))
    begin = time.perf_counter()
    _, status = jax.block_until_ready(diagram(points))
    seconds = time.perf_counter() - begin
    whole = seconds * SIDE**2 / len(points)
    note = "" if run.long else f", from {len(points)} of them"
    steps = case.settings.steps
    yield Figure(f"{SIDE} × {SIDE} simulations of {steps} steps, light tool mode{note}", f"{whole:.0f} s", "", None)
    yield Figure("simulations per second, wall time", f"{SIDE**2 / whole:.0f}", "", None)
    yield Figure(
        "of them converged or chattering within the radius", f"{100 * np.mean(np.isin(status, (0, 2))):.0f} %", "", None
    )

    functions = {"lax.scan over steps": step_by_step(case)}
    if compiled.have_compiler():
        functions["C, same model, one core"] = compiled.same_model(case)
    times = interleaved(functions, 3)
    for name in functions:
        yield _extrapolated(name, times.seconds(name), whole)
    few = min(200, steps)
    begin = time.perf_counter()
    grid.simulate(case, SPACING, steps=few)
    yield _extrapolated("papers' grid in NumPy", (time.perf_counter() - begin) / few * steps, whole)


def _extrapolated(name: str, seconds: float, ours: float) -> Figure:
    theirs = seconds * SIDE**2
    shown = f"{theirs:.0f} s" if theirs < 1000 else f"{theirs / 3600:.1f} h"
    return Figure(f"{name}: the same, from one simulation", f"{shown}, {theirs / ours:.3g} ×", "", None)
