"""What is found in bad measurements, and that nothing is found in good ones."""

import numpy as np
import pytest
from cases import slot

import millax as mx
from identification import Trace, quality

N = 10_000
TIME = np.arange(N) * 1e-4
SIGMA = 4.0
"""Noise of a force [N]."""


def rng(seed=0):
    return np.random.default_rng(seed)


def force(noise=SIGMA, teeth=1.0, seed=0):
    """Forces of a tooth that is in the workpiece for 60 % of its 5 ms [N], shape (N,), never below 0."""
    phase = (TIME / 5e-3 + 0.13) % teeth
    return np.where(phase < 0.6, 300 * np.sin(np.pi * phase / 0.6) ** 2, 0) + noise * rng(seed).normal(size=N)


def quantised(values, step=0.0916):
    return np.round(values / step) * step


def trace(*columns, time=TIME):
    return Trace(time, ("Fx", "Fy", "Fz")[: len(columns)], np.column_stack(columns), units={"Fx": "kN"}, name="cut.csv")


def found(*columns):
    return [(finding.kind, finding.channel) for finding in quality(trace(*columns))]


# ---- nothing is wrong


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("step", [1e-9, 0.0916, 2.0, 20.0])
def test_noisy_forces_are_good(seed, step):
    assert found(quantised(force(seed=seed), step), quantised(-force(seed=seed + 9) + 50, step)) == []


@pytest.mark.parametrize("step", [1e-9, 0.0916, 1.0])
def test_forces_without_noise_that_are_zero_between_teeth_are_good(step):
    still = quantised(force(noise=0), step)
    assert found(still) == []
    assert found(still, 0.3 * still, -still) == []
    alternating = np.where((TIME / 5e-3 + 0.13) % 2 < 1, 1.0, 0.3) * still
    assert found(quantised(alternating, step)) == []


def test_air_before_and_after_the_cut_is_good():
    for noise in (0.0, SIGMA):
        values = np.where((TIME > 0.21) & (TIME < 0.83), force(noise=0), 0.0) + noise * rng(1).normal(size=N)
        assert found(values, 2 * values) == []


def test_a_slow_signal_in_coarse_steps_is_good():
    slow = 1e-4 * np.sin(2 * np.pi * 10 * np.arange(50_000) * 1e-5)
    for noise in (0.0, 2e-8):
        values = quantised(slow + noise * rng().normal(size=50_000), 1e-7)
        assert quality(Trace(np.arange(50_000) * 1e-5, ("x",), values[:, None])) == ()


@pytest.mark.parametrize("axes", [(), ("x", "y")])
@pytest.mark.parametrize("teeth", [2, 3])
@pytest.mark.parametrize("noise", [0.0, SIGMA])
def test_simulations_are_good(axes, teeth, noise):
    sim = mx.simulate(slot(duration=0.1, axes=axes, teeth=teeth))
    channels = ("Fx", "Fy", *axes)
    values = np.concatenate([sim.force[:, :2], sim.displacement], axis=1)
    scale = np.array([1.0, 1.0, *(1e-7 for _ in axes)])
    values = values + noise * scale * rng().normal(size=values.shape)
    assert quality(Trace(np.asarray(sim.time), channels, values)) == ()
    rounded = np.array([[float(f"{x:.6g}") for x in row] for row in values])  # as files have them
    assert quality(Trace(np.asarray(sim.time), channels, rounded)) == ()


def test_a_growing_vibration_is_no_drift_and_no_offset():
    growth = np.exp(5 * TIME)
    vibration = 20 + growth * np.sin(2 * np.pi * 317 * TIME) + 0.1 * growth**1.2 + 0.1 * rng().normal(size=N)
    assert found(vibration) == []


# ---- something is


@pytest.mark.parametrize("step", [1e-9, 0.0916])
@pytest.mark.parametrize(("low", "high"), [(-np.inf, 290.0), (-np.inf, 200.0), (-2.0, 280.0)])
def test_saturation(step, low, high):
    values = np.clip(quantised(force(), step), low, high)
    kinds = [f for f in quality(trace(values)) if f.kind == "saturated"]
    assert {f.value for f in kinds} >= {high}
    assert all(f.kind == "saturated" for f in quality(trace(values)))
    top = kinds[0]
    assert top.channel == "Fx"
    assert 0 <= top.start < 0.02
    assert 0.98 < top.end < 1
    assert top.words.startswith(f"cut.csv: Fx from {top.start:.6g} s to")
    assert f"does not go above {high / 1e3:.4g} kN" in top.words
    assert "larger range" in top.words


