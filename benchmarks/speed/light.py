"""A light tool mode at its limit depth: where force and displacement of a step depend on each other most."""

import jax
import numpy as np

import millax as mx

from .. import compiled
from ..figures import Figure, below
from ..slot import LIGHT, light, slot
from ..timing import interleaved
from .run import Run

HEAVY, MODE, LOOP = "slot, 100 kg", "light tool mode", "C, same model"


def figures(run: Run):
    case, heavy = light(duration=run.duration, tolerance=1e-10), slot(duration=run.duration)
    frequency = np.sqrt(LIGHT["stiffness"] / LIGHT["mass"]) / (2 * np.pi)
    what = (
        f"{frequency:.0f} Hz, {LIGHT['mass'] * 1e3:.2f} g, zeta {LIGHT['damping_ratio']}, {case.cut.depth * 1e6:.0f} µm deep"
    )
    functions = {HEAVY: lambda: mx.simulate(heavy), MODE: lambda: mx.simulate(case)}
    if compiled.have_compiler():
        functions[LOOP] = compiled.same_model(case)
        sim, converged = mx.simulate(case), compiled.same_model(case, tolerance=1e-18)()
        for name, ours, theirs in (
            ("force", sim.force[:, :2], converged.force),
            ("displacement", sim.displacement, converged.displacement),
        ):
            error = np.abs(np.asarray(ours) - theirs).max() / np.abs(theirs).max()
            yield below(f"{what}: largest error of {name} beside the step-by-step solution", error, 1e-8, form=".1e")
    times = interleaved(functions, max(3, run.rounds // 2))
    per_step = 1e9 * times.seconds(MODE) / case.settings.steps
    run.bars[f"millax, {MODE}"] = per_step
    yield Figure(f"{MODE}: time per step", f"{per_step:.0f} ns", "", None)
    yield Figure(f"{MODE} beside {HEAVY}", f"{times.ratio(MODE, HEAVY):.2f} ×", "", None)
    if LOOP in functions:
        yield Figure(f"{MODE} beside {LOOP}", f"{times.ratio(MODE, LOOP):.2f} ×", "", None)
    jax.clear_caches()
