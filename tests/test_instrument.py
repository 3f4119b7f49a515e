"""Traces of an instrument: through a sensor, by a clock of its own; what a file says of both, and what a fit finds."""

import dataclasses
import json

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases import SLOT_FILE, slot

import millax as mx
from identification import Parameter, Trace, TraceError, align, fit, load_fit, synthetic_trace
from identification._compare import compare
from identification.cli import main
from millax._names import quantity_of, replace, valid_names, value_of

RATE = 10e3
SENSOR = mx.Sensor(
    gain=(1.0, -1.0, 1.0),
    bias=(12.0, -7.0, 0.0),
    delay=30e-6,
    resonances=mx.Resonances.per_axis((1500.0, 1900.0), (0.05, 0.04), ("x", "y")),
    low_pass=mx.LowPass(3500.0, 2),
)
CLOCK = mx.Clock(0.0217, 8e-5)
TOOL = mx.EndMill(0.02, 4, runout=(8e-6, 0.0, -5e-6, 3e-6))
RIGID = slot(structure=mx.Structure.rigid(), duration=0.25, start=(0.02, 0.0), steps_per_tooth=64, passes=4)
CASE = dataclasses.replace(RIGID, tool=TOOL, sensor=SENSOR, clock=CLOCK)


def recorded(case: mx.Case, length=0.2, seed=0, sigma=1.0) -> Trace:
    """What the instrument of a case would record at its own rate: time stamps from 3 s on."""
    time = 3.0 + np.arange(round(length * RATE)) / RATE
    return synthetic_trace(case, time, ("Fx", "Fy"), {"Fx": sigma, "Fy": sigma}, seed)


@pytest.fixture(scope="module")
def trace():
    return recorded(CASE)


def test_the_trace_is_what_a_finer_simulation_shows(trace):
    """The finer one has its own grid, and is read through the same sensor."""
    fine = CASE.with_settings(steps_per_tooth=320)
    found = compare(trace, CASE).predict(mx.simulate(CASE), CASE)
    expected = compare(trace, fine).predict(mx.simulate(fine), fine)
    np.testing.assert_allclose(found, expected, atol=0.01 * float(jnp.abs(expected).max()))


def test_a_synthetic_trace_is_the_model_and_noise_that_can_be_made_again():
    time = 3.0 + np.arange(500) / RATE
    clean = synthetic_trace(CASE, time, ("Fy", "Fx"))
    noisy, again = (synthetic_trace(CASE, time, ("Fy", "Fx"), {"Fx": 3.0}, 7) for _ in range(2))
    np.testing.assert_array_equal(noisy.values, again.values)
    np.testing.assert_array_equal(noisy.values[:, 0], clean.values[:, 0])
    assert np.std(noisy.values[:, 1] - clean.values[:, 1]) == pytest.approx(3.0, rel=0.1)
    assert (noisy.noise, clean.noise) == ({"Fx": 3.0}, {})
    with pytest.raises(ValueError, match="noise needs one"):
        synthetic_trace(CASE, time, ("Fx",), {"Fx": 1.0})


def test_the_clock_and_the_delay_shift_the_model(trace):
    time = trace.time - trace.time[0]
    np.testing.assert_allclose(CLOCK(trace.time), 0.0217 + (1 + 8e-5) * time, rtol=1e-14)
    sim = mx.simulate(CASE)
    later = dataclasses.replace(CASE, clock=mx.Clock(0.0217 - 30e-6, 8e-5), sensor=dataclasses.replace(SENSOR, delay=0.0))
    one, other = (compare(trace, case).predict(sim, case) for case in (CASE, later))
    np.testing.assert_allclose(one, other, atol=1e-9 * float(jnp.abs(other).max()))


