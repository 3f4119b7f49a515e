"""Sweeps: every member is the simulation that it stands for, labelled, and never a number where it failed."""

import os
import subprocess
import sys
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases import RPM, slot

import millax as mx
from millax import _plan, _program
from millax._gain import TOLERANCE
from millax._members import members_of
from millax._names import replace
from millax._plan import Group, plan

CASE = slot(duration=0.03, mass=5.0, stiffness=2e7)  # 20 tooth periods at 10 000 rpm, 318 Hz
SPEEDS = np.array([7000, 12345]) * RPM
DEPTHS = np.array([0.5e-3, 2e-3])


@pytest.fixture(scope="module")
def grid():
    return mx.sweep(CASE, grid={"cut.spindle_speed": SPEEDS, "cut.depth": "0.5, 2 mm"}, reduce=traces())


def traces():
    return {**mx.REDUCTIONS, "force": lambda sim: sim.force, "chips": lambda sim: {"most": jnp.nanmax(sim.chip_thickness)}}


def member_case(**numbers) -> mx.Case:
    """The case of one member as anybody would make it."""
    case = replace(CASE, {name.replace("_", ".", 1): jnp.asarray(value) for name, value in numbers.items()})
    duration = CASE.settings.periods * float(CASE.cut.tooth_period(CASE.tool))
    settings = mx.Settings.suited(case.tool, case.force, case.structure, case.cut, duration)
    return eqx.tree_at(lambda c: c.settings, case, settings)


def alone(**numbers) -> tuple[mx.Simulation, mx.Case]:
    case = member_case(**numbers)
    return mx.simulate(case), case


def test_every_member_of_a_grid_is_the_simulation_of_its_case(grid):
    for i, speed in enumerate(SPEEDS):
        for j, depth in enumerate(DEPTHS):
            sim, case = alone(cut_spindle_speed=speed, cut_depth=depth)
            one = grid.isel({"cut.spindle_speed": i, "cut.depth": j})
            steps = sim.time.size
            # A program shared with others may have more sweeps: the results agree to what the sweeps may leave.
            tight = {"rtol": 0, "atol": 3 * TOLERANCE * float(jnp.abs(sim.force).max())}
            np.testing.assert_allclose(one["force"][:steps], sim.force, **tight)
            assert np.isnan(one["force"][steps:]).all()
            assert float(one["simulated_time"]) == pytest.approx(
                case.settings.periods * float(case.cut.tooth_period(case.tool))
            )
            assert float(one["chips.most"]) == pytest.approx(float(sim.chip_thickness.max()), rel=1e-6)


def test_the_reductions_that_come_with_it_against_numpy_and_the_summary(grid):
    sim, case = alone(cut_spindle_speed=SPEEDS[1], cut_depth=DEPTHS[1])
    one = grid.isel({"cut.spindle_speed": 1, "cut.depth": 1})
    summary = mx.summarize(sim, case)
    revolution = case.settings.steps_per_tooth * case.tool.teeth
    assert case.settings.periods == 25  # so the last half holds 3 revolutions, and a half
    tail = np.asarray(sim.displacement)[-3 * revolution :]
    for i, axis in enumerate("xy"):
        at = one.sel(axis=axis)
        assert float(at["mean_force"]) == pytest.approx(summary[f"mean_force.{axis}"]["value"], rel=1e-6)
        assert float(at["peak_force"]) == pytest.approx(summary[f"peak_force.{axis}"]["value"], rel=1e-6)
        assert float(at["mean_displacement"]) == pytest.approx(tail[:, i].mean(), rel=1e-6)
        assert float(at["std_displacement"]) == pytest.approx(tail[:, i].std(), rel=1e-6)
        assert float(at["peak_displacement"]) == pytest.approx(np.abs(sim.displacement[:, i]).max(), rel=1e-6)
    assert float(one["mean_displacement"].sel(axis="z")) == 0.0


