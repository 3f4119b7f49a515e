"""Six joint compliances and three damping ratios recovered from noisy cuts in four poses, and why one pose does not do."""

import numpy as np

from identification import check, fit

from ..figures import Figure, below
from ..robot_slot import TRUTH, cases, parameters, traces

SEEDS = 5
MORE = 40
"""Seeds from which the spread of the errors is found: with nine parameters each, to a few percent."""


def figures():
    errors = []
    for seed in range(MORE):
        result = fit(cases(), traces(seed), parameters())
        if not result.success:
            yield Figure(f"four poses, seed {seed}", result.status, "converged", False)
            continue
        found = {e.name: (e.value - TRUTH[e.name]) / e.std for e in result.parameters if e.std}
        errors.append(list(found.values()))
        if seed < SEEDS:
            worst = max(found, key=lambda name: abs(found[name]))
            yield below(f"four poses, seed {seed}: largest error in standard errors ({worst})", abs(found[worst]), 3.0)
        if seed == 0:
            for e in result.parameters:
                assert e.std is not None
                yield Figure(f"standard error of {e.name}, seed 0", f"{100 * e.std / e.value:.2g} %", "", None)
    spread = np.sqrt(np.mean(np.square(errors), axis=0))
    yield below(f"{MORE} seeds: spread of the errors over the standard errors given, largest of nine", spread.max(), 1.3)
    yield below(f"{MORE} seeds: the same, smallest: over it", 1 / spread.min(), 1.3)
    asked = cases(1), traces(0, 1), parameters()
    before, after = check(*asked), fit(*asked)
    named = "robot.compliance.joint_4, robot.compliance.joint_6 cannot be told apart" in before.message
    yield Figure("one pose, before the fit", before.message, "joints 4 and 6 named", named and not before.identifiable)
    yield Figure("one pose, the fit", after.status, "not_identifiable", after.status == "not_identifiable")
