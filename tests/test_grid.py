"""The papers' grid algorithm against the engine, and against what must come out of it by itself."""

import dataclasses

import numpy as np
import pytest

import millax as mx
from benchmarks import exact, grid
from benchmarks.exact import Cutter
from benchmarks.slot import SPEED, slot

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


def test_slices_without_helix_are_one_cutter():
    case = slot(duration=0.006, depth=2e-3)
    two = Cutter.end_mill(0.01, 4, SPEED, 2e-3, slices=2)
    for whole, parts in zip(grid.simulate(case, 20e-6)[:3], grid.simulate(case, 20e-6, cutter=two)[:3], strict=True):
        np.testing.assert_allclose(parts, whole, rtol=1e-9, atol=1e-15)


def test_any_cutter_on_a_tool_that_gives_way_against_exact_paths():
    case = slot(duration=0.015, border=False, mass=1.0, stiffness=3e6)
    pitch = np.radians([80.0, 100.0, 85.0, 95.0])
    cutter = Cutter.end_mill(0.01, 4, SPEED, 1e-3, slices=2, helix=0.5, pitch=pitch, runout=[1e-5, 0.0, -1e-5, 0.0])
    law = exact.linear(8e8, 0.3, kte=2e4, kre=1e4)
    found = grid.simulate(case, 10e-6, cutter=cutter, forces=law)
    dt = float(case.cut.tooth_period(case.tool)) / case.settings.steps_per_tooth
    time = (np.arange(len(found.force)) + 0.5) * dt
    moved = exact.motion(case.cut.start, case.cut.feed_rate, time, found.displacement)
    force = exact.cut_along(cutter, moved, case.stock, law, time, dt, passes=12).force[:, :2]
    begun = slice(160, None)  # the first teeth meet a circle instead of the path of a tooth
    assert np.abs(found.displacement).max() > 3e-5
    assert np.sqrt(((found.force - force)[begun] ** 2).mean() / (force[begun] ** 2).mean()) < 0.04
    np.testing.assert_allclose(found.force[begun].mean(axis=0), force[begun].mean(axis=0), rtol=0.01)


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
