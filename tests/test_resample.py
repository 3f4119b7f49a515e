"""Band-limited sampling beside signals whose values are known at every time."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from identification._resample import PASSBAND, RIPPLE, kernel, resample

STEPS = 2000


def means(frequency, phase, steps=STEPS):
    """Means over the steps of the tones cos(2 pi f p + phase), f in cycles per step."""
    p = np.arange(steps)
    return np.sinc(frequency)[:, None] * np.cos(2 * np.pi * frequency[:, None] * p + phase[:, None])


def inner(cutoff, samples, seed=0):
    """Positions far enough from the ends, as unlike those of the model as can be."""
    edge = kernel(cutoff).shape[1] / 2
    return np.sort(np.random.default_rng(seed).uniform(edge, STEPS - 1 - edge, samples))


@pytest.mark.parametrize("cutoff", [2.0, 0.55, 0.5, 0.3, 0.1875, 0.06])
def test_tones_in_the_pass_band(cutoff):
    frequency = np.linspace(0, PASSBAND * min(cutoff, 0.5), 60)
    phase = np.random.default_rng(1).uniform(0, 2 * np.pi, 60)
    p = inner(cutoff, 500)
    found = resample(jnp.asarray(means(frequency, phase)), jnp.asarray(p), kernel(cutoff))
    expected = np.cos(2 * np.pi * frequency[:, None] * p + phase[:, None])
    assert np.abs(found - expected).max() < RIPPLE


@pytest.mark.parametrize("cutoff", [0.5, 0.3, 0.1875, 0.06])
def test_a_tone_above_the_nyquist_frequency_of_the_trace_is_gone(cutoff):
    frequency = np.linspace(cutoff, 0.5, 50)
    tones = np.cos(2 * np.pi * frequency[:, None] * np.arange(STEPS))
    found = resample(jnp.asarray(tones), jnp.asarray(inner(cutoff, 500)), kernel(cutoff))
    assert np.abs(found).max() < RIPPLE


@pytest.mark.parametrize("rate", [0.37, 0.9998, 1.0, 1.7])
def test_a_band_limited_signal_at_the_times_of_another_clock(rate):
    """`rate`: samples of the trace per step of the model."""
    rng = np.random.default_rng(2)
    cutoff = rate / 2
    frequency, phase = rng.uniform(0, PASSBAND * min(cutoff, 0.5), 40), rng.uniform(0, 2 * np.pi, 40)
    amplitude = rng.normal(size=40)
    times = 0.37 + np.arange(int(STEPS * rate)) / rate
    edge = kernel(cutoff).shape[1] / 2
    times = times[(times > edge) & (times < STEPS - 1 - edge)]
    values = (amplitude @ means(frequency, phase))[None]
    exact = amplitude @ np.cos(2 * np.pi * frequency[:, None] * times + phase[:, None])
    found = resample(jnp.asarray(values), jnp.asarray(times), kernel(cutoff))[0]
    assert np.sqrt(np.mean((found - exact) ** 2)) < RIPPLE * np.sqrt(np.mean(exact**2))


def test_derivatives_by_start_and_rate_of_the_clock():
    rng = np.random.default_rng(3)
    frequency, phase = rng.uniform(0, PASSBAND * 0.3, 20), rng.uniform(0, 2 * np.pi, 20)
    values, read = jnp.asarray(means(frequency, phase).sum(0)[None]), kernel(0.3)
    times = np.arange(100, 1800, 1 / 0.6)

    def model(start, rate):
        return resample(values, start + rate * jnp.asarray(times), read)[0]

    by_start, by_rate = jax.jacfwd(model, (0, 1))(0.3, 1.0)
    p = 0.3 + times
    slope = (-2 * np.pi * frequency[:, None] * np.sin(2 * np.pi * frequency[:, None] * p + phase[:, None])).sum(0)
    size = np.sqrt(np.mean(slope**2))
    assert np.abs(by_start - slope).max() < 10 * RIPPLE * size
    assert np.abs(by_rate - times * slope).max() < 10 * RIPPLE * size * times.max()
    # Of what is computed: two routes.
    weights = jnp.asarray(rng.normal(size=len(times)))
    reverse = jax.grad(lambda start: weights @ model(start, 1.0))(0.3)
    assert np.isclose(reverse, weights @ by_start, rtol=1e-10)
    h = 1e-5
    assert np.isclose(reverse, weights @ (model(0.3 + h, 1.0) - model(0.3 - h, 1.0)) / (2 * h), rtol=1e-5)


def test_linear_in_the_values():
    rng = np.random.default_rng(4)
    values, times = jnp.asarray(rng.normal(size=(3, 300))), jnp.asarray(np.linspace(-5, 310, 200))
    push = jnp.asarray(rng.normal(size=(3, 200)))

    def read(values):
        return resample(values, times, kernel(0.3))

    found, back = jax.vjp(read, values)
    (pulled,) = back(push)
    assert np.isclose(jnp.sum(push * found), jnp.sum(pulled * values), rtol=1e-11)
    batch = jax.vmap(read)(jnp.stack([values, 2 * values]))
    assert np.allclose(batch[1], 2 * found, rtol=1e-12, atol=1e-14)


def test_value_and_derivative_are_continuous_where_the_times_meet_a_sample():
    values = jnp.asarray(np.random.default_rng(5).normal(size=(1, 300)))  # noise: nothing of it smooth

    def at(p):
        return resample(values, p[None], kernel(0.5))[0, 0]

    for sample in (150.0, 151.0):
        value, slope = (np.array([f(jnp.asarray(sample + d)) for d in (-1e-12, 0, 1e-12)]) for f in (at, jax.grad(at)))
        assert np.isfinite(slope).all()
        assert np.ptp(value) < RIPPLE / 10
        assert np.ptp(slope) < 10 * RIPPLE


def test_values_that_are_no_means_are_found_again_where_the_times_coincide():
    rng = np.random.default_rng(6)
    frequency, phase = rng.uniform(0, 0.4, 30), rng.uniform(0, 2 * np.pi, 30)
    values = np.cos(2 * np.pi * frequency[:, None] * np.arange(STEPS) + phase[:, None])
    read = kernel(0.5, averaged=False)
    within = np.arange(read.shape[1] // 2, STEPS - read.shape[1] // 2)
    assert np.abs(resample(jnp.asarray(values), jnp.asarray(within, float), read) - values[:, within]).max() < RIPPLE


def test_before_and_after_its_samples_the_model_goes_on_as_it_began_and_ended():
    values = jnp.asarray(np.random.default_rng(7).normal(size=(2, 60)))
    read = kernel(0.5)
    long = jnp.pad(values, ((0, 0), (200, 200)), mode="edge")
    times = np.linspace(0, 59, 77)
    assert np.allclose(resample(values, times, read), resample(long, times + 200, read), atol=1e-12)
    beyond = resample(values, jnp.array([-30.0, 0.0, 59.0, 80.0]), read)
    assert np.array_equal(beyond[:, 0], beyond[:, 1])
    assert np.array_equal(beyond[:, 2], beyond[:, 3])


@pytest.mark.parametrize("cutoff", [0.0, -1.0, np.inf, np.nan])
def test_what_is_refused(cutoff):
    with pytest.raises(ValueError, match=r"cutoff: .* given; it must be greater than 0"):
        kernel(cutoff)