def test_labels(grid):
    assert grid["mean_force"].dims == ("cut.spindle_speed", "cut.depth", "axis")
    assert grid["status"].dims == ("cut.spindle_speed", "cut.depth")
    assert list(grid["axis"].to_numpy()) == ["x", "y", "z"]
    # Coordinates are in the unit that was given, results in SI.
    assert grid["cut.depth"].attrs["units"] == "mm"
    np.testing.assert_array_equal(grid["cut.depth"], [0.5, 2.0])
    assert grid["cut.spindle_speed"].attrs["units"] == "rad/s"
    assert grid["mean_force"].attrs == {"units": "N", "long_name": mx.REDUCTIONS["mean_force"].definition}
    assert (grid["status"] == 0).all()
    assert grid["residual"].max() <= TOLERANCE


def test_samples_have_one_dimension_and_values_may_be_shared():
    kr = mx.sample({"force.kr": "0.3 ± 0.02"}, 5, seed=1)
    samples = {**kr, "cut.feed_per_tooth": "0.08 mm", "cut.spindle_speed": np.full(5, 12000 * RPM)}
    result = mx.sweep(CASE, samples=samples, reduce=["mean_force"])
    assert result["mean_force"].dims == ("sample", "axis")
    assert result["force.kr"].dims == ("sample",)
    assert float(result["cut.feed_per_tooth"]) == 0.08
    # At 12 000 rpm and 0.08 mm per tooth the feed is 0.08e-3 * 4 * 200 m/s.
    sim, case = alone(force_kr=kr["force.kr"].numbers[3], cut_spindle_speed=12000 * RPM, cut_feed_rate=0.064)
    expected = mx.summarize(sim, case)["mean_force.y"]["value"]
    assert float(result["mean_force"].sel(sample=3, axis="y")) == pytest.approx(expected, rel=1e-6)


