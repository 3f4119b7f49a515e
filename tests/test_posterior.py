"""The posterior of a fit by sampling, against Laplace's approximation where it holds and integrals where it does not."""

import dataclasses
import re
import sys

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases import slot
from scipy.signal import lfilter
from scipy.stats import lognorm

import identification
import millax as mx
from identification import NoiseModel, Parameter, Prior, Trace, fit, sample
from identification._chains import Density, at, begin, go_on
from identification._evaluate import Model
from identification._noise import Noise
from identification._parameters import FreeParameters, free
from identification._posterior_figure import posterior
from identification._posterior_result import mixing

RIGID = slot(axes=(), duration=0.03)
FORCES = ("Fx", "Fy")
NORMAL = ("force.k0", "force.kr")


def noisy(sigma, noise=None):
    sim = mx.simulate(RIGID)
    exact = np.asarray(sim.force[:, :2])
    values = exact + sigma * np.random.default_rng(0).normal(size=exact.shape)
    return Trace(np.asarray(sim.time), FORCES, values, noise or {})


@pytest.fixture(scope="module")
def fitted():
    """Two parameters that are known well, the noise estimated: the posterior is nearly normal."""
    return fit(RIGID, noisy(2.0), NORMAL)


@pytest.fixture(scope="module")
def drawn(fitted):
    return sample(fitted, draws=1000, seed=1)


def test_where_the_posterior_is_normal_it_is_as_the_fit_says(fitted, drawn):
    assert drawn.reason is None
    assert drawn.status == "sampled"
    assert drawn.names == NORMAL
    assert drawn.draws.shape == (4, 250, 2)
    assert (drawn.rhat < 1.01).all()
    assert (drawn.ess > 400).all()
    assert drawn.agrees
    assert (np.abs(drawn.shift) < 0.1).all()
    np.testing.assert_allclose(drawn.ci95, [e.ci95 for e in fitted.parameters], rtol=1e-3)
    correlation = np.corrcoef(drawn.draws.reshape(-1, 2).T)
    np.testing.assert_allclose(correlation, fitted.correlation, atol=0.05)
    assert drawn.to_json()["parameters"][1]["mean"] == pytest.approx(0.3, rel=0.01)


def test_bands_hold_the_model(fitted, drawn):
    ((low, high),) = drawn.bands(fitted)
    (trace,) = fitted.traces
    assert low.shape == trace.fitted.shape
    inside = (low <= trace.fitted) & (trace.fitted <= high)
    assert inside.mean() > 0.95
    width = (high - low) / (2 * 1.96)
    counts = trace.fitted_std > 0.1 * trace.fitted_std.max()
    assert np.median(width[counts] / trace.fitted_std[counts]) == pytest.approx(1, abs=0.15)


def test_the_picture_names_what_it_shows(fitted, drawn):
    picture = posterior(drawn, fitted)
    assert picture.startswith("<svg viewBox=")
    text = re.findall(r">([^<>]+)</text>", picture)
    assert text.count("force.k0") == 1  # below the first column; the first row is a count of draws
    assert text.count("force.kr") == 2
    assert "[N/m²]" in text
    assert "[-]" in text


def test_the_seed_says_which_draws(fitted):
    told = []
    one, same, other = (
        sample(fitted, draws=100, warmup=25, seed=seed, progress=lambda p: told.append((p.stage, p.iteration)))
        for seed in (3, 3, 4)
    )
    np.testing.assert_array_equal(one.draws, same.draws)
    assert one.seed == 3
    assert np.abs(one.draws - other.draws).max() > 0
    assert told[:3] == [("compiling", 0), ("warming up", 100), ("sampling", 200)]
    # Too few to be trusted, and that is said.
    assert "independent draws, 400 are needed" in one.reason


def test_a_stop_keeps_the_draws_so_far(fitted):
    def stop(after):
        def progress(p):
            if p.iteration >= after:
                raise KeyboardInterrupt

        return progress

    found = sample(fitted, warmup=25, progress=stop(300))
    assert found.status == "interrupted"
    assert found.draws.shape == (4, 50, 2)
    with pytest.raises(KeyboardInterrupt):
        sample(fitted, progress=stop(100))


# ---- the density


