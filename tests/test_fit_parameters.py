"""Fits with numbers of single traces, ties and priors, on short rigid cuts."""

import dataclasses

import equinox as eqx
import numpy as np
import pytest
from cases import slot

import millax as mx
from identification import Parameter, Prior, Tie, Trace, check, fit

SIGMA = 2.0
FEEDS = 0.5, 1.0, 1.5
"""Over that of the case."""

CASE = slot(structure=mx.Structure.rigid())
CASES = tuple(eqx.tree_at(lambda c: c.cut.feed_rate, CASE, factor * CASE.cut.feed_rate) for factor in FEEDS)


def measured(cases, seed=0):
    """Forces of rigid slots, with white noise."""
    rng, traces = np.random.default_rng(seed), []
    for case in cases:
        sim = mx.simulate(case)
        force = np.asarray(sim.force)[:, :2]
        traces.append(
            Trace(sim.time, ("Fx", "Fy"), force + rng.normal(scale=SIGMA, size=force.shape), {"Fx": SIGMA, "Fy": SIGMA})
        )
    return traces


def off(result, truth):
    """Errors of the estimates in standard errors."""
    assert result.success, result.message
    return np.array([(e.value - t) / e.std for e, t in zip(result.parameters, truth, strict=True)])


@pytest.mark.long
def test_every_trace_has_its_own_number():
    depths = np.array([0.9, 1.0, 1.2]) * float(CASE.cut.depth)
    cases = [eqx.tree_at(lambda c: c.cut.depth, case, depth) for case, depth in zip(CASES, depths, strict=True)]
    # k0 and all three depths would not be told apart: what is known of one depth tells them.
    prior = Prior("5 kN/mm^2", "0.05 kN/mm^2")
    asked = [Parameter("force.k0", "4 kN/mm^2", prior=prior), "force.hs", Parameter("cut.depth", each=True)]
    unknown = check(CASES, measured(cases), [Parameter("force.k0"), *asked[1:]])
    assert not unknown.identifiable
    assert "cut.depth.trace_1, cut.depth.trace_2, cut.depth.trace_3 cannot be told apart" in unknown.message
    result = fit(CASES, measured(cases), asked)
    errors = off(result, [5.0, float(CASE.force.hs), *depths])
    assert np.abs(errors).max() < 3.5
    assert result["force.k0"].std == pytest.approx(0.05, rel=1e-3)
    assert [float(case.cut.depth) for case in result.cases] == [result[f"cut.depth.trace_{i}"].value for i in (1, 2, 3)]


def test_a_prior_pulls_as_one_more_measurement_of_the_number_does():
    traces = measured(CASES[:1])
    alone = fit(CASES[0], traces, ["force.kr"])["force.kr"]
    known = fit(CASES[0], traces, [Parameter("force.kr", prior=Prior(alone.value + alone.std, alone.std))])["force.kr"]
    assert known.value == pytest.approx(alone.value + alone.std / 2, abs=0.01 * alone.std)
    assert known.std == pytest.approx(alone.std / np.sqrt(2), rel=1e-3)


def test_a_prior_says_how_well_a_number_near_zero_is_known():
    # Noise drowns the force: what is left is what was known before, however large that is against the guess.
    drowned = [dataclasses.replace(trace, noise={"Fx": 1e6, "Fy": 1e6}) for trace in measured(CASES[:1])]
    found = check(CASES[0], drowned, [Parameter("force.kr", 1e-3, prior=Prior(0.0, 0.1))])
    assert found.identifiable
    assert found.parameters[0].std == pytest.approx(0.1, rel=1e-3)
    assert not check(CASES[0], drowned, [Parameter("force.kr", 1e-3)]).identifiable


@pytest.mark.long
def test_what_is_tied_follows():
    case = slot(stiffness=np.array([3e5, 4.5e5]), duration=0.02)
    sim = mx.simulate(case)
    values = np.asarray(sim.displacement) + np.random.default_rng(1).normal(scale=1e-6, size=sim.displacement.shape)
    trace = Trace(sim.time, ("x", "y"), values, {"x": 1e-6, "y": 1e-6})
    tied = Tie("structure.stiffness.y", "structure.stiffness.x", 1.5)
    result = fit(case, trace, [Parameter("structure.stiffness.x", 2e5), tied])
    assert np.abs(off(result, [3e5])).max() < 3.5
    np.testing.assert_allclose(result.case.structure.stiffness[1], 1.5 * result.case.structure.stiffness[0], rtol=1e-12)
    assert result["structure.stiffness.x"].std < fit(case, trace, ["structure.stiffness.x"])["structure.stiffness.x"].std
