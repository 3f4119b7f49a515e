"""A stability diagram from the time domain: 100 spindle speeds by 100 depths, 0.5 s of cutting in each point."""

import time

import numpy as np

import millax as mx

from .. import compiled, grid
from ..figures import Figure
from ..scan import step_by_step
from ..slot import SPEED, light, limit_depth
from ..timing import interleaved
from .child import ask
from .run import Run
from .single import SPACING

SIDE = 100
ROWS = 4
"""Depths computed unless the run is long; the rest is extrapolated."""

DURATION = 0.5


def figures(run: Run):
    duration, rows = DURATION * run.duration, SIDE if run.long else ROWS
    result = ask("lobes", duration, rows)
    whole = result["seconds"] * SIDE / rows
    note = "" if run.long else f", from {rows} rows of it"
    yield Figure(
        f"{SIDE} speeds × {SIDE} depths, {duration:g} s each, light tool mode{note}: wall time", f"{whole:.0f} s", "", None
    )
    yield Figure("simulations per second, wall time", f"{SIDE**2 / whole:.0f}", "", None)
    yield Figure("time steps per simulation, mean", f"{result['steps']:.0f}", "", None)
    yield Figure("simulations that converged, left their path or not", f"{100 * result['converged']:.1f} %", "", None)

    case = light(duration=duration)
    scale = result["steps"] / case.settings.steps
    functions = {"lax.scan over steps": step_by_step(case)}
    if compiled.have_compiler():
        functions["C, same model, one core"] = compiled.same_model(case)
    times = interleaved(functions, 3)
    for name in functions:
        yield _extrapolated(name, times.seconds(name) * scale, whole)
    few = min(200, case.settings.steps)
    begin = time.perf_counter()
    grid.simulate(case, SPACING, steps=few)
    yield _extrapolated("papers' grid in NumPy", (time.perf_counter() - begin) / few * result["steps"], whole)


def measure(duration: float, rows: float) -> dict[str, float]:
    """Seconds for `rows` of the depths at all speeds, steps of a simulation on average, and the share that converged."""
    case = light(duration=duration)
    depths = limit_depth(case) * np.linspace(0.2, 5.0, SIDE)[:: SIDE // int(rows)]
    axes = {"cut.spindle_speed": SPEED * np.linspace(0.8, 1.6, SIDE), "cut.depth": depths}

    def diagram():
        return mx.sweep(case, grid=axes, reduce=("std_displacement",))

    diagram()  # compiles
    begin = time.perf_counter()
    result = diagram()
    seconds = time.perf_counter() - begin
    period = 2 * np.pi / (axes["cut.spindle_speed"] * case.tool.teeth)
    steps = result.simulated_time.values / period[:, None] * case.settings.steps_per_tooth
    return {
        "seconds": seconds,
        "steps": float(steps.mean()),
        "converged": float(np.isin(result.status.values, (0, 2)).mean()),
    }


def _extrapolated(name: str, seconds: float, ours: float) -> Figure:
    theirs = seconds * SIDE**2
    shown = f"{theirs:.0f} s" if theirs < 1000 else f"{theirs / 3600:.1f} h"
    return Figure(f"{name}: the same, from one simulation", f"{shown}, {theirs / ours:.3g} ×", "", None)
