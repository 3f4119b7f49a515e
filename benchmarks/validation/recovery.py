"""Seven parameters recovered from 1 s of noisy force and displacement, ten times."""

import numpy as np

import identification as ident
import millax as mx

from ..figures import Figure, below
from ..slot import slot

GUESS = {  # each wrong by a factor of 2
    "force.k0": 2.0,
    "force.hs": 0.5,
    "force.r": 2.0,
    "force.kr": 0.5,
    "structure.damping_ratio.x": 2.0,
    "structure.damping_ratio.y": 0.5,
    "structure.stiffness.x": 2.0,
}
SIGMA_FORCE, SIGMA_DISPLACEMENT, SEEDS = 2.0, 1e-6, 10


def figures():
    truth = slot(stiffness=[3e5, 3e5], damping_ratio=[0.05, 0.05], duration=1.0)
    sim = mx.simulate(truth)
    exact = np.column_stack([sim.force[:, :2], sim.displacement])
    sigma = np.array([SIGMA_FORCE, SIGMA_FORCE, SIGMA_DISPLACEMENT, SIGMA_DISPLACEMENT])
    noise = {"Fx": SIGMA_FORCE, "Fy": SIGMA_FORCE, "x": SIGMA_DISPLACEMENT, "y": SIGMA_DISPLACEMENT}
    values = {name: _value(truth, name) for name in GUESS}
    parameters = [ident.Parameter(name, guess=values[name] * factor) for name, factor in GUESS.items()]
    largest = []
    for seed in range(SEEDS):
        rng = np.random.default_rng(seed)
        measured = exact + sigma * rng.normal(size=exact.shape)
        trace = ident.Trace(np.asarray(sim.time), ("Fx", "Fy", "x", "y"), measured, noise, name=f"seed {seed}")
        result = ident.fit(truth, trace, parameters)
        if not result.success:
            yield Figure(f"seed {seed}", result.status, "converged", False)
            continue
        errors = {e.name: (e.value - values[e.name], e.std) for e in result.parameters}
        in_errors = max((abs(error / std), name) for name, (error, std) in errors.items())
        relative = max((abs(error / values[name]), name) for name, (error, _) in errors.items())
        largest.append({e.name: e.std / values[e.name] for e in result.parameters})
        yield below(f"seed {seed}: largest error in standard errors ({in_errors[1]})", in_errors[0], 3.0)
        yield below(f"seed {seed}: largest error ({relative[1]})", 100 * relative[0], 1.0, unit=" %")
        yield Figure(f"seed {seed}: evaluations of model and Jacobian", str(result.iterations), "", None)
    for name in GUESS:
        yield below(f"standard error of {name}", 100 * max(row[name] for row in largest), 0.4, unit=" %")


def _value(case: mx.Case, name: str) -> float:
    section, key, *axis = name.split(".")
    leaf = getattr(getattr(case, section), key)
    return float(leaf[case.structure.axes.index(axis[0])] if axis else leaf)
