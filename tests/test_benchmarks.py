"""The programs of `make validate` and `make bench`: their yardsticks compute the same cut, their tables can say no."""

import dataclasses
import importlib

import numpy as np
import pytest
from rich.console import Console

import millax as mx
from benchmarks import compiled
from benchmarks.figures import Figure, below, near, show
from benchmarks.scan import step_by_step
from benchmarks.slot import light, six_coordinates, slot
from benchmarks.validate import SUBJECTS
from benchmarks.validation import programs

needs_gcc = pytest.mark.skipif(not compiled.have_compiler(), reason="the C loops need gcc")


def error(values, reference):
    """Largest difference over the largest value."""
    return np.abs(np.asarray(values) - np.asarray(reference)).max() / np.abs(np.asarray(reference)).max()


def with_stock(stock):
    return dataclasses.replace(slot(duration=0.12), stock=stock)


def with_teeth(teeth):
    return dataclasses.replace(slot(duration=0.1), tool=mx.EndMill(0.02, teeth), settings=mx.Settings(60, 40, 3))


CUTS = {
    "slot": lambda: slot(duration=0.12),
    "no border": lambda: slot(duration=0.1, border=False),
    "hard gates": lambda: slot(duration=0.1, width=0.0),
    "one pass": lambda: slot(duration=0.1, passes=1),
    "blocks": lambda: slot(duration=0.1, blocks=4),
    "half immersion": lambda: with_stock(mx.Stock.box((0.0, None), (None, 0.0))),
    "walls, entry and exit": lambda: with_stock(mx.Stock.box((0.0, 0.004), (-0.003, 0.005))),
    "oblique borders": lambda: with_stock(mx.Stock(np.array([[-0.96, 0.28], [0.6, 0.8]]), np.array([0.002, 0.006]))),
    "one tooth": lambda: with_teeth(1),
    "five teeth": lambda: with_teeth(5),
    "light tool mode at its limit": lambda: light(duration=0.1),
    "six coordinates, full matrices": lambda: six_coordinates(duration=0.1),
}


@needs_gcc
@pytest.mark.parametrize("cut", CUTS)
def test_the_engine_agrees_with_the_c_loop(cut):
    # Nothing in common but the equations: C, one step after the other, converged in each. 1e-9 leaves room for rounding.
    case = CUTS[cut]()
    case = dataclasses.replace(case, settings=dataclasses.replace(case.settings, sweeps=30))
    sim, loop = mx.simulate(case), compiled.same_model(case, tolerance=1e-18)()
    assert error(sim.force[:, :2], loop.force) < 1e-9
    assert error(sim.displacement[:, :2], loop.displacement) < 1e-9
    assert error(sim.chip_thickness, loop.thickness) < 1e-9


@needs_gcc
def test_the_c_loop_is_as_good_as_the_engine_at_the_tolerance_at_which_it_is_timed():
    case = slot(duration=0.12)
    assert error(compiled.same_model(case)().force, compiled.same_model(case, tolerance=1e-18)().force) < 1e-6


@needs_gcc
def test_the_simplified_loop_computes_the_same_cut():
    # It samples the force of a step behind hard gates, which costs accuracy at the border: 3 % of the displacement.
    case = slot(duration=0.1)
    sim, loop = mx.simulate(case), compiled.sampled(case)()
    assert error(loop.displacement, sim.displacement) < 0.05
    assert np.abs(loop.force.mean(0) - sim.force.mean(0)[:2]).max() < 0.02 * np.abs(sim.force).max()


def test_the_scan_over_steps_agrees_with_the_engine():
    case = slot(duration=0.05, sweeps=12)
    sim, (force, displacement) = mx.simulate(case), step_by_step(case)()
    assert error(force, sim.force[:, :2]) < 1e-9
    assert error(displacement, sim.displacement) < 1e-9


def test_a_missed_target_is_reported():
    figures = [below("a", 1.0, 2.0), below("b", 3.0, 2.0), near("c", 1.0, 1.2, 0.1), Figure("d", "1", "", None)]
    assert [figure.met for figure in figures] == [True, False, False, None]
    console = Console(record=True, width=100)
    show(console, "subject", figures)
    assert console.export_text().count("MISSED") == 2


def test_not_a_number_is_a_miss():
    assert below("a", float("nan"), 2.0).met is False
    assert near("a", float("nan"), 2.0, 1.0).met is False


def test_the_trace_counter_counts():
    assert programs._traces().met


@pytest.mark.parametrize("subject", SUBJECTS)
def test_every_subject_can_be_loaded(subject):
    assert callable(importlib.import_module(f"benchmarks.validation.{subject}").figures)
