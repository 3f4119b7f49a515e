"""The measuring chain beside SciPy's, closed forms, and its own transfer function."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import signal

from identification._resample import kernel, resample
from millax._sensor import LowPass, Resonances, Sensor

STEP = 5e-5
RNG = np.random.default_rng(3)
COUPLED = Resonances([820.0, 1900.0], [0.03, 1.0], 0.4 * RNG.normal(size=(2, 3, 3)))
SENSOR = Sensor([1.1, -0.9, 1.3], [3.0, -5.0, 1.0], 1e-4, COUPLED, LowPass(2500.0, 3))


def spectrum(chain, steps=2**14):
    """What becomes of tones [Hz], as matrices, from what becomes of one step with a force along each axis."""
    frequency = np.fft.rfftfreq(steps, STEP)
    pushes = np.zeros((3, steps, 3))
    pushes[np.arange(3), 2, np.arange(3)] = 1.0
    found = np.fft.rfft(np.asarray(jax.vmap(lambda push: chain(push, STEP))(jnp.asarray(pushes))), axis=1)
    return frequency, np.moveaxis(found, 0, -1) * np.exp(2j * np.pi * frequency * 2 * STEP)[:, None, None]


def exact(resonances, frequency):
    s = 2j * np.pi * frequency[:, None]
    w, zeta = 2 * np.pi * np.asarray(resonances.frequency), np.asarray(resonances.damping_ratio)
    h = w**2 / (s**2 + 2 * zeta * w * s + w**2)
    return np.eye(3) + np.einsum("fm,mab->fab", h - 1, np.asarray(resonances.residue))


def state_space(resonances):
    w, zeta, residue = (np.asarray(x) for x in (resonances.frequency, resonances.damping_ratio, resonances.residue))
    w = 2 * np.pi * w
    a, b, c = np.zeros((6 * len(w), 6 * len(w))), np.zeros((6 * len(w), 3)), np.zeros((3, 6 * len(w)))
    for m in range(len(w)):
        x, v = slice(6 * m, 6 * m + 3), slice(6 * m + 3, 6 * m + 6)
        a[x, v], a[v, x], a[v, v] = np.eye(3), -(w[m] ** 2) * np.eye(3), -2 * zeta[m] * w[m] * np.eye(3)
        b[v], c[:, x] = w[m] ** 2 * np.eye(3), residue[m]
    return a, b, c, np.eye(3) - residue.sum(0)


@pytest.mark.parametrize("ratio", [0.01, 0.7, 1.0, 3.0])
def test_mean_over_each_step_is_exact_for_a_force_held_in_it(ratio):
    resonances = eqx.tree_at(lambda r: r.damping_ratio, COUPLED, jnp.array([0.02, ratio]))
    force = RNG.normal(size=(300, 3))
    around = np.concatenate([force[:1], force, force[-1:]])
    held = force - np.diff(around, 2, axis=0) / 12
    a, b, c, d = state_space(resonances)
    # The mean of the response over each step, by the integral of the state over half steps of a force that is held.
    augmented = np.block([[a, np.zeros((len(a), 3))], [c, np.zeros((3, 3))]])
    times = np.arange(301) * STEP
    inputs = np.concatenate([held, held[-1:]])
    _, _, states = signal.lsim(
        (augmented, np.concatenate([b, 0 * d]), np.eye(len(a) + 3), np.zeros((len(a) + 3, 3))), inputs, times, interp=False
    )
    means = np.diff(states[:, -3:], axis=0) / STEP
    assert np.allclose(resonances(force, STEP), means + force @ d.T, atol=1e-9, rtol=0)


@pytest.mark.parametrize("order", [1, 2, 3, 4, 5])
def test_low_pass_is_butterworth(order):
    frequency, found = spectrum(LowPass(1500.0, order))
    _, h = signal.freqs(*signal.butter(order, 2 * np.pi * 1500.0, analog=True), worN=2 * np.pi * frequency)
    wrong = np.abs(found - h[:, None, None] * np.eye(3)).max((1, 2)) / np.abs(h)
    for samples, allowed in ((10, 3e-3), (20, 2e-4), (40, 3e-5)):
        assert wrong[frequency * STEP * samples < 1].max() < (order + 1) // 2 * allowed


def test_transfer_function_of_coupled_resonances():
    frequency, found = spectrum(COUPLED)
    h = exact(COUPLED, frequency)
    wrong = np.abs(found - h).max((1, 2)) / np.abs(h).max((1, 2))
    for samples, allowed in ((10, 3e-3), (20, 2e-4), (40, 3e-5)):
        assert wrong[frequency * STEP * samples < 1].max() < allowed


def test_means_of_a_tone_become_means_of_the_measured_tone():
    frequency, resonance = 700.0, Resonances.per_axis([800.0], [0.05], ["x"])
    middle = (np.arange(4000) + 0.5) * STEP
    force = np.stack([np.sin(2 * np.pi * frequency * middle), 0 * middle, 0 * middle], 1) * np.sinc(frequency * STEP)
    h = exact(resonance, np.array([frequency]))[0, 0, 0]
    expected = np.imag(h * np.exp(2j * np.pi * frequency * middle)) * np.sinc(frequency * STEP)
    late = slice(2000, -1)
    assert np.allclose(resonance(force, STEP)[late, 0], expected[late], atol=3e-4 * abs(h), rtol=0)


def test_step_response_converges_to_the_closed_form_with_the_square_of_the_step():
    w, zeta = 2 * np.pi * 600.0, 0.1
    damped = w * np.sqrt(1 - zeta**2)

    def wrong(step):
        steps = round(0.005 / step)
        fine = (np.arange(steps * 40) + 0.5) * step / 40
        decay = np.exp(-zeta * w * fine)
        response = 1 - decay * (np.cos(damped * fine) + zeta * w / damped * np.sin(damped * fine))
        measured = Resonances.per_axis([600.0], [zeta], ["y"])(jnp.ones((steps, 3)), step)
        return np.abs(measured[:, 1] - response.reshape(-1, 40).mean(1)).max()

    first, second, third = wrong(1e-4), wrong(5e-5), wrong(2.5e-5)
    assert first < 0.02
    assert 3.5 < first / second < 4.6
    assert 3.5 < second / third < 4.6


def test_a_static_force_passes_as_it_is():
    force = jnp.broadcast_to(jnp.array([100.0, -50.0, 20.0]), (4000, 3))
    shown = np.asarray(SENSOR(force, STEP)[-1])
    assert np.allclose(shown, [110.0 + 3, 45.0 - 5, 26.0 + 1], rtol=1e-9)
    assert np.array_equal(Sensor()(force, STEP), force)


def test_per_axis_is_a_coupled_chain_without_coupling():
    force = jnp.asarray(RNG.normal(size=(200, 3)))
    together = Resonances.per_axis([700.0, 900.0], [0.02, 0.05], ["x", "z"])
    residue = np.zeros((2, 3, 3))
    residue[0, 0, 0] = residue[1, 2, 2] = 1.0
    assert np.array_equal(together(force, STEP), Resonances([700.0, 900.0], [0.02, 0.05], residue)(force, STEP))
    assert np.allclose(together(force, STEP)[:, 1], force[:, 1], atol=1e-14)
    alone = Resonances.per_axis([900.0], [0.05], ["z"])
    assert np.allclose(together(force, STEP)[:, 2], alone(force, STEP)[:, 2], atol=1e-13)


def test_derivatives_by_every_number():
    force = jnp.asarray(RNG.normal(size=(120, 3)))
    weights = jnp.asarray(RNG.normal(size=(120, 3)))
    numbers, build = jax.flatten_util.ravel_pytree(SENSOR)

    def total(numbers, step):
        return jnp.sum(weights * build(numbers)(force, step))

    forward = jax.jacfwd(total, (0, 1))(numbers, STEP)
    reverse = jax.grad(total, (0, 1))(numbers, STEP)
    assert np.allclose(forward[0], reverse[0], rtol=1e-9, atol=1e-12)
    assert np.isclose(forward[1], reverse[1], rtol=1e-9)
    value = jax.jit(total)
    for i, number in enumerate(np.asarray(numbers)):
        h = 1e-5 * max(abs(number), 1e-3)
        change = jnp.zeros_like(numbers).at[i].set(h)
        slope = (value(numbers + change, STEP) - value(numbers - change, STEP)) / (2 * h)
        assert np.isclose(forward[0][i], slope, rtol=1e-5, atol=1e-6), i
    slope = (value(numbers, STEP * (1 + 1e-6)) - value(numbers, STEP * (1 - 1e-6))) / (2e-6 * STEP)
    assert np.isclose(forward[1], slope, rtol=1e-5)


def test_batch():
    force = jnp.asarray(RNG.normal(size=(50, 3)))
    factors = jnp.array([0.9, 1.0, 1.2])
    many = jax.vmap(lambda k: jax.tree.map(lambda leaf: leaf * k, SENSOR)(force, STEP))(factors)
    for k, one in zip(factors, many, strict=True):
        assert np.allclose(one, jax.tree.map(lambda leaf, k=k: leaf * k, SENSOR)(force, STEP), rtol=1e-10, atol=1e-12)


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        (lambda: Sensor(gain=[1.0, 2.0]), r"sensor.gain: shape \(2,\) given"),
        (lambda: Sensor(bias=[0.0, np.nan, 0.0]), "sensor.bias: nan N given"),
        (lambda: Resonances(800.0, [0.1], np.eye(3)[None]), r"frequency: shape \(\) given"),
        (lambda: Resonances([800.0], [0.1, 0.2], np.eye(3)[None]), r"damping_ratio: shape \(2,\) given"),
        (lambda: Resonances([800.0], [0.1], np.eye(3)), r"residue: shape \(3, 3\) given"),
        (lambda: Resonances.per_axis([-800.0], [0.1], ["x"]), "frequency: -800 Hz given"),
        (lambda: Resonances.per_axis([800.0], [0.0], ["x"]), "damping_ratio: 0 given"),
        (lambda: Resonances.per_axis([800.0], [0.1], ["w"]), "they are x, y and z"),
        (lambda: LowPass(0.0), "sensor.low_pass.cutoff: 0 Hz given"),
        (lambda: LowPass([1.0, 2.0]), "it must be one number"),
        (lambda: LowPass(100.0, 0), "sensor.low_pass.order: 0 given"),
    ],
)
def test_what_is_refused(wrong, words):
    with pytest.raises(ValueError, match=words):
        wrong()


def test_whole_chain_at_the_times_of_a_trace():
    """A periodic force by its Fourier series, measured with another clock, a delay, and a speed that no grid of it fits."""
    rng = np.random.default_rng(8)
    tooth, steps, times = 199.994, 80, 0.3 + np.arange(1000) * 1e-4
    harmonic = np.arange(1, 12)
    force = rng.normal(size=(11, 3, 2)) @ [1, 1j] * 300 / harmonic[:, None] ** 2
    resonances = Resonances([700.0, 800.0, 1500.0], [0.03, 0.02, 0.05], 0.4 * rng.normal(size=(3, 3, 3)))
    sensor = Sensor([1.05, -0.9, 1.0], [3.0, 4.0, 5.0], 1.3e-4, resonances, LowPass(3500.0, 2))
    s = 2j * np.pi * harmonic * tooth
    _, low_pass = signal.freqs(*signal.butter(2, 2 * np.pi * 3500.0, analog=True), worN=s.imag)
    measured = np.einsum("fab,fb->fa", exact(resonances, harmonic * tooth) * low_pass[:, None, None], force)
    expected = np.real(np.exp(np.outer(times - 1.3e-4, s)) @ measured) * [1.05, -0.9, 1.0] + [3.0, 4.0, 5.0]

    step = 1 / tooth / steps
    middle = (np.arange(round(0.42 / step)) + 0.5) * step
    means = np.real(np.exp(np.outer(middle, s)) @ (force * np.sinc(harmonic * tooth * step)[:, None]))
    shown = sensor(jnp.asarray(means), step).T
    position = (jnp.asarray(times) - sensor.delay - middle[0]) / step
    found = resample(shown, position, kernel(step * 1e4 / 2)).T
    assert np.sqrt(np.mean((found - expected) ** 2) / np.var(expected)) < 1e-3