def test_the_density_of_the_sampler_is_that_of_the_fit(fitted):
    """Reverse mode through the simulation beside the triangular factors of the fit, which have forward mode in them."""
    density = Density.of(fitted)
    chain, _ = go_on(density, jnp.asarray(True), jnp.asarray(0.65), begin(density, jax.random.key(0)))
    same = at(density, chain.state.position)
    assert float(jnp.linalg.norm(chain.state.position)) > 0.1
    assert float(chain.state.logdensity) == pytest.approx(float(same.logdensity), rel=1e-12)
    np.testing.assert_allclose(chain.state.logdensity_grad, same.logdensity_grad, rtol=1e-6, atol=1e-8)
    assert at(density, jnp.array([1e7, 0.0])) is None


@pytest.mark.long
@pytest.mark.parametrize("noise", [NoiseModel(order=1), NoiseModel("student")])
def test_noise_that_is_coloured_or_has_outliers_is_that_of_the_fit(noise):
    result = fit(RIGID, noisy(2.0), NORMAL, noise=noise)
    found = sample(result, draws=1000)
    assert found.reason is None
    assert found.agrees
    density = Density.of(result)
    assert density.estimated == (noise.distribution == "normal",) * 2
    chain, _ = go_on(density, jnp.asarray(True), jnp.asarray(0.65), begin(density, jax.random.key(0)))
    same = at(density, chain.state.position)
    assert float(chain.state.logdensity) == pytest.approx(float(same.logdensity), rel=1e-12)
    np.testing.assert_allclose(chain.state.logdensity_grad, same.logdensity_grad, rtol=1e-6, atol=1e-7)


class Walled(eqx.Module):
    """Stands in for a `Model` that cannot be used beyond y = 1, where its errors are NaN."""

    numbers: FreeParameters

    def errors(self, _, y):
        return jnp.sqrt(1 - y), y[0] < 0.9


def test_where_nothing_can_be_simulated_it_is_minus_infinity_and_its_gradient_a_number():
    numbers = free(RIGID, [Parameter("force.kr", 0.3)])
    density = Density(Walled(numbers), Noise(np.ones(1), np.zeros((1, 0))), jnp.zeros(1), jnp.eye(1), (1,), (False,))
    value, gradient = jax.jit(jax.vmap(jax.value_and_grad(lambda z: density(z))))(jnp.array([[0.5], [0.95], [1.5]]))
    assert jnp.isfinite(value).tolist() == [True, False, False]
    assert value[1:].tolist() == [-jnp.inf, -jnp.inf]
    assert gradient[1:].tolist() == [[0.0], [0.0]]
    assert float(gradient[0, 0]) == pytest.approx(0.5)  # of -(1 - y)/2, and no slope: kr has no bounds but its range


def along(parameters, points=4000):
    """A grid over the one parameter, and the density of its value [SI] without any measurement, normalised."""
    numbers = free(RIGID, parameters)
    y = jnp.linspace(-6, 6, points)
    density = Density(Model((), (), numbers, ()), Noise(np.zeros(0), np.zeros((0, 0))), y[:1], jnp.eye(1), (), ())
    log = jax.vmap(lambda y: density.total(jnp.zeros(0), y[None]))(y)
    value = np.asarray(jax.vmap(lambda y: numbers.values(y[None])[0])(y))
    slope = np.gradient(value, np.asarray(y), edge_order=2)
    found = np.exp(np.asarray(log) - float(log.max())) / slope
    return value, found / np.trapezoid(found, value)


@pytest.mark.parametrize("bounds", [(None, None), (0.1, 0.9), (None, 0.9)])
def test_the_prior_is_flat_in_the_value_within_its_bounds(bounds):
    _, density = along([Parameter("force.r", 0.3, bounds)])
    np.testing.assert_allclose(density, density[0], rtol=1e-3)


def test_what_is_known_of_a_logarithm_is_normal_in_the_logarithm():
    value, density = along([Parameter("force.k0", 5e9, prior=Prior(4e9, factor=1.5))])
    np.testing.assert_allclose(density, lognorm.pdf(value, np.log(1.5), scale=4e9), rtol=1e-3, atol=1e-6 * density.max())