def test_forces_and_displacements_keep_their_order_and_only_forces_are_late():
    case = dataclasses.replace(slot(duration=0.05), sensor=mx.Sensor(delay=1e-4), clock=mx.Clock(0.01))
    time = np.arange(300) / RATE
    mixed = synthetic_trace(case, time, ("Fy", "x", "Fx", "y"))
    for channel, column in zip(mixed.channels, mixed.values.T, strict=True):
        start = 0.01 - (1e-4 if channel.startswith("F") else 0.0)
        alone = dataclasses.replace(case, sensor=None, clock=mx.Clock(start))
        expected = synthetic_trace(alone, time, (channel,)).values[:, 0]
        np.testing.assert_allclose(column, expected, rtol=0, atol=1e-9 * np.abs(expected).max())


def guess(case: mx.Case) -> mx.Case:
    """Without what a fit would have to find: clock and runout unknown, coefficients and resonances wrong."""
    wrong = {"force.k0": 3.5e9, "force.hs": 30e-6, "sensor.bias.x": 0.0, "sensor.bias.y": 0.0}
    wrong |= {"sensor.resonances.frequency.mode_1": 1400.0, "sensor.resonances.damping_ratio.mode_1": 0.1}
    return dataclasses.replace(
        replace(case, {name: jnp.asarray(value) for name, value in wrong.items()}), clock=mx.Clock(0.02)
    )


def test_phase_and_speed_are_guessed_from_the_trace(trace):
    case = guess(CASE)
    found = align(case, trace)
    turn = 4 * float(CASE.cut.tooth_period(TOOL))
    assert 0.02 <= float(found.start) < 0.02 + turn
    assert abs(float(found.start) - 0.0217) < 0.01 * turn
    assert abs(float(found.speed_error) - 8e-5) < 2e-5
    slow = dataclasses.replace(CASE, clock=mx.Clock(0.0217, -0.004))
    assert abs(float(align(case, recorded(slow)).speed_error) + 0.004) < 1e-4


def test_a_fit_finds_coefficients_runout_sensor_and_clock(trace):
    case = guess(CASE)
    case = dataclasses.replace(case, clock=align(case, trace))
    sensor = ["bias.x", "bias.y", "resonances.frequency.mode_1", "resonances.damping_ratio.mode_1"]
    names = ["force.k0", "force.hs", "tool.runout.1", "tool.runout.2", "clock.start", "clock.speed_error"]
    names += [f"sensor.{name}" for name in sensor]
    result = fit(case, trace, [Parameter(name) for name in names])
    assert result.success, result.message
    errors = [(e.value - value_of(CASE, e.name)) / e.std for e in result.parameters]
    # Runout counts from a tooth that is not free: only differences from it are known.
    assert np.abs(errors).max() < 4
    assert np.std(errors) > 0.3


FILE = f"""\
{SLOT_FILE}start = ["20 mm", 0]
[sensor]
gain = [1, -1, 1]
bias = ["12 N", "-7 N", 0]
delay = "30 us"
[sensor.resonances]
frequency = ["1500 Hz", "1.9 kHz"]
damping_ratio = ["5 %", 0.04]
axes = ["x", "y"]
[sensor.low_pass]
cutoff = "3500 Hz"
[clock]
start = "21.7 ms"
speed_error = 8e-5
[simulation]
duration = "20 ms"
"""


def test_a_case_file_says_what_measured(tmp_path):
    (tmp_path / "case.toml").write_text(FILE, encoding="utf-8")
    file = mx.CaseFile.read(tmp_path / "case.toml")
    for found, expected in ((file.case.sensor, SENSOR), (file.case.clock, CLOCK)):
        assert jax.tree.structure(found) == jax.tree.structure(expected)
        for a, b in zip(*map(jax.tree.leaves, (found, expected)), strict=True):
            np.testing.assert_allclose(a, b, rtol=1e-12)
    names = valid_names(file.case)
    assert {"sensor.gain.y", "sensor.delay", "sensor.low_pass.cutoff", "clock.start"} <= set(names)
    assert "sensor.resonances.damping_ratio.mode_2" in names
    assert quantity_of(file.case, "sensor.resonances.frequency.mode_1").unit == "Hz"
    text = file.with_values({"sensor.bias.y": -3.0, "sensor.resonances.frequency.mode_2": 2000.0, "clock.start": 0.02})
    assert '"-3 N"' in text
    assert '"2 kHz"' in text
    assert 'start = "20 ms"' in text
    residue = "[[[1, 0, 0], [0, 0, 0], [0, 0, 0]], [[0, 0, 0], [0, 1, 0], [0, 0, 0.5]]]"
    other = mx.CaseFile.from_text(FILE.replace('axes = ["x", "y"]', f"residue = {residue}"))
    assert value_of(other.case, "sensor.resonances.residue.mode_2.z.z") == 0.5
    assert "[0, 0, 0.25]" in other.with_values({"sensor.resonances.residue.mode_2.z.z": 0.25})