def test_saturation_with_the_noise_of_the_converter():
    values = quantised(np.clip(force(), -np.inf, 250.0) + 0.05 * rng(3).normal(size=N))
    assert found(values) == [("saturated", "Fx")]
    assert found(-values) == [("saturated", "Fx")]


def test_a_single_peak_that_is_cut_off_is_no_saturation():
    values = force()
    values[4000:4004] = 500.0
    assert found(values) == []


@pytest.mark.parametrize("held", [0.0, 123.456])
@pytest.mark.parametrize("noise", [SIGMA, 0.3])
def test_drop_outs(held, noise):
    values = force(noise=noise)
    values[4000:4015] = held
    (one,) = quality(trace(force(seed=5), values))
    assert (one.kind, one.channel, one.value) == ("drop-out", "Fy", held)
    assert (one.start, one.end) == (pytest.approx(0.4), pytest.approx(0.4014))
    assert f"stays at exactly {held:.4g} N for 15 samples" in one.words
    values[7000:7200] = held
    (longest,) = quality(trace(force(seed=5), values))
    assert (longest.start, longest.end) == (pytest.approx(0.7), pytest.approx(0.7199))
    assert "200 samples, the longest of 2 such times" in longest.words


def test_drop_outs_by_chance_of_every_channel_at_once():
    columns = [force(seed=1), force(seed=2)]
    for start in rng(4).choice(N - 50, 12, replace=False):
        for column in columns:
            column[start : start + 30] = 0.0
    assert found(*columns) == [("drop-out", "Fx"), ("drop-out", "Fy")]


@pytest.mark.parametrize("since", [0, 300, 5000, 9000])
def test_a_channel_that_dies(since):
    values = force()
    values[since:] = -3.2
    assert ("drop-out", "Fy") in found(force(seed=7), values)
    values[since:] = 0.0
    if since:
        assert ("drop-out", "Fy") in found(force(seed=7), values)


def test_a_drop_out_in_a_signal_of_steps():
    values = quantised(force(), 5.0)
    values[2000:2300] = values[2000]
    assert found(values) == [("drop-out", "Fx")]


@pytest.mark.parametrize("rise", [20.0, -60.0])
@pytest.mark.parametrize("shape", [lambda t: t, lambda t: (1 - np.exp(-2 * t)) / (1 - np.exp(-2))])
def test_drift(rise, shape):
    (one,) = quality(trace(force(seed=3), force() + rise * shape(TIME)))
    assert (one.kind, one.channel) == ("drift", "Fy")
    assert one.value == pytest.approx(rise, rel=0.2)
    assert (one.start, one.end) == (pytest.approx(0, abs=0.06), pytest.approx(1, abs=0.06))
    assert f"its mean {'rises' if rise > 0 else 'falls'} by {abs(one.value):.4g} N" in one.words


def test_drift_of_a_cut_that_begins_and_ends():
    inside = (TIME > 0.2) & (TIME < 0.87)
    values = np.where(inside, force(), SIGMA * rng(8).normal(size=N)) + 60 * TIME
    (one,) = (finding for finding in quality(trace(values)) if finding.kind == "drift")
    assert one.value == pytest.approx(60 * (one.end - one.start), rel=0.2)
    assert one.start >= 0.2
    assert one.end <= 0.9


@pytest.mark.parametrize("offset", [15.0, -40.0])
def test_offset(offset):
    values = np.where(TIME > 0.23, force(), SIGMA * rng(8).normal(size=N))
    assert found(values) == []
    (one,) = quality(trace(values + offset))
    assert (one.kind, one.start, one.end) == ("offset", pytest.approx(0, abs=1e-9), pytest.approx(0.2, abs=2e-4))
    assert one.value == pytest.approx(offset, abs=1)
    assert f"it is {one.value / 1e3:.4g} kN before the cut begins" in one.words


def test_nothing_is_said_about_a_handful_of_samples():
    for n in (2, 3, 20, 60, 150, 200):
        assert quality(Trace(TIME[:n], ("Fx",), force()[:n, None])) == ()