@pytest.mark.long
def test_where_it_is_not_normal_the_draws_are_those_of_the_integral():
    """Two parameters that are hardly known, one of them within bounds, beside the posterior on a grid of their values."""
    sigma = 200.0
    trace = noisy(sigma, dict.fromkeys(FORCES, sigma))
    result = fit(RIGID, trace, [Parameter("force.r", 0.1), Parameter("force.kr", 0.3, (0.1, 0.6))])
    assert result.success, result.message
    values = np.linspace(0.002, 0.3, 75), 0.1 + (np.arange(50) + 0.5) / 100

    @jax.jit
    def squares(r, kr):
        case = eqx.tree_at(lambda c: (c.force.r, c.force.kr), RIGID, (r, kr))
        return jnp.sum((mx.simulate(case, throw=False).force[:, :2] - trace.values) ** 2)

    cost = np.array([[float(squares(r, kr)) for kr in values[1]] for r in values[0]]) / sigma**2
    weight = np.exp((cost.min() - cost) / 2)
    found = sample(result)
    assert found.reason is None
    assert not found.agrees
    flat_in_y = weight / np.outer(values[0], (values[1] - 0.1) * (0.6 - values[1]))
    for i, value in enumerate(values):
        marginal = weight.sum(axis=1 - i) / weight.sum()
        mean = marginal @ value
        std = np.sqrt(marginal @ (value - mean) ** 2)
        assert abs(found.mean[i] - mean) < 0.08 * std
        assert found.std[i] == pytest.approx(std, rel=0.06)
        # A prior that is flat in the solver's coordinate would be seen.
        assert abs(np.average(value, weights=flat_in_y.sum(axis=1 - i)) - mean) > 0.15 * std
        expected = np.interp([0.1, 0.5, 0.9], np.cumsum(marginal) - marginal / 2, value)
        np.testing.assert_allclose(found.quantiles([0.1, 0.5, 0.9])[:, i], expected, atol=0.12 * std)


# ---- whether chains are told apart


def autoregressive(phi, chains=4, draws=2000):
    rng = np.random.default_rng(5)
    return lfilter([1], [1, -phi], rng.normal(size=(chains, draws + 500)), axis=1)[:, 500:]


def test_effective_numbers_are_those_of_a_known_process():
    phi = np.array([-0.3, 0.0, 0.5, 0.9])
    rhat, ess = mixing(np.stack([autoregressive(p) for p in phi], axis=-1))
    np.testing.assert_allclose(ess, 8000 * (1 - phi) / (1 + phi), rtol=0.25)
    assert (rhat < 1.03).all()
    assert rhat[1] < 1.005


def test_chains_that_differ_in_place_or_width_do_not_agree():
    white = autoregressive(0.0)
    moved, wide, drifting = white.copy(), white.copy(), white + np.linspace(0, 1, 2000)
    moved[0] += 0.5
    wide[0] *= 2
    rhat, _ = mixing(np.stack([white, moved, wide, drifting], axis=-1))
    assert rhat[0] < 1.01
    assert (rhat[1:] > 1.01).all()


# ---- what is refused


def test_a_fit_without_a_covariance_is_refused(fitted):
    result = dataclasses.replace(fitted, status="at_bound", message="The bound decides force.kr.")
    with pytest.raises(ValueError, match=r"ended as at_bound: The bound decides force\.kr"):
        sample(result)


def coloured(fitted, order):
    estimates = tuple(dataclasses.replace(e, widened=1.6) for e in fitted.parameters)
    (trace,) = fitted.traces
    traces = (dataclasses.replace(trace, orders={"Fx": 3, "Fy": 0}),)
    return dataclasses.replace(fitted, parameters=estimates, traces=traces, noise_model=NoiseModel(order=order))


@pytest.mark.parametrize(("order", "words"), [(0, r"order=3\)"), (2, r"order=5\)"), (20, "the model misses something")])
def test_noise_that_is_not_as_was_said_is_refused(fitted, order, words):
    with pytest.raises(ValueError, match=r"1\.6 times") as error:
        sample(coloured(fitted, order))
    assert error.match(words)


@pytest.mark.parametrize("numbers", [{"draws": 0}, {"chains": 1}, {"warmup": 0}, {"acceptance": 1}])
def test_numbers_out_of_range_are_refused(fitted, numbers):
    ((name, _),) = numbers.items()
    with pytest.raises(ValueError, match=f"{name}: . given; it must"):
        sample(fitted, **numbers)


def test_without_blackjax_it_is_said_how_to_install_it(fitted, monkeypatch):
    monkeypatch.delitem(sys.modules, "identification._chains")
    monkeypatch.delattr(identification, "_chains")
    monkeypatch.setitem(sys.modules, "blackjax", None)
    with pytest.raises(ImportError, match=r'pip install "millax\[posterior\]"'):
        sample(fitted)


def test_bands_are_of_the_fit_that_was_sampled(fitted, drawn):
    other = dataclasses.replace(drawn, names=("force.r", "force.kr"))
    with pytest.raises(ValueError, match=r"a fit of force\.k0, force\.kr given; these are draws of force\.r"):
        other.bands(fitted)
    with pytest.raises(ValueError, match="draws: 1 given"):
        drawn.bands(fitted, draws=1)