UNEQUAL = FILE.replace("teeth = 4  # carbide", 'teeth = 4\nrunout = ["0 um", "-8 um", "2 um", "4 um"]')
QUESTION = """
[fit.free]
force.k0 = { guess = "4 kN/mm^2", prior = { mean = "5 kN/mm^2", factor = 2 } }
force.hs = "25 um"
tool.runout.1 = "-6 um"
tool.runout.3 = { tie = "tool.runout.1", factor = -0.5 }
sensor.bias.x = { guess = "0 N", each = true }
clock.start = { each = true }
clock.speed_error = { each = true }
[[trace]]
file = "slow.csv"
align = true
noise = { Fx = "1 N", Fy = "1 N" }
[[trace]]
file = "fast.csv"
align = true
noise = { Fx = "1 N", Fy = "1 N" }
case = { cut.feed_rate = "6 m/min", sensor = { bias = [0, "-9 N", 0] } }
"""


def test_traces_with_clocks_and_offsets_of_their_own_are_fitted_and_written_back(tmp_path):
    text = UNEQUAL.replace('duration = "20 ms"', 'duration = "0.12 s"').replace('start = "21.7 ms"', 'start = "20 ms"')
    true, biases = [], (12.0, 5.0)
    for name, feed, start, error, bias in (("slow", 4, 0.0217, 8e-5, (12, -7, 0)), ("fast", 6, 0.0241, -5e-5, (5, -9, 0))):
        case = mx.CaseFile.from_text(text.replace('"4 m/min"', f'"{feed} m/min"')).case
        case = dataclasses.replace(
            case, clock=mx.Clock(start, error), sensor=dataclasses.replace(case.sensor, bias=np.array(bias, dtype=float))
        )
        trace = recorded(case, 0.09, seed=feed)
        rows = [f"{t:.6f},{x:.9g},{y:.9g}" for t, (x, y) in zip(trace.time, trace.values, strict=True)]
        (tmp_path / f"{name}.csv").write_text("\n".join(["time [s],Fx [N],Fy [N]", *rows]) + "\n", encoding="utf-8")
        true.append((start, error))
    (tmp_path / "case.toml").write_text(text + QUESTION, encoding="utf-8")
    out = tmp_path / "out"
    assert main(["fit", str(tmp_path / "case.toml"), "--out", str(out)]) == 0
    found = {e["name"]: e for e in json.loads((out / "result.json").read_text(encoding="utf-8"))["parameters"]}
    truth = {"force.k0": 5.0, "force.hs": 18.0, "tool.runout.1": -8.0}
    for i, ((start, error), bias) in enumerate(zip(true, biases, strict=True), 1):
        truth |= {
            f"clock.start.trace_{i}": start * 1e3,
            f"clock.speed_error.trace_{i}": error,
            f"sensor.bias.x.trace_{i}": bias,
        }
    assert found.keys() == truth.keys()
    for name, value in truth.items():
        assert abs(found[name]["value"] - value) < 4 * found[name]["std"], name
    (out / "slow.csv").write_bytes((tmp_path / "slow.csv").read_bytes())
    (out / "fast.csv").write_bytes((tmp_path / "fast.csv").read_bytes())
    again = load_fit(out / "fitted.toml")
    for i, case in enumerate(again.cases, 1):
        assert float(case.clock.start) == pytest.approx(found[f"clock.start.trace_{i}"]["value"] / 1e3, rel=1e-9)
        assert float(case.sensor.bias[0]) == pytest.approx(found[f"sensor.bias.x.trace_{i}"]["value"], rel=1e-9)
        assert float(case.sensor.bias[1]) == (-7, -9)[i - 1]
        assert float(case.tool.runout[3]) == pytest.approx(-0.5 * float(case.tool.runout[1]), rel=1e-9)
    assert float(again.cases[1].cut.feed_rate) == pytest.approx(0.1)
    assert "align" not in (out / "fitted.toml").read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('guess = "0 N", each = true', "each = 1", "each of sensor.bias.x: 1 given; it must be true or false"),
        ("factor = 2 }", "factor = 0.5 }", "prior of force.k0: factor 0.5 given; it must be greater than 1"),
        ('{ mean = "5 kN/mm^2", factor = 2 }', "5", "prior of force.k0: 5 given; it must be a table"),
        ('mean = "5 kN/mm^2", factor', "median = 5, factor", "prior of force.k0"),
        ('tie = "tool.runout.1"', 'tie = "tool.runout.2"', "tool.runout.3: tied to tool.runout.2, which is not free"),
        ("factor = -0.5", 'factor = "-0.5"', "factor of tool.runout.3"),
        ("factor = -0.5", "guess = 1", "unknown key guess"),
        ("align = true", 'align = "yes"', "it must be true or false"),
    ],
)
def test_what_a_question_cannot_be_is_refused_in_words(tmp_path, old, new, words):
    assert old in QUESTION
    (tmp_path / "case.toml").write_text(UNEQUAL + QUESTION.replace(old, new, 1), encoding="utf-8")
    with pytest.raises(mx.CaseError) as refused:
        load_fit(tmp_path / "case.toml")
    assert words in str(refused.value)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('axes = ["x", "y"]', "", "give sensor.resonances.axes or sensor.resonances.residue"),
        ('axes = ["x", "y"]', 'axes = ["x"]', "sensor.resonances.axes: 1 given for 2 resonances"),
        ('axes = ["x", "y"]', "residue = [[1, 0], [0, 1]]", "a list with one matrix of 3 by 3 per resonance"),
        ('damping_ratio = ["5 %", 0.04]', "damping_ratio = [0.05]", "2 frequencies and 1 damping ratios given"),
        ('["1500 Hz", "1.9 kHz"]', '["1500 Hz", "-1 Hz"]', "sensor.resonances.frequency"),
        ("gain = [1, -1, 1]", "gain = 2", "sensor.gain: 2 given; it must be a list of three numbers"),
        ("speed_error = 8e-5", "speed_error = -1", "clock.speed_error: -1 given; it must be greater than -1"),
        ("speed_error", "speederror", "clock.speederror is not a key of [clock]. Did you mean speed_error?"),
        ("[clock]", "[clocks]", "[clocks] is not a table of a case file"),
    ],
)
def test_what_cannot_be_is_refused_in_words(old, new, words):
    with pytest.raises(mx.CaseError) as error:
        mx.CaseFile.from_text(FILE.replace(old, new))
    assert words in str(error.value)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"clock": mx.Clock(-1e-3)}, "it begins at -0.001 s, before the simulation does at 0 s. Raise clock.start"),
        ({"clock": mx.Clock(0.1)}, "of which the last 125 steps cannot be read. Raise simulation.duration"),
    ],
)
def test_a_trace_that_the_simulation_does_not_cover_is_refused(trace, change, words):
    with pytest.raises(TraceError) as error:
        compare(trace, dataclasses.replace(CASE, **change))
    assert words in str(error.value)


def test_what_cannot_be_aligned_is_refused(trace):
    moved = Trace(trace.time, ("x",), trace.values[:, :1])
    for one, case, words in (
        (moved, CASE, "it has no force, which is what tells the phase of the spindle"),
        (recorded(CASE, 0.01), CASE, "1.7 turns of the spindle long; two at least are needed"),
        (trace, dataclasses.replace(CASE, clock=mx.Clock(0.249)), "no whole turn of the spindle is simulated after"),
    ):
        with pytest.raises(TraceError) as error:
            align(case, one)
        assert words in str(error.value)
