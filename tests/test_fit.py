"""Fits: what they find, how they end, and what they rest on in optimistix."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
import pytest
from cases import slot

import millax as mx
from identification import Parameter, Trace, TraceError, _evaluate, _running, check, fit
from identification._evaluate import triangle
from identification._parameters import free
from identification._solver import Steps
from identification._transforms import Above
from millax._names import valid_names

NOISE = {"Fx": 2.0, "Fy": 2.0, "x": 1e-6, "y": 1e-6}


def noisy(case, channels, seed=0, noise=None):
    """A trace of `case` with normal noise; `noise` is what the trace says about it."""
    sim = mx.simulate(case)
    table = {"Fx": sim.force[:, 0], "Fy": sim.force[:, 1]} | dict(zip(sim.axes, sim.displacement.T, strict=True))
    values = np.stack([np.asarray(table[c]) for c in channels], axis=1)
    rng = np.random.default_rng(seed)
    values = values + rng.normal(size=values.shape) * [NOISE[c] for c in channels]
    return Trace(np.asarray(sim.time), channels, values, noise or {})


RIGID = slot(axes=(), duration=0.03)
FORCES = ("Fx", "Fy")


@pytest.fixture(scope="module")
def rigid_trace():
    return noisy(RIGID, FORCES)


SOFT = slot(mass=2.0, stiffness=jnp.array([2e6, 2e6]), duration=0.06)
TRUTH = {"force.k0": 5e9, "force.r": 0.1, "force.kr": 0.3, "structure.damping_ratio": 0.05, "structure.stiffness.y": 2e6}


def test_five_parameters_are_found_from_guesses_wrong_by_a_factor_of_two():
    guesses = [
        Parameter(name, value * wrong) for (name, value), wrong in zip(TRUTH.items(), (2, 0.5, 2, 0.5, 2), strict=True)
    ]
    stages = []
    result = fit(SOFT, noisy(SOFT, tuple(NOISE)), guesses, progress=lambda p: stages.append(p.stage))
    assert result.success, result.message
    for name, value in TRUTH.items():
        estimate = result[name]
        assert abs(estimate.value - value) < 4 * estimate.std
        assert estimate.std < 0.05 * value
        assert estimate.ci95[0] < estimate.value < estimate.ci95[1]
    (trace,) = result.traces
    for channel, sigma in NOISE.items():  # 1600 samples: their root mean square is known to 1.8 %
        assert trace.sigma[channel] == pytest.approx(sigma, rel=0.08)
        assert trace.rmse[channel] == pytest.approx(sigma, rel=0.08)
    assert trace.fitted.shape == trace.trace.values.shape
    assert {"compiling", "fit", "noise 1"} <= set(stages)
    assert float(result.case.structure.stiffness[1]) == pytest.approx(result["structure.stiffness.y"].value)
    assert float(result.case.structure.stiffness[0]) == 2e6
    assert int(mx.simulate(result.case).status) == 0


def test_the_spread_of_estimates_over_noise_is_the_standard_error():
    names = ("force.k0", "force.kr")
    estimates, errors = [], []
    for seed in range(24):
        result = fit(RIGID, noisy(RIGID, FORCES, seed), names)
        assert result.success
        estimates.append([result[name].value for name in names])
        errors.append([result[name].std for name in names])
    ratio = np.std(estimates, axis=0, ddof=1) / np.mean(errors, axis=0)
    # The standard deviation of 24 numbers is itself known to 15 %.
    assert (np.abs(ratio - 1) < 0.45).all()
    bias = (np.mean(estimates, axis=0) - [5e9, 0.3]) / (np.mean(errors, axis=0) / np.sqrt(24))
    assert (np.abs(bias) < 3.5).all()


def test_noise_that_is_given_is_taken_and_scales_the_errors(rigid_trace):
    def given(scale):
        noise = {channel: scale * NOISE[channel] for channel in FORCES}
        trace = Trace(rigid_trace.time, FORCES, rigid_trace.values, noise)
        return fit(RIGID, trace, ["force.k0", "force.kr"])

    one, three = given(1.0), given(3.0)
    assert dict(one.traces[0].sigma) == {"Fx": 2.0, "Fy": 2.0}
    assert three["force.k0"].std == pytest.approx(3 * one["force.k0"].std, rel=1e-3)
    assert three["force.k0"].value == pytest.approx(one["force.k0"].value, rel=1e-6)
    estimated = fit(RIGID, rigid_trace, ["force.k0", "force.kr"])
    assert estimated["force.k0"].std == pytest.approx(one["force.k0"].std, rel=0.1)


def test_the_estimates_are_those_of_a_fit_by_scipy(rigid_trace):
    from scipy.optimize import least_squares

    def residuals(v):
        case = eqx.tree_at(lambda c: (c.force.k0, c.force.kr), RIGID, (jnp.array(v[0] * 1e9), jnp.array(v[1])))
        return np.asarray((mx.simulate(case).force[:, :2] - rigid_trace.values) / 2.0).ravel()

    noise = {"Fx": 2.0, "Fy": 2.0}
    result = fit(RIGID, Trace(rigid_trace.time, FORCES, rigid_trace.values, noise), ["force.k0", "force.kr"])
    scipy = least_squares(residuals, [4.0, 0.2], xtol=1e-12, ftol=1e-12, gtol=1e-12)
    std = np.sqrt(np.diag(np.linalg.inv(scipy.jac.T @ scipy.jac)))
    for name, scale, value, error in zip(("force.k0", "force.kr"), (1e9, 1.0), scipy.x, std, strict=True):
        assert abs(result[name].value / scale - value) < 2e-3 * error
        assert result[name].std / scale == pytest.approx(error, rel=1e-4)


def test_a_perfect_trace_is_fitted_to_the_accuracy_of_the_simulation():
    sim = mx.simulate(RIGID)
    trace = Trace(np.asarray(sim.time), FORCES, np.asarray(sim.force[:, :2]))
    result = fit(RIGID, trace, [Parameter("force.k0", 1e10), Parameter("force.kr", 0.6)])
    assert result.success
    assert result["force.k0"].value == pytest.approx(5e9, rel=1e-7)
    assert result["force.k0"].std > 0


def test_two_traces_of_one_cut_know_more_than_either(rigid_trace):
    parts = [Trace(rigid_trace.time[s], FORCES, rigid_trace.values[s]) for s in (slice(0, 400), slice(400, None))]
    both = fit(RIGID, parts, ["force.k0", "force.kr"])
    one = fit(RIGID, parts[:1], ["force.k0", "force.kr"])
    assert both.success
    assert len(both.traces) == 2
    assert both["force.kr"].std < 0.8 * one["force.kr"].std


def test_other_numbers_are_no_reason_to_compile_again(monkeypatch, rigid_trace):
    traced = []
    simulate = _evaluate.simulate
    monkeypatch.setattr(_evaluate, "simulate", lambda *a, **k: traced.append(1) or simulate(*a, **k))
    # A length of its own, so that no other test has compiled it.
    for guess, depth, first in ((4e9, 1e-3, 0), (6e9, 1.1e-3, 3)):
        case = eqx.tree_at(lambda c: c.cut.depth, RIGID, jnp.array(depth))
        part = slice(first, first + 777)
        trace = Trace(rigid_trace.time[:777], FORCES, rigid_trace.values[part])
        fit(case, trace, [Parameter("force.k0", guess, (1e8, 1e11)), "force.kr"], max_iterations=3)
    assert len(traced) == 1


# ---- how a fit ends


def no_numbers(result):
    return all(e.std is None and e.ci95 is None and e.reason for e in result.parameters)


def test_a_question_without_an_answer_is_not_begun(rigid_trace):
    asked = RIGID, rigid_trace, ["force.k0", "cut.depth", "force.kr"]
    result = fit(*asked)
    assert result.status == "not_identifiable"
    assert not result.begun
    assert result.iterations == 1
    assert result.message.startswith("At the guess force.k0, cut.depth cannot be told apart: +1 % of force.k0 with -1 %")
    assert "not begun" in result.message
    assert [e.identifiable for e in result.parameters] == [False, False, True]
    assert no_numbers(result)
    known = check(*asked)
    assert not known.identifiable
    assert result.message.startswith(known.message)
    assert [p.std is None for p in known.parameters] == [True, True, False]


def test_what_a_check_expects_is_what_a_fit_finds(rigid_trace):
    found = fit(RIGID, rigid_trace, ["force.k0", "force.kr"])
    trace = dataclasses.replace(rigid_trace, noise=dict(found.traces[0].sigma))
    known = check(found.case, trace, ["force.k0", "force.kr"])
    assert known.message == "The measurements determine all 2 parameters."
    np.testing.assert_allclose([p.std for p in known.parameters], [e.std for e in found.parameters], rtol=1e-6)
    np.testing.assert_allclose(known.correlation, found.correlation, atol=1e-6)


@pytest.mark.long
def test_traces_of_several_cuts_are_fitted_as_one(rigid_trace):
    rng = np.random.default_rng(3)
    feeds = [eqx.tree_at(lambda c: c.cut.feed_rate, RIGID, RIGID.cut.feed_rate * f) for f in (0.5, 1.0, 1.5)]
    feeds.append(feeds[0].with_settings(periods=2 * RIGID.settings.periods))
    sims = [mx.simulate(case) for case in feeds]
    traces = [
        Trace(
            np.asarray(s.time),
            FORCES,
            np.asarray(s.force[:, :2]) + rng.normal(size=(len(s.time), 2)),
            {"Fx": 1.0, "Fy": 1.0},
        )
        for s in sims
    ]
    asked = [Parameter("force.k0", 3e9), Parameter("force.hs", 3e-5), "force.r"]
    result = fit(feeds, traces, asked)
    assert result.success
    for e, true in zip(result.parameters, (5e9, 18e-6, 0.1), strict=True):
        assert abs(e.value - true) < 4 * e.std, e.name
    assert [float(case.cut.feed_rate) for case in result.cases] == [float(case.cut.feed_rate) for case in feeds]
    alone = fit(feeds[1], traces[1], asked)
    assert alone["force.hs"].std > 2 * result["force.hs"].std  # one feed alone hardly knows the curve of the law
    with pytest.raises(ValueError, match="2 cases given for 4 traces and load tests"):
        fit(feeds[:2], traces, asked)


def test_a_product_that_alone_is_known_is_named(rigid_trace):
    result = fit(RIGID, rigid_trace, ["force.k0", "cut.depth", "force.kr"], check=False)
    assert result.status == "not_identifiable"
    assert not result.success
    assert "force.k0, cut.depth cannot be told apart" in result.message.replace("Force", "force", 1)
    assert result["force.k0"].std is None
    assert result["cut.depth"].reason
    assert result["force.kr"].identifiable
    assert result["force.kr"].std == pytest.approx(
        fit(RIGID, rigid_trace, ["force.k0", "force.kr"])["force.kr"].std, rel=1e-3
    )


def test_an_optimum_at_a_bound_is_told(rigid_trace):
    result = fit(RIGID, rigid_trace, [Parameter("force.k0"), Parameter("force.kr", 0.6, (0.4, 0.9))])
    assert result.status == "at_bound"
    assert result["force.kr"].at_bound
    assert result["force.kr"].std is None
    assert result["force.kr"].value == pytest.approx(0.4, abs=1e-3)
    assert result["force.k0"].std > 0


def test_a_parameter_that_the_traces_do_not_feel_cannot_start(rigid_trace):
    result = fit(RIGID, rigid_trace, ["force.k0", "cut.start.y"])
    assert result.status == "cannot_start"
    assert "do not depend on cut.start.y" in result.message
    assert no_numbers(result)


def test_a_guess_at_which_the_simulation_fails_cannot_start():
    parameters = [Parameter(name, 0.1 if name == "structure.stiffness.y" else None) for name in TRUTH]
    result = fit(SOFT, noisy(SOFT, tuple(NOISE)), parameters)
    assert result.status == "cannot_start"
    assert "more than its radius" in result.message
    assert no_numbers(result)
    assert result.traces == ()


def test_a_simulation_that_fails_on_the_way_is_a_step_turned_down(monkeypatch, rigid_trace):
    calls = []
    evaluate = _running.evaluate

    def failing(*arguments):
        calls.append(1)
        result = evaluate(*arguments)
        if len(calls) == 2:
            return eqx.tree_at(lambda e: e.status, result, jnp.array(2))
        if len(calls) == 3:
            return eqx.tree_at(lambda e: e.triangles, result, result.triangles * jnp.nan)
        return result

    monkeypatch.setattr(_running, "evaluate", failing)
    result = fit(RIGID, rigid_trace, [Parameter("force.k0", 8e9), "force.kr"])
    assert result.success
    assert abs(result["force.k0"].value - 5e9) < 4 * result["force.k0"].std


def test_an_optimum_behind_a_wall_of_failures_is_no_answer(monkeypatch, rigid_trace):
    evaluate = _running.evaluate

    def walled(model, noise, y):
        result = evaluate(model, noise, y)
        beyond = float(model.numbers.values(y)[0]) < 7e9
        return eqx.tree_at(lambda e: e.status, result, jnp.array(2)) if beyond else result

    monkeypatch.setattr(_running, "evaluate", walled)
    result = fit(RIGID, rigid_trace, [Parameter("force.k0", 8e9), "force.kr"])
    assert result.status == "not_converged"
    assert "beyond it the tool left its path" in result.message
    assert no_numbers(result)


def test_sweeps_are_raised_where_the_fit_needs_more():
    case = slot(mass=2.0, stiffness=2e6, duration=0.015, axes=("x",), sweeps=1)
    trace = noisy(case.with_settings(sweeps=3), ("Fx", "x"))
    result = fit(case, trace, ["force.k0"])
    assert result.success, result.message
    assert result.case.settings.sweeps > 1
    assert "sweeps were raised from 1 to" in result.message
    assert int(mx.simulate(result.case).status) == 0


def test_too_few_iterations_are_told_with_the_best_so_far(rigid_trace):
    result = fit(RIGID, rigid_trace, [Parameter("force.k0", 1e10), "force.kr"], max_iterations=3)
    assert result.status == "not_converged"
    assert "after 3 iterations" in result.message
    assert result["force.k0"].value < 1e10
    assert no_numbers(result)


def test_an_interrupt_keeps_the_best_so_far(rigid_trace):
    def stop(progress):
        if progress.iteration == 4:
            raise KeyboardInterrupt

    result = fit(RIGID, rigid_trace, [Parameter("force.k0", 1e10), "force.kr"], progress=stop)
    assert result.status == "interrupted"
    assert result["force.k0"].value < 1e10
    assert result.traces
    assert no_numbers(result)


def test_an_interrupt_before_anything_is_known_is_an_interrupt(rigid_trace):
    def stop(progress):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        fit(RIGID, rigid_trace, ["force.k0"], progress=stop)


def test_questions_that_cannot_be_asked_are_refused(rigid_trace):
    with pytest.raises(ValueError, match="no trace given"):
        fit(RIGID, [], ["force.k0"])
    with pytest.raises(ValueError, match=r"did you mean force\.k0"):
        fit(RIGID, rigid_trace, ["force.k00"])
    coarse = np.linspace(0, 0.0045, 13)
    many = [name for name in valid_names(SOFT) if name != "cut.spindle_speed"]
    with pytest.raises(TraceError, match="13 samples for 13 free parameters"):
        fit(SOFT, Trace(coarse, ("Fx",), np.ones((13, 1))), many)
    with jax.enable_x64(False), pytest.raises(ValueError, match="float64"):
        fit(RIGID, rigid_trace, ["force.k0"])


# ---- what a fit rests on


def test_the_triangle_holds_all_that_least_squares_needs():
    columns = np.random.default_rng(1).normal(size=(3, 2, 1300))
    factors = np.asarray(triangle(jnp.asarray(columns), part=512))
    for c in range(2):
        np.testing.assert_allclose(factors[c].T @ factors[c], columns[:, c] @ columns[:, c].T, rtol=1e-12, atol=1e-10)
        np.testing.assert_array_equal(factors[c], np.triu(factors[c]))


def rosenbrock(y, _):
    return jnp.stack([10 * (y[1] - y[0] ** 2), 1 - y[0], 0.1 * y[0]]), None


def factor(y):
    jacobian = jax.jacfwd(lambda y: rosenbrock(y, None)[0])(y)
    return np.linalg.qr(np.column_stack([jacobian, rosenbrock(y, None)[0]]), mode="r")


def test_optimistix_takes_the_same_path_with_the_linear_model_as_with_the_function():
    """Pins what `_solver` relies on: a step evaluates at `y_eval` only, value and Jacobian, and nothing else."""
    start = jnp.array([-1.2, 1.0])
    method = eqx.tree_at(
        lambda m: m.search,
        optx.LevenbergMarquardt(rtol=1e-10, atol=1e-10),
        optx.ClassicalTrustRegion(high_cutoff=0.75),
    )
    struct = eqx.filter_eval_shape(lambda: rosenbrock(start, None)[0])
    y, state = start, method.init(rosenbrock, start, None, {"jac": "fwd"}, struct, None, frozenset())
    steps = Steps(np.asarray(start))
    for _ in range(12):
        np.testing.assert_allclose(steps.proposal, state.y_eval, rtol=1e-9, atol=1e-12)
        accepted = int(state.num_accepted_steps)
        y, state, _ = method.step(rosenbrock, y, None, {"jac": "fwd"}, state, frozenset())
        assert steps.tell(factor(jnp.asarray(steps.proposal))) == (int(state.num_accepted_steps) > accepted)


def test_steps_reach_the_optimum_and_turn_failures_down():
    steps = Steps(np.array([-1.2, 1.0]))
    for i in range(100):
        if steps.stalled:
            break
        failed = i in (2, 5)
        assert not (steps.tell(None if failed else factor(jnp.asarray(steps.proposal))) and failed)
    expected = optx.least_squares(rosenbrock, optx.LevenbergMarquardt(1e-12, 1e-12), jnp.array([-1.2, 1.0]), has_aux=True)
    np.testing.assert_allclose(steps.proposal, expected.value, rtol=1e-6)


def test_a_positive_quantity_stays_positive_on_its_way(rigid_trace):
    seen = []
    evaluate = _running.evaluate
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(_running, "evaluate", lambda m, n, y: seen.append(np.array(m.numbers.values(y))) or evaluate(m, n, y))
        result = fit(RIGID, rigid_trace, [Parameter("force.k0", 1e8), "force.kr"])
    assert result.success
    assert min(v[0] for v in seen) > 0
    assert isinstance(free(RIGID, [Parameter("force.k0")]).transforms[0], Above)