def test_a_function_may_take_the_case_and_return_any_arrays():
    def relative(sim, case):
        return {"force": sim.force.mean(axis=0) / case.cut.depth, "parts": (sim.time[-1], jnp.asarray([1, 2]))}

    given = mx.Reduction(lambda sim: sim.force[-1, :2], unit="N", definition="the end", dims=("direction",))
    result = mx.sweep(CASE, grid={"cut.depth": DEPTHS}, reduce={"per_depth": relative, "end": given})
    assert set(result.data_vars) == {
        *("per_depth.force", "per_depth.parts.0", "per_depth.parts.1", "end", "status", "residual", "simulated_time")
    }
    sim, _ = alone(cut_depth=DEPTHS[1])
    last = result.isel({"cut.depth": 1})
    np.testing.assert_allclose(last["per_depth.force"], sim.force.mean(axis=0) / 2e-3, rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose(last["end"], sim.force[-1, :2], rtol=1e-6)
    assert last["end"].dims == ("direction",)
    np.testing.assert_array_equal(last["per_depth.parts.1"], [1.0, 2.0])


def test_a_member_that_failed_is_nan_and_does_not_touch_its_neighbours():
    soft = slot(duration=0.06, mass=0.5, stiffness=1e5)
    stiffness = np.array([100.0, 1e7])  # the first tool is pushed aside by more than its radius
    result = mx.sweep(soft, grid={"structure.stiffness": stiffness})
    np.testing.assert_array_equal(result["status"], [2, 0])
    assert all(np.isnan(result[name][0]).all() for name in mx.REDUCTIONS)
    assert all(np.isfinite(result[name][1]).all() for name in mx.REDUCTIONS)
    assert np.isfinite(result["residual"]).all()


def test_the_residual_is_always_looked_at(monkeypatch):
    """Too few sweeps: simulated again with more, and status 1 where that does not help."""
    case = slot(duration=0.012, mass=1.0)
    expected = mx.sweep(case, grid={"cut.depth": DEPTHS}, reduce=["mean_force"])
    monkeypatch.setattr(_plan, "sweeps_needed", lambda kernel, blocks, tolerance: np.zeros((len(kernel), len(blocks)), int))
    again = mx.sweep(case, grid={"cut.depth": DEPTHS}, reduce=["mean_force"])
    assert (again["residual"] <= TOLERANCE).all()
    np.testing.assert_allclose(again["mean_force"], expected["mean_force"], rtol=1e-5, atol=1e-5)
    monkeypatch.setattr(_program, "RERUNS", 0)
    once = mx.sweep(case, grid={"cut.depth": DEPTHS}, reduce=["mean_force"])
    assert (once["status"] == 1).all()
    assert np.isnan(once["mean_force"]).all()


def test_a_plan_has_few_programs_and_each_is_enough_for_its_members():
    members = members_of(CASE, {"cut.spindle_speed": "4000:16000:49 rpm", "cut.depth": "0.2:4:20 mm"}, None)
    found = plan(CASE, members)
    which = np.sort(np.concatenate(list(found.groups.values())))
    np.testing.assert_array_equal(which, np.arange(len(members)))
    assert len(found.groups) <= 8
    for group, part in found.groups.items():
        assert (found.periods[part] <= group.periods).all()
    # A member's own periods are those of its case alone.
    for i in (0, 500, 979):
        speed, depth = members.table[i]
        assert found.periods[i] == member_case(cut_spindle_speed=speed, cut_depth=depth).settings.periods


def test_the_sweeps_of_a_plan_are_enough():
    for depth, mass in ((1e-4, 100.0), (4e-3, 1.0)):
        case = slot(duration=0.012, mass=mass)
        members = members_of(case, {"cut.depth": np.array([depth])}, None)
        (group,) = plan(case, members).groups
        one = eqx.tree_at(lambda c: c.cut.depth, case, depth)
        assert mx.simulate(group.settle(one)).residual <= TOLERANCE


def test_a_mode_that_the_steps_do_not_resolve_names_the_member():
    with pytest.raises(
        ValueError, match=r"member with cut.spindle_speed = 400 rpm: .*steps_per_tooth: 40 given; .* at least"
    ):
        mx.sweep(CASE, grid={"cut.spindle_speed": "400, 4000 rpm"})


def test_settings_of_a_group():
    settled = Group(7, 2, 9).settle(CASE).settings
    assert (settled.periods, settled.blocks, settled.sweeps, settled.steps_per_tooth) == (7, 2, 9, 40)


ON_TWO_DEVICES = """
import sys
import jax
jax.config.update("jax_enable_x64", True)
import millax as mx
mx.use_all_cores(2)
from cases import slot
case = slot(duration=0.012)
result = mx.sweep(case, grid={"cut.depth": "0.2:4:40 mm"}, reduce=["mean_force", "std_displacement"])
assert jax.device_count() == 2
result.to_netcdf(sys.argv[1], engine="h5netcdf")
"""


def test_two_devices_compute_what_one_does(tmp_path):
    import xarray

    environment = os.environ | {"PYTHONPATH": str(Path(__file__).parent)}
    run = [sys.executable, "-c", ON_TWO_DEVICES, str(tmp_path / "two.nc")]
    subprocess.run(run, check=True, env=environment, cwd=Path(__file__).parents[1])
    assert jax.device_count() == 1
    one = mx.sweep(slot(duration=0.012), grid={"cut.depth": "0.2:4:40 mm"}, reduce=["mean_force", "std_displacement"])
    two = xarray.load_dataset(tmp_path / "two.nc", engine="h5netcdf")
    for name in ("mean_force", "std_displacement", "residual"):
        np.testing.assert_allclose(two[name], one[name], rtol=1e-12, atol=1e-15)


def test_devices_cannot_be_changed_once_something_is_computed():
    jnp.zeros(1).block_until_ready()
    with pytest.raises(RuntimeError, match="before"):
        mx.use_all_cores(jax.device_count() + 1)


def test_single_precision_is_said():
    with jax.enable_x64(False):
        case = slot(duration=0.006, axes=())
        with pytest.warns(UserWarning, match="float32"):
            result = mx.sweep(case, grid={"cut.depth": DEPTHS}, reduce=["peak_force"])
    assert (result["status"] == 0).all()
    exact = mx.sweep(slot(duration=0.006, axes=()), grid={"cut.depth": DEPTHS}, reduce=["peak_force"])
    np.testing.assert_allclose(result["peak_force"], exact["peak_force"], rtol=1e-3)
