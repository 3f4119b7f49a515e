"""The programs of `make validate` and `make bench`: their yardsticks compute the same cut, their tables can say no."""

import importlib

import numpy as np
import pytest
from rich.console import Console

import millax as mx
from benchmarks.figures import Figure, below, near, show
from benchmarks.slot import slot
from benchmarks.validate import SUBJECTS
from benchmarks.validation import programs
from benchmarks.yardsticks import c_loop, step_by_step


def test_the_yardsticks_compute_the_same_cut():
    # Both sample the force of a step, hard-gated, which costs accuracy at the border: 3 % of the displacement.
    case = slot(duration=0.1)
    sim = mx.simulate(case)
    runs = {"scan": step_by_step(case)()}
    loop = c_loop(case)
    if loop is not None:  # without gcc there is no such row in the benchmark either
        runs["C"] = loop()
    for force, displacement in runs.values():
        largest = np.abs(sim.displacement).max()
        assert np.abs(np.asarray(displacement) - np.asarray(sim.displacement)).max() < 0.05 * largest
        assert np.abs(np.asarray(force).mean(0) - np.asarray(sim.force).mean(0)[:2]).max() < 0.02 * np.abs(sim.force).max()


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
