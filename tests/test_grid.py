"""The papers' grid algorithm against the engine, and against what must come out of it by itself."""

import dataclasses

import numpy as np
import pytest

import millax as mx
from benchmarks import grid
from benchmarks.slot import slot

PERIODS = 12


def inside(**numbers) -> mx.Case:
    """The slot long after the entry: the tool is all in material that it meets at full width."""
    case = slot(duration=0.01, border=False, **numbers)
    return dataclasses.replace(case, settings=dataclasses.replace(case.settings, periods=PERIODS))


@pytest.mark.parametrize("spacing", [20e-6, 10e-6])
def test_chips_of_an_entry_into_a_border(spacing):
    case = slot(duration=0.02, axes=())
    traces, sim = grid.simulate(case, spacing), mx.simulate(case)
    h, diameter = np.asarray(sim.chip_thickness), float(case.tool.diameter)
    expected = h - h**2 / diameter
    error = np.sqrt(((traces.thickness - expected) ** 2).mean() / (expected**2).mean())
    assert error < 0.05 * spacing / 20e-6  # noise of the nodes: first order in their distance
    assert traces.thickness.sum() == pytest.approx(expected.sum(), rel=0.01 * spacing / 10e-6)


def test_force_and_displacement_of_a_tool_that_gives_way():
    case = slot(duration=0.02)
    traces, sim = grid.simulate(case, 10e-6), mx.simulate(case)
    force = np.asarray(sim.force)[:, :2]
    # One thickness per step instead of its mean force: 4 % while the teeth meet the border.
    assert np.sqrt(((traces.force - force) ** 2).mean() / (force**2).mean()) < 0.06
    largest = np.abs(np.asarray(sim.displacement)).max()
    assert np.abs(traces.displacement - np.asarray(sim.displacement)).max() < 0.02 * largest


def test_a_slot_removes_feed_times_diameter():
    case = inside(axes=())
    n, tool = case.settings.steps_per_tooth, case.tool
    traces = grid.simulate(case, 10e-6)
    turned = 2 * np.pi / (tool.teeth * n)
    areas = traces.thickness.reshape(PERIODS, -1).sum(axis=1) * float(tool.radius) * turned
    expected = float(case.cut.feed_per_tooth(tool)) * 2 * float(tool.radius)
    np.testing.assert_allclose(areas[1:], expected, rtol=0.01)  # the first meets a circle, not the path of a tooth


def test_the_window_forgets_nothing_that_the_tool_can_reach():
    # The same cut on a window that covers it all, and on one that moves along.
    case = slot(duration=0.02, axes=())
    small, large = (grid.simulate(case, 20e-6, stray=stray) for stray in (1e-3, 4e-3))
    np.testing.assert_array_equal(small.thickness, large.thickness)
