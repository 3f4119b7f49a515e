"""Fits by other solvers, from other starts, with other noise, and with a parameter held: one small cut for all."""

import dataclasses

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import minimize_scalar
from scipy.signal import lfilter
from test_fit import FORCES, RIGID, noisy

import millax as mx
from identification import SOLVERS, NoiseModel, Parameter, Trace, fit, profile
from identification._fleet import solve_many
from identification._parameters import free
from identification._starts import draw_starts, waterfall

ASKED = [Parameter("force.k0", 1e10, (1e8, 1e11)), Parameter("force.kr", 0.5, (0, 1))]
NOISE = {"Fx": 2.0, "Fy": 2.0}


@pytest.fixture(scope="module")
def trace():
    return noisy(RIGID, FORCES)


@pytest.fixture(scope="module")
def found(trace):
    return fit(RIGID, trace, ASKED, starts=8, seed=3)


def clean(trace):
    return noisy(RIGID, FORCES).values - np.random.default_rng(0).normal(size=trace.values.shape) * 2.0


@pytest.mark.parametrize("solver", SOLVERS)
def test_every_solver_reaches_the_same_optimum(solver, trace, found):
    result = fit(RIGID, trace, ASKED, solver=solver)
    assert result.success, result.message
    assert result.solver == solver
    for e in result.parameters:
        assert abs(e.value - found[e.name].value) < 0.01 * e.std
        assert e.std == pytest.approx(found[e.name].std, rel=1e-3)


@pytest.mark.parametrize("solver", ["scipy_trf", "jaxopt_lbfgsb"])
def test_solvers_that_keep_bounds_end_at_one(solver, trace):
    result = fit(RIGID, trace, [ASKED[0], Parameter("force.kr", 0.6, (0.4, 0.9))], solver=solver)
    assert result.status == "at_bound"
    assert result["force.kr"].at_bound
    assert result["force.k0"].std > 0


def test_all_starts_end_in_the_one_optimum(found):
    falls = found.waterfall
    assert falls.words == "8 of 8 starts reached the best optimum"
    assert found.seed == falls.seed == 3
    np.testing.assert_allclose(falls.ends, np.tile([e.value for e in found.parameters], (8, 1)), rtol=1e-4)
    np.testing.assert_allclose(falls.starts[0], [1e10, 0.5])
    ratio = falls.starts[1:] / falls.starts[0]
    assert (ratio > 1 / 5.001).all()
    assert (ratio < 5.001).all()
    assert np.ptp(np.log(ratio[:, 0])) > 0.5


def test_starts_that_end_elsewhere_or_nowhere_are_told_apart(found):
    asked = found.asked
    starts = draw_starts(asked.numbers, 4, 5.0, 0)
    ended = list(solve_many(asked.model, found.noise, starts))
    worse = dataclasses.replace(ended[1], cost=ended[1].cost + 3.0)
    lost = dataclasses.replace(ended[2], distance=40.0)
    broken = dataclasses.replace(ended[3], cost=np.inf, distance=np.inf)
    falls = waterfall(asked.numbers, starts, [ended[0], worse, lost, broken], 0)
    assert falls.optimum.tolist() == [0, 1, -1, -1]
    assert falls.words == "1 of 4 starts reached the best optimum, 1 ended in 1 worse one, 2 reached none"
    assert falls.to_json()["cost"][3] is None


def test_starts_stay_within_bounds_and_leave_clocks_alone():
    case = dataclasses.replace(RIGID, clock=mx.Clock(0.01))
    numbers = free(case, [Parameter("force.kr", 0.3, (0.2, 0.4)), Parameter("clock.start"), Parameter("force.k0")])
    values = np.stack([np.asarray(numbers.values(y)) for y in draw_starts(numbers, 50, 5.0, 1)])
    assert (values[:, 0] > 0.2).all()
    assert (values[:, 0] < 0.4).all()
    assert (values[:, 1] == 0.01).all()
    assert np.ptp(values[:, 2]) > 0


def test_a_profile_is_the_interval_where_the_likelihood_says_so(found):
    k0, kr = profile(found)
    for one in (k0, kr):
        e = found[one.name]
        # Two parameters that enter nearly linearly: both kinds of interval agree.
        np.testing.assert_allclose(one.ci95, e.ci95, atol=0.05 * e.std)
        assert one.reason is None
        assert (np.diff(one.root) > 0).all()
        np.testing.assert_allclose(one.root, (one.values - e.value) / e.std, atol=0.15)
    # By SciPy, held at the upper end: the cost is higher by 1.96².
    asked, numbers = found.asked, found.asked.numbers

    def cost(y_kr):
        y = numbers.coordinates(jnp.array([k0.ci95[1], 0.3])).at[1].set(y_kr)
        rows, usable = errors(asked.model, found.noise, y)
        assert usable
        return float(rows @ rows)

    errors = eqx.filter_jit(lambda model, noise, y: model.errors(noise, y))
    least = minimize_scalar(cost, bracket=(found.y[1] - 0.01, found.y[1] + 0.01)).fun
    assert np.sqrt(least - found.cost) == pytest.approx(1.96, abs=0.015)
    with pytest.raises(ValueError, match=r"profile of force\.r: it was not free"):
        profile(found, ["force.r"])


def test_colour_of_the_noise_is_recognised_and_intervals_are_widened(trace):
    draws = np.random.default_rng(1).normal(size=trace.values.shape)
    coloured = np.asarray(lfilter([0.6], [1, -0.8], draws, axis=0)) * 2.0
    both = Trace(trace.time, FORCES, clean(trace) + coloured)
    plain = fit(RIGID, both, ASKED)
    assert plain.success
    assert "The residuals of all channels are not white" in plain.message
    assert all(order >= 1 for order in plain.traces[0].orders.values())
    assert plain["force.kr"].widened > 1.5
    inside = fit(RIGID, both, ASKED, noise=NoiseModel(order=1))
    assert inside.success
    assert "not white" not in inside.message
    assert inside["force.kr"].widened == 1.0
    np.testing.assert_allclose(np.asarray(inside.noise.reflection)[:, 0], 0.8, atol=0.06)
    assert abs(inside["force.kr"].value - 0.3) < 4 * inside["force.kr"].std
    # What the widened interval says of least squares cannot be better than the best there is.
    assert plain["force.kr"].std > 0.9 * inside["force.kr"].std


def test_outliers_count_little_with_students_t(trace):
    rng = np.random.default_rng(2)
    spoilt = trace.values + np.where(rng.random(trace.values.shape) < 0.03, 80.0, 0.0)
    normal = fit(RIGID, Trace(trace.time, FORCES, spoilt), ASKED)
    robust = fit(RIGID, Trace(trace.time, FORCES, spoilt), ASKED, noise=NoiseModel("student"))
    assert robust.success
    assert abs(robust["force.kr"].value - 0.3) < 4 * robust["force.kr"].std
    assert robust["force.kr"].std < 0.4 * normal["force.kr"].std
    assert robust.traces[0].sigma["Fx"] < 3.0 < 10.0 < normal.traces[0].sigma["Fx"]


def test_what_cannot_be_asked_of_a_fit_is_refused(trace):
    for keywords, words in (
        ({"solver": "newton"}, "solver: 'newton' given; it must be one of optimistix_lm"),
        ({"starts": 0}, "starts: 0 given"),
        ({"spread": 1.0}, r"spread: 1\.0 given; it must be a factor greater than 1"),
    ):
        with pytest.raises(ValueError, match=words):
            fit(RIGID, trace, ASKED, **keywords)
