"""One simulation beside the same model, and simpler ones, written otherwise."""

import dataclasses

import numpy as np

import millax as mx

from .. import compiled, grid
from ..figures import Figure, below
from ..scan import step_by_step
from ..slot import six_coordinates, slot
from ..timing import interleaved
from .run import Run

ENGINE, SIX, HELIX = "millax", "millax, 6 coordinates", "millax, helix, 8 slices"
SAME, SAMPLED, SCAN = "C, same model", "C, sampled", "lax.scan over steps"
GRID_STEPS = 400
SPACING = 10e-6


def figures(run: Run):
    case = slot(duration=run.duration)
    steps = case.settings.steps
    six = six_coordinates(duration=run.duration)
    helical = slot(duration=run.duration, tool={"helix": 0.5}, slices=8)
    functions = {
        ENGINE: lambda: mx.simulate(case),
        SIX: lambda: mx.simulate(six),
        HELIX: lambda: mx.simulate(helical),
        SCAN: step_by_step(case),
    }
    if compiled.have_compiler():
        functions |= {SAME: compiled.same_model(case), SAMPLED: compiled.sampled(case)}
    times = interleaved(functions, run.rounds)
    for name in functions:
        target = run.lines if name in (SAME, SAMPLED) else run.bars
        target[name] = 1e9 * times.seconds(name) / steps
        yield Figure(f"{name}: time per step", f"{1e9 * times.seconds(name) / steps:.0f} ns", "", None)
    yield Figure(f"{ENGINE}: {steps} steps", f"{1e3 * times.seconds(ENGINE):.2f} ms", "", None)

    if compiled.have_compiler():
        yield from _beside_c(case, times)
    yield Figure(f"{SCAN} beside {ENGINE}", f"{times.ratio(SCAN, ENGINE):.3g} ×", "", None)
    yield from _grid(run, case, times.seconds(ENGINE) / steps)
    yield below("6 coordinates, full M, C, K, beside 2", times.ratio(SIX, ENGINE), 3, form=".2f", unit=" ×")
    yield below("helix in 8 slices beside straight flutes", times.ratio(HELIX, ENGINE), 8, form=".2f", unit=" ×")


def _beside_c(case, times):
    yield below(f"{ENGINE} beside {SAME}", times.ratio(ENGINE, SAME), 3, form=".2f", unit=" ×")
    yield Figure(f"{ENGINE} beside {SAMPLED}", f"{times.ratio(ENGINE, SAMPLED):.2f} ×", "", None)
    loop, converged = compiled.same_model(case)(), compiled.same_model(case, tolerance=1e-18)()
    yield Figure(f"{SAME}: force computed per step", f"{loop.evaluations:.2f} times", "", None)
    for name, force in ((SAME, loop.force), (ENGINE, np.asarray(mx.simulate(case).force)[:, :2])):
        error = np.abs(force - converged.force).max() / np.abs(converged.force).max()
        yield Figure(f"{name}: largest error of force from not iterating on", f"{error:.1e}", "", None)
    long = case.with_settings(sweeps=30, tolerance=1e-14)
    sim = mx.simulate(long)
    difference = np.abs(np.asarray(sim.force)[:, :2] - converged.force).max() / np.abs(converged.force).max()
    yield below(f"{ENGINE} and {SAME}, both converged: largest difference of force", difference, 1e-9, form=".1e")


def _grid(run: Run, case, per_step):
    """The middle of a cut: the cost of the grid does not depend on when."""
    steps = min(GRID_STEPS, case.settings.steps)
    inside = dataclasses.replace(case, stock=mx.Stock.box((-1.0, None)))
    times = interleaved({"grid": lambda: grid.simulate(inside, SPACING, steps=steps).force}, 3)
    seconds = times.seconds("grid") / steps
    name = "papers' grid in NumPy"
    run.bars[name] = 1e9 * seconds
    yield Figure(f"{name}, nodes every {SPACING * 1e6:.0f} µm: time per step", f"{1e6 * seconds:.0f} µs", "", None)
    yield Figure(f"{name} beside {ENGINE}", f"{seconds / per_step:.0f} ×", "", None)
