"""Six joint compliances and three damping ratios recovered from noisy cuts in four poses, and why one pose does not do; the
compliances alone from static load tests."""

from collections.abc import Iterator

import numpy as np

from identification import Check, FitResult, LoadTest, check, fit

from ..figures import Figure, below
from ..kr270 import COMPLIANCE
from ..robot_slot import TRACKER, TRUTH, cases, parameters, pulls, traces

SEEDS = 5
MORE = 40
"""Seeds from which the spread of the errors is found: with nine parameters each, to a few percent."""


def figures():
    yield from _cuts()
    yield from _load_tests()


def _cuts() -> Iterator[Figure]:
    errors = []
    for seed in range(MORE):
        result = fit(cases(), traces(seed), parameters())
        if not result.success:
            yield Figure(f"four poses, seed {seed}", result.status, "converged", False)
            continue
        found = _in_errors(result)
        errors.append(list(found.values()))
        if seed < SEEDS:
            yield _worst(f"four poses, seed {seed}", found)
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
    yield Figure("one pose, before the fit", _named(before), "joints 4 and 6 named", named and not before.identifiable)
    yield Figure("one pose, the fit", after.status, "not_identifiable", after.status == "not_identifiable")


def _in_errors(result: FitResult) -> dict[str, float]:
    """Errors of the estimates in standard errors."""
    return {e.name: (e.value - TRUTH[e.name]) / e.std for e in result.parameters if e.std}


def _worst(what: str, errors: dict[str, float]) -> Figure:
    worst = max(errors, key=lambda name: abs(errors[name]))
    return below(f"{what}: largest error in standard errors ({worst})", abs(errors[worst]), 3.0)


def _load_tests() -> Iterator[Figure]:
    """Deflections in the poses of the cuts and in four more; the truth by the compliance at the tool, C 17 without loads."""
    joints, force = pulls()
    case = cases(1)[0]
    assert case.robot is not None
    # Small enough a pull is linear; the springs' own stiffening under 500 N, 1e-4 of the motion, is in the model only.
    compliance = [np.asarray(case.robot.elastic.tool_compliance(q))[:3, :3] for q in joints]
    exact = np.einsum("mij,mj->mi", compliance, force)
    asked = parameters()[: len(COMPLIANCE)]
    for seed in range(SEEDS):
        values = exact + np.random.default_rng(seed).normal(scale=TRACKER, size=exact.shape)
        test = LoadTest(joints, force, ("x", "y", "z"), values, noise=dict.fromkeys("xyz", TRACKER))
        result = fit(case, test, asked)
        if not result.success:
            yield Figure(f"load tests, seed {seed}", result.status, "converged", False)
            continue
        yield _worst(f"load tests in {len(joints) // 3} poses, seed {seed}", _in_errors(result))
    one = check(
        case, LoadTest(joints[:1], force[:1], ("x", "y", "z"), exact[:1], noise=dict.fromkeys("xyz", TRACKER)), asked
    )
    named = all(f"joint_{i}" in _named(one) for i in range(1, 7))
    yield Figure("one pose, one pull, before the fit", _named(one), "all joints named", named and not one.identifiable)


def _named(found: Check) -> str:
    """The combinations that cannot be known, without what to do about them."""
    groups = [
        reason.partition(" cannot be told apart")[0] for reason in found.message.removeprefix("At the guess ").split("; ")
    ]
    return "; ".join(group.replace("robot.compliance.", "") for group in groups)
