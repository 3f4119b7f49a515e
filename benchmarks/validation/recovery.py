"""Seven parameters recovered from 1 s of noisy force and displacement, ten times."""

import identification as ident
from millax._names import value_of

from ..demo import cut, recorded
from ..figures import Figure, below

GUESS = {  # each wrong by a factor of 2
    "force.k0": 2.0,
    "force.hs": 0.5,
    "force.r": 2.0,
    "force.kr": 0.5,
    "structure.damping_ratio.x": 2.0,
    "structure.damping_ratio.y": 0.5,
    "structure.stiffness.x": 2.0,
}
SEEDS = 10


def figures():
    truth = cut(1.0)
    values = {name: value_of(truth, name) for name in GUESS}
    parameters = [ident.Parameter(name, guess=values[name] * factor) for name, factor in GUESS.items()]
    largest = []
    for seed in range(SEEDS):
        result = ident.fit(truth, recorded(truth, seed), parameters)
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
