"""The parts of `benchmarks.measured_slot` that need no recordings."""

import jax.numpy as jnp
import numpy as np

import millax as mx
from benchmarks.dynamometer.modes import guesses
from benchmarks.dynamometer.scores import multiple, r2

TURNING, STEPS, TURNS, LINES = 100.0, 800, 60, 30


def test_a_coupled_chain_is_found_from_lines_of_force_and_measurement():
    # Through the recursion of the sensor, in time: nothing in common with the lines but the equations.
    random = np.random.default_rng(0)
    residue = 0.5 * random.normal(size=(2, 3, 3))
    chain = mx.Resonances((620.0, 985.0), (0.04, 0.06), residue)
    angle = 2 * np.pi * np.arange(STEPS) / STEPS
    force, measured = [], []
    for _ in range(3):
        size, phase = random.normal(size=(2, 3, LINES))
        waves = np.cos(np.arange(1, LINES + 1)[:, None] * angle + phase[:, :, None])
        turn = np.sum(size[:, :, None] * waves, axis=1).T
        followed = np.asarray(chain(jnp.asarray(np.tile(turn, (TURNS, 1))), 1 / (TURNING * STEPS)))
        force.append(lines(turn))
        measured.append(lines(followed[-STEPS:]))
    bounds = ((300.0, 0.01), (2000.0, 0.5))
    best = guesses(np.array(force), np.array(measured), np.full((3, 3), 1e-4), TURNING, 2, bounds, prior=1.0)[0]
    order = np.argsort(best.frequency)
    np.testing.assert_allclose(np.asarray(best.frequency)[order], [620.0, 985.0], rtol=1e-3)
    np.testing.assert_allclose(np.asarray(best.damping_ratio)[order], [0.04, 0.06], rtol=1e-2)
    np.testing.assert_allclose(np.asarray(best.residue)[order], residue, atol=1e-2)


def lines(turn):
    return np.fft.rfft(turn, axis=0)[1 : LINES + 1] / STEPS


def test_r2_is_that_of_a_mean_for_nothing_and_one_for_everything():
    measured = np.random.default_rng(1).normal(size=(50, 3))
    np.testing.assert_allclose(r2(measured, measured), 1.0)
    np.testing.assert_allclose(r2(measured, np.broadcast_to(measured.mean(axis=0), (50, 3))), 0.0)


def test_lines_are_named_by_spindle_and_tooth():
    assert multiple(8) == "8 × spindle = 4 × tooth"
    assert multiple(9) == "9 × spindle"
