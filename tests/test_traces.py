"""Traces: what is read from a file, what is refused, and how a model is compared at their sample times."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases import slot

import millax as mx
from identification import Trace, TraceError, read_trace
from identification._compare import compare

CASE = slot(duration=0.015, axes=("x", "y"))
PERIOD = 0.0015
STEP = PERIOD / 40
HEADER = "time [s],Fx [N],x [um]"


def table(n=20, step=1e-4):
    return [[i * step, np.sin(i), 1 + i] for i in range(n)]


def text(rows, header=HEADER):
    return "\n".join([header, *(",".join(map(str, row)) for row in rows)]) + "\n"


@pytest.fixture
def read(tmp_path):
    def read(content, **keywords):
        path = tmp_path / "trace.csv"
        path.write_bytes(content) if isinstance(content, bytes) else path.write_text(content, encoding="utf-8")
        return read_trace(path, **keywords)

    return read


def test_a_file_is_read_in_the_units_of_its_header(read):
    trace = read(text(table(), "time [ms],x [um],Fx [kN]"), noise={"Fx": "2 N"})
    np.testing.assert_allclose(trace.time, np.arange(20) * 1e-7, atol=1e-20)
    assert trace.channels == ("x", "Fx")
    np.testing.assert_allclose(trace.values[3], [np.sin(3) * 1e-6, 4e3])
    assert trace.noise == {"Fx": 2.0}
    assert trace.shown("x", 3e-6) == pytest.approx(3)


def test_channels_leave_other_columns_out(read):
    trace = read(text(table(), "time [s],torque [N m],x [um]"), channels=["x"])
    assert trace.channels == ("x",)
    assert trace.values[0, 0] == pytest.approx(1e-6)


def test_blank_lines_and_a_byte_order_mark_do_no_harm(read):
    assert len(read("\ufeff" + text(table()) + "\n\n").time) == 20


def test_a_window_takes_a_part_and_passes_over_what_is_broken_outside(read):
    rows = table()
    rows[18][1] = "nan"
    trace = read(text(rows), window=["0.5 ms", "1 ms"])
    np.testing.assert_allclose(trace.time, np.arange(5, 11) * 1e-4)


def test_rounded_time_stamps_become_the_even_grid_through_them():
    grid = np.arange(200) * STEP
    trace = Trace(np.round(grid, 6), ("Fx",), np.ones((200, 1)))
    np.testing.assert_allclose(trace.time, grid, atol=0.01 * STEP)


def broken(row, column, value):
    rows = table()
    rows[row][column] = value
    return text(rows)


@pytest.mark.parametrize(
    ("content", "keywords", "words"),
    [
        (broken(4, 1, "nan"), {}, ["row 6, column Fx", "not a finite number"]),
        (broken(4, 2, "abc"), {}, ["row 6, column x"]),
        (broken(4, 2, ""), {}, ["row 6, column x"]),
        (broken(4, 0, 0.1), {}, ["row 7, column time", "sort the samples"]),
        (broken(4, 0, 3e-4), {}, ["row 6, column time", "repeated"]),
        (text([*table(9), *[[1 + r[0], *r[1:]] for r in table(9)]]), {}, ["row 11, column time", "resample"]),
        (text(table()) + "0.5,1\n", {}, ["row 22 has 2 cells, the header has 3"]),
        ("", {}, ["the file is empty"]),
        (text([]), {}, ["0 samples"]),
        (text(table(1)), {}, ["1 samples"]),
        (text(table(), "time [s],Fx,x [um]"), {}, ['column 2 "Fx" has no unit; write Fx [N]']),
        (text(table(), "time [s],Fx [m],x [um]"), {}, ["column 2", "the unit m is not one of Fx; use [N]"]),
        (text(table(), "time [s],Fx [blob],x [um]"), {}, ["column 2", "the unit blob"]),
        (text(table(), "time [s],Fx [N],Fx [N]"), {}, ["column 3", "twice, first as column 2"]),
        (text(table(), "time [s],Fx [N],F_x [N]"), {}, ["F_x [N]", "Did you mean Fx?", "channels = [...]"]),
        (text(table(), "t [s],Fx [N],x [m]"), {}, ["not a channel"]),
        (text(table(), "x [m],Fx [N],y [m]"), {}, ["no column time"]),
        (text(table()), {"channels": ["Fy"]}, ["no column Fy", HEADER.replace(",", ", ")]),
        (text(table()), {"channels": ["Fq"]}, ["'Fq' is unknown"]),
        (text([[r[0]] for r in table()], "time [s]"), {}, ["no channel beside time"]),
        (text([[r[0], 0, 1] for r in table()]), {}, ["channel Fx is zero throughout"]),
        (b"\x80\x81binary\x00", {}, ["UTF-8"]),
        (text(table()), {"noise": {"Fx": "1 mm"}}, ["noise of Fx", "cannot be converted to N"]),
        (text(table()), {"noise": {"Fx": 0}}, ["must be greater than 0"]),
        (text(table()), {"noise": {"Fy": 1}}, ["the channels are Fx, x"]),
        (text(table()), {"noise": {"Fq": 1}}, ["'Fq' is unknown"]),
        (text(table()), {"window": ["1 s", "2 s"]}, ["no sample lies in the window", "0 s to 0.0019 s"]),
        (text(table()), {"window": ["2 s", "1 s"]}, ["the first the smaller"]),
    ],
)
def test_a_file_that_cannot_be_used_is_refused_with_the_place_named(read, content, keywords, words):
    with pytest.raises(ValueError, match=r"trace\.csv") as error:
        read(content, **keywords)
    for word in words:
        assert word in str(error.value)


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(TraceError, match=r"none.csv: the trace cannot be read: No such file"):
        read_trace(tmp_path / "none.csv")


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"values": np.ones((200, 2))}, "must be (samples,) and (samples, 1)"),
        ({"channels": ("Fq",)}, "'Fq' is unknown"),
        ({"channels": ("Fx", "Fx"), "values": np.ones((200, 2))}, "Fx given twice"),
        ({"values": np.full((200, 1), np.inf)}, "sample 0, column Fx: not a finite number"),
    ],
)
def test_a_trace_of_arrays_is_checked_too(values, words):
    good = {"time": np.arange(200) * STEP, "channels": ("Fx",), "values": np.ones((200, 1))}
    with pytest.raises(TraceError) as error:
        Trace(**good | values)
    assert words in str(error.value)


def simulation(tooth_period=PERIOD, case=CASE):
    """A simulation whose force and displacement are known functions of time."""
    steps = case.settings.steps
    time = (jnp.arange(steps) + 0.5) * tooth_period / 40
    force = jnp.stack([1 + 2 * time, jnp.sin(300 * time), 0 * time], axis=1)
    displacement = jnp.stack([jnp.cos(500 * time), time**2], axis=1)
    chip = jnp.zeros((steps, 4))
    return mx.Simulation(time, force, displacement, chip, jnp.zeros(()), jnp.zeros((), int), axes=("x", "y"))


def trace_at(time, channels=("Fx", "Fy", "x", "y")):
    return Trace(time, channels, np.ones((len(time), len(channels))))


def test_the_model_s_own_samples_are_reproduced_exactly():
    sim = simulation()
    time = np.round(np.asarray(sim.time), 6)
    comparison = compare(trace_at(time), CASE)
    expected = np.concatenate([np.asarray(sim.force)[:, :2], np.asarray(sim.displacement)], axis=1).T
    np.testing.assert_array_equal(comparison.predict(sim, CASE), expected)
    every_third = compare(trace_at(time[6::3]), CASE)
    np.testing.assert_array_equal(every_third.predict(sim, CASE), expected[:, 6::3])


def test_between_samples_a_straight_line_is_exact_and_a_curve_second_order():
    sim = simulation()
    # From the start to the end of the simulation: half a step outside the samples at both ends.
    time = np.linspace(0, 10 * PERIOD, 333)
    force_x, force_y, x, _ = np.asarray(compare(trace_at(time), CASE).predict(sim, CASE))
    np.testing.assert_allclose(force_x, 1 + 2 * time, rtol=1e-12)
    np.testing.assert_allclose(force_y[2:-2], np.sin(300 * time[2:-2]), atol=(300 * STEP) ** 2 / 8)
    np.testing.assert_allclose(x[2:-2], np.cos(500 * time[2:-2]), atol=(500 * STEP) ** 2 / 8)


def test_a_free_spindle_speed_shifts_the_samples_differentiably():
    time = np.arange(300) * STEP * 1.0923 + 0.7 * STEP
    comparison = compare(trace_at(time), CASE, ["cut.spindle_speed"])
    assert comparison.taken is None
    predict = lambda period: comparison.predict(simulation(period), CASE)  # noqa: E731
    slope = jax.jvp(predict, (PERIOD,), (1.0,))[1]
    h = 1e-9
    difference = (predict(PERIOD + h) - predict(PERIOD - h)) / (2 * h)
    np.testing.assert_allclose(slope, difference, rtol=1e-5, atol=1e-5)
    aligned = np.asarray(simulation().time)
    assert compare(trace_at(aligned), CASE, ["cut.spindle_speed"]).taken is None
    assert compare(trace_at(aligned), CASE).taken is not None


def test_a_simulation_that_a_higher_speed_makes_too_short_is_told():
    comparison = compare(trace_at(np.asarray(simulation().time)), CASE, ["cut.spindle_speed"])
    assert bool(comparison.covered(simulation(), CASE))
    assert not bool(comparison.covered(simulation(0.99 * PERIOD), CASE))


@pytest.mark.parametrize(
    ("case", "trace", "words"),
    [
        (slot(axes=("x",), duration=0.015), trace_at(np.arange(200) * STEP, ("y",)), "moves only along x"),
        (slot(axes=(), duration=0.015), trace_at(np.arange(200) * STEP, ("x",)), "not at all: it is rigid"),
        (CASE, trace_at(np.arange(200) * STEP, ("Fz",)), "no axial force"),
        (CASE, trace_at(np.arange(20) * PERIOD / 3), "3 times per tooth period"),
        (CASE, trace_at(np.arange(100) * STEP), "at least 3"),
        (CASE, trace_at(np.arange(200) * STEP - STEP), "before the simulation does"),
        (CASE, trace_at(np.arange(402) * STEP), "after the simulation does at 0.015 s"),
    ],
)
def test_a_trace_that_does_not_fit_the_case_is_refused(case, trace, words):
    with pytest.raises(TraceError) as error:
        compare(trace, case)
    assert words in str(error.value)


def test_a_trace_is_not_changed_by_who_uses_it():
    trace = trace_at(np.arange(200) * STEP)
    with pytest.raises(dataclasses.FrozenInstanceError):
        trace.name = "other"  # pyright: ignore[reportAttributeAccessIssue]
