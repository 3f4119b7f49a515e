"""Load tests: compliances of a robot from how far its tool gives way, alone and beside the trace of a cut."""

import dataclasses
import json

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases import RPM, SLOT_FILE, slot
from scipy.spatial.transform import Rotation

import millax as mx
from benchmarks import robot_slot
from benchmarks.kr270 import COMPLIANCE
from benchmarks.robot_slot import NOISE, POSES, TRACKER, pulls
from identification import LoadTest, Parameter, Trace, TraceError, _evaluate, check, fit, load_fit, read_load_test
from identification._deflection import deflection, rotation_vector
from identification.cli import main
from millax.robot import Loads, models

JOINTS, FORCE = pulls()
EIGHT = JOINTS[::3]
NAMES = [f"robot.compliance.joint_{i}" for i in range(1, 7)]
GUESSES = [
    Parameter(name, value * wrong)
    for name, value, wrong in zip(NAMES, COMPLIANCE, (2, 0.6, 1.5, 0.5, 1.8, 0.6), strict=True)
]
GRAVITY = Loads(gravity=(0.0, 0.0, -9.81))
XYZ = ("x", "y", "z")
ALL = (*XYZ, "rx", "ry", "rz")


def robot_case(loads=GRAVITY, robot=None, joints=EIGHT[0]):
    """0.02 s of the slot, held by a robot."""
    return slot(structure=robot_slot.arm(joints, loads, robot), speed=8000 * RPM)


CASE = robot_case()


@eqx.filter_jit
def predicted(comparison, case):
    return comparison.predict(case).T


def model(case, joints, force, moment=None, channels=XYZ):
    """What would be measured without noise."""
    test = LoadTest(joints, force, channels, np.ones((len(force), len(channels))), moment)
    return np.asarray(predicted(deflection(test, case), case))


@pytest.fixture(scope="module")
def clean():
    return model(CASE, JOINTS, FORCE)


def measured(clean, seed, noise=TRACKER, known=True):
    values = clean + np.random.default_rng(seed).normal(scale=noise, size=clean.shape)
    return LoadTest(JOINTS, FORCE, XYZ, values, noise=dict.fromkeys(XYZ, noise) if known else {}, units={"x": "um"})


# ---- the model


def test_small_loads_give_the_compliance_at_the_tool_times_the_wrench():
    rng = np.random.default_rng(0)
    force, moment = rng.normal(scale=0.1, size=(3, 3)), rng.normal(scale=0.02, size=(3, 3))
    found = model(CASE, EIGHT[:3], force, moment, ALL)
    for q, wrench, moved in zip(EIGHT, np.hstack([force, moment]), found, strict=False):
        linear = np.asarray(CASE.robot.elastic.tool_compliance(q, GRAVITY)) @ wrench
        np.testing.assert_allclose(moved, linear, rtol=0, atol=2e-6 * np.abs(linear[:3]).max())


def test_forces_for_the_cut_are_no_part_of_the_unloaded_state(clean):
    case = robot_case(Loads((100.0, 200.0, 300.0), (1.0, 2.0, 3.0), GRAVITY.gravity))
    np.testing.assert_allclose(model(case, JOINTS, FORCE), clean, rtol=1e-9, atol=1e-15)


def test_without_joints_the_pose_is_that_of_the_case(clean):
    np.testing.assert_allclose(model(CASE, None, FORCE[:3]), clean[:3], rtol=1e-9, atol=1e-15)


def test_the_rotation_vector_is_exact_for_small_angles_and_has_a_derivative_at_none():
    for angle, error in ((1e-9, 1e-13), (1e-3, 1e-13), (0.1, 5e-8)):
        vectors = angle * np.array([[1.0, 0.0, 0.0], [0.6, 0.0, -0.8], [-0.48, 0.6, 0.64]])
        found = rotation_vector(jnp.asarray(Rotation.from_rotvec(vectors).as_matrix()))
        np.testing.assert_allclose(found, vectors, rtol=0, atol=error * angle + 1e-16)
    slopes = jax.jacfwd(rotation_vector)(jnp.eye(3)[None])
    assert np.isfinite(slopes).all()
    assert float(slopes[0, 2, 0, 1, 0]) == 0.5


def test_derivatives_are_finite_and_those_of_differences():
    joints, force = JOINTS[:3], FORCE[:3]
    comparison = deflection(LoadTest(joints, force, ALL, np.ones((3, 6))), CASE)

    def of(values):
        arm = CASE.robot
        tool = eqx.tree_at(lambda t: (t.xyz, t.mass), arm.tool, (values[6:9], values[9]))
        changed = eqx.tree_at(lambda a: (a.compliance, a.tool), arm, (values[:6] * 1e-6, tool))
        return comparison.predict(eqx.tree_at(lambda c: c.structure, CASE, changed))

    at = jnp.concatenate([jnp.asarray(COMPLIANCE) * 1e6, CASE.robot.tool.xyz, CASE.robot.tool.mass[None]])
    weights = jax.random.normal(jax.random.key(0), (6, 3))

    @jax.jit
    def evaluated(at, direction):
        values, forward = jax.jvp(of, (at,), (direction,))
        return values, forward, jax.grad(lambda at: jnp.sum(weights * of(at)))(at)

    for direction in np.eye(10)[[0, 3, 5, 6, 8, 9]]:
        _, forward, reverse = evaluated(at, direction)
        assert np.isfinite(forward).all()
        assert np.isfinite(reverse).all()
        np.testing.assert_allclose(reverse @ direction, np.sum(weights * forward), rtol=1e-6, atol=1e-12)
        ends = [evaluated(at + sign * 1e-3 * direction, direction)[0] for sign in (1, -1)]
        np.testing.assert_allclose(forward, (ends[0] - ends[1]) / 2e-3, rtol=1e-4, atol=1e-9)


# ---- fits


def test_six_compliances_are_found_without_simulating_a_cut(monkeypatch, clean):
    monkeypatch.setattr(_evaluate, "simulate", None)
    apart = []
    for seed in range(5):
        result = fit(CASE, measured(clean, seed), GUESSES)
        assert result.success, result.message
        apart.append([(e.value - true) / e.std for e, true in zip(result.parameters, COMPLIANCE, strict=True)])
        assert result.traces[0].fitted.shape == (24, 3)
        assert max(result.traces[0].rmse.values()) < 1.6 * TRACKER
    assert np.abs(apart).max() < 3
    assert 0.5 < np.std(apart) < 1.6
    known = check(result.case, measured(clean, 0), NAMES)
    np.testing.assert_allclose([p.std for p in known.parameters], [e.std for e in result.parameters], rtol=1e-6)


def test_noise_that_is_not_known_is_estimated_with_the_degrees_of_freedom_that_are_left(clean):
    result = fit(CASE, measured(clean, 0, known=False), GUESSES)
    assert result.success, result.message
    (test,) = result.traces
    assert sum(24 * (test.rmse[c] / test.sigma[c]) ** 2 for c in XYZ) == pytest.approx(3 * 24 - 6, rel=3e-3)
    for c in XYZ:
        assert test.sigma[c] == pytest.approx(TRACKER, rel=0.5)
        assert test.rmse[c] < test.sigma[c]


def test_one_pose_and_one_force_do_not_tell_six_compliances(clean):
    again = np.zeros(len(FORCE), dtype=int)
    result = fit(CASE, dataclasses.replace(measured(clean, 0), joints=JOINTS[again], force=FORCE[again]), GUESSES)
    assert result.status == "not_identifiable"
    assert not result.begun
    assert "cannot be told apart" in result.message
    named = [name for name in NAMES if name in result.message]
    assert len(named) >= 4, result.message
    assert "measured" in result.message


@pytest.mark.long
def test_a_trace_and_a_load_test_together_know_more_than_either(clean):
    case = robot_case(None)
    asked = [*GUESSES[:3], Parameter("robot.tool.mass", 20.0)]
    names = [p.name for p in asked]
    steps = case.settings.steps
    time = (np.arange(steps) + 0.5) * float(case.cut.tooth_period(case.tool)) / case.settings.steps_per_tooth
    nothing = Trace(time, tuple(NOISE), np.ones((steps, 4)))
    # The model at the guess is what would be measured: it needs no program of its own.
    guess = fit(case, [nothing, measured(clean, 0)], names, check=False, max_iterations=1)
    columns = guess.traces[0].fitted + np.random.default_rng(1).normal(size=(steps, 4)) * list(NOISE.values())
    trace = Trace(time, tuple(NOISE), columns, dict(NOISE))
    coarse = measured(clean, 0, noise=1e-4)
    both = fit(case, [trace, coarse], asked)
    assert both.success, both.message
    for e, true in zip(both.parameters, (*COMPLIANCE[:3], 25.0), strict=True):
        assert abs(e.value - true) < 4 * e.std, e.name
    assert [one.trace.name for one in both.traces] == ["trace", "load test"]
    # Of what drowns in noise nothing is known; the compiled program is the same.
    drowned = [dataclasses.replace(one, noise=dict.fromkeys(one.channels, 1e4)) for one in (trace, coarse)]
    for known in (check(both.case, [trace, drowned[1]], names), check(both.case, [drowned[0], coarse], names)):
        for expected, e in zip(known.parameters, both.parameters, strict=True):
            assert expected.std is None or e.std < 0.99 * expected.std, e.name
    assert known.parameters[3].std is None  # without gravity, deflections do not weigh the tool


def test_loads_beyond_what_the_springs_hold_are_told(clean):
    soft = [Parameter(name, 1e-3) for name in NAMES]
    result = fit(CASE, measured(clean, 0), soft)
    assert result.status == "cannot_start"
    assert "the springs of the robot may not hold the loads" in result.message
    with pytest.raises(mx.SimulationError, match="may not hold the loads"):
        check(CASE, measured(clean, 0), soft)


# ---- what is refused

GOOD = {"joints": EIGHT[:2], "force": np.ones((2, 3)), "channels": ("x", "rz"), "values": np.ones((2, 2)), "name": "one.csv"}


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"values": np.ones((2, 3))}, "values of shape (2, 3) given; they must be (measurements, 2)"),
        ({"values": np.ones((0, 2))}, "at least one measurement"),
        ({"channels": (), "values": np.ones((2, 0))}, "one channel"),
        ({"force": np.ones((3, 3))}, "force of shape (3, 3) given; with 2 measurements it must be (2, 3)"),
        ({"moment": np.ones(3)}, "moment of shape (3,) given"),
        ({"joints": EIGHT[0]}, "joints of shape (6,) given; with 2 measurements"),
        ({"joints": np.full((2, 6), np.nan)}, "measurement 1, column q1: not a finite number. Repair the measurement"),
        ({"moment": np.array([[0, 0, 0], [0, 0, np.inf]])}, "measurement 2, column Mz: not a finite"),
        ({"values": np.array([[1, 1], [np.nan, 1]])}, "measurement 2, column x: not a finite"),
        ({"force": np.zeros((2, 3))}, "there is no load at all"),
        ({"values": np.array([[1.0, 0], [1, 0]])}, "channel rz is zero throughout"),
        ({"channels": ("x", "Fx")}, "channel 'Fx' is unknown; known are x, y, z, rx, ry, rz"),
        ({"channels": ("x", "x")}, "channel x given twice"),
        ({"noise": {"y": 1e-6}}, "noise of y given, but the channels are x, rz"),
        ({"noise": {"x": -1e-6}}, "it must be greater than 0"),
    ],
)
def test_a_load_test_of_arrays_is_checked(change, words):
    with pytest.raises(TraceError, match=r"^one\.csv: ") as error:
        LoadTest(**GOOD | change)
    assert words in str(error.value)


LIMITED = robot_case(robot=models.kuka_kr210_r2700_2(), joints=np.deg2rad([0, -60, 90, 20, 40, 10]))
BEYOND = np.deg2rad([[0, -60, 90, 20, 40, 10], [0, -150, 90, 20, 40, 10]])
SINGULAR = np.deg2rad([[90, -50, 120, 180, 25, 180], [90, -50, 120, 180, 0, 180]])


@pytest.mark.parametrize(
    ("case", "change", "words"),
    [
        (slot(), {}, "a load test needs a robot, and the case has none"),
        (LIMITED, {"joints": BEYOND}, "measurement 2, q: -2.618 rad (-150 deg) given for joint_2; it must be from"),
        (CASE, {"joints": SINGULAR}, "measurement 2, q: the pose (90, -50, 120, 180, 0, 180) deg is singular: joint_4"),
        (CASE, {"joints": EIGHT[:2, :5]}, "measurement 1, q: shape (5,) given; the last axis must be the 6 joints"),
        (
            CASE,
            {"channels": ("x",), "values": np.ones((2, 1))},
            "the noise of x is not given, and 2 measurements do not tell",
        ),
    ],
)
def test_a_load_test_that_does_not_fit_its_case_is_refused(case, change, words):
    test = LoadTest(**GOOD | change)
    with pytest.raises(TraceError, match=r"^one\.csv: ") as error:
        fit(case, test, ["cut.depth"] if case.robot is None else NAMES)
    assert words in str(error.value)


def test_a_passive_joint_is_refused():
    case = eqx.tree_at(lambda c: c.structure.compliance, CASE, CASE.robot.compliance.at[2].set(jnp.inf))
    with pytest.raises(TraceError, match=r"one\.csv: compliance: joint_3 is passive.*leave the load test out"):
        deflection(LoadTest(**GOOD), case)


# ---- files

HEADER = "q1 [deg],q2 [deg],q3 [deg],q4 [deg],q5 [deg],q6 [deg],Fx [N],Fz [kN],Mx [N m],x [um],rz [mrad]"


def text(rows, header=HEADER):
    return "\n".join([header, *(",".join(f"{x:.9g}" for x in row) for row in rows)]) + "\n"


ROWS = [[*POSES[0], 500, 0, 0, 400, 0.1], [*POSES[1], 0, -0.5, 2, 300, 0.2]]


@pytest.fixture
def read(tmp_path):
    def read(content, **keywords):
        (tmp_path / "deflections.csv").write_text(content, encoding="utf-8")
        return read_load_test(tmp_path / "deflections.csv", **keywords)

    return read


def test_a_file_is_read_in_the_units_of_its_header(read):
    test = read(text(ROWS), noise={"x": "10 um"})
    np.testing.assert_allclose(test.joints, np.deg2rad(POSES[:2]))
    np.testing.assert_allclose(test.wrench, [[500, 0, 0, 0, 0, 0], [0, 0, -500, 2, 0, 0]])
    assert test.channels == ("x", "rz")
    np.testing.assert_allclose(test.values, [[4e-4, 1e-4], [3e-4, 2e-4]])
    assert test.noise == {"x": pytest.approx(1e-5)}
    assert test.shown("rz", 1e-3) == pytest.approx(1)
    assert (test.name, test.samples) == ("deflections.csv", 2)
    assert read(text(ROWS).replace("rz [mrad]", "temperature"), channels=["x"]).channels == ("x",)
    assert read(text([row[6:] for row in ROWS], HEADER.partition("q6 [deg],")[2])).joints is None


@pytest.mark.parametrize(
    ("old", "new", "keywords", "words"),
    [
        ("q3 [deg]", "q7 [deg]", {}, "no column q3, but 6 others of q; give every joint, or none"),
        ("q1 [deg]", "q1", {}, 'column 1 "q1" has no unit; write q1 [rad]'),
        ("q1 [deg]", "q1 [mm]", {}, "the unit mm is not one of q1; use [rad]"),
        ("Fx [N]", "Fx [m]", {}, "the unit m is not one of Fx"),
        ("Fx [N]", "F_x [N]", {}, "is not a channel. Did you mean Fx? The first row names the columns, such as q1 [deg]"),
        ("Fx [N]", "F_x [N]", {}, "known are q1, q2 and so on, Fx, Fy, Fz, Mx, My, Mz, x, y, z, rx, ry, rz"),
        (",500,", ",abc,", {}, "row 2, column Fx: not a finite number"),
        ("x [um],rz [mrad]", "Fy [N],My [N m]", {}, "there is no channel beside q1"),
        ("x [um]", "x [um]", {"channels": ["y"]}, "no column y"),
        ("x [um]", "x [um]", {"channels": ["Fx"]}, "channels 'Fx' is unknown"),
        ("x [um]", "x [um]", {"noise": {"Fx": "1 N"}}, "noise 'Fx' is unknown"),
    ],
)
def test_a_file_that_cannot_be_used_is_refused_with_the_place_named(read, old, new, keywords, words):
    with pytest.raises(ValueError, match=r"deflections\.csv") as error:
        read(text(ROWS).replace(old, new), **keywords)
    assert words in str(error.value)


FILE = f"""\
{SLOT_FILE}
[robot]
model = "kuka_kr270"
joints = ["90 deg", "-50 deg", "120 deg", "180 deg", "25 deg", "180 deg"]
compliance = ["0.4e-6 rad/(N m)", "0.2e-6 rad/(N m)", 0.2e-6, 1.79e-6, 1.52e-6, 2.13e-6]
damping_ratio = 0.05
[robot.tool]
xyz = ["150 mm", "0 mm", "250 mm"]
rpy = ["0 deg", "60 deg", "0 deg"]
mass = "25 kg"
[robot.loads]
gravity = [0.0, 0.0, -9.81]
[simulation]
duration = "0.02 s"
[fit.free]
robot.compliance.joint_1 = {{}}
robot.compliance.joint_2 = {{}}
robot.compliance.joint_3 = {{}}
[fit.truth]
robot.compliance.joint_1 = 0.26e-6
[[load_test]]
file = "deflections.csv"
noise = {{ x = "10 um", y = "10 um" }}
"""


@pytest.fixture
def problem(tmp_path, clean):
    """Write a case file, with replacements, and its load test."""
    values = 1e6 * measured(clean, 0).values
    header = ",".join([*(f"q{i} [deg]" for i in range(1, 7)), "Fx [N]", "Fy [N]", "Fz [N]", *(f"{c} [um]" for c in XYZ)])
    rows = np.hstack([np.rad2deg(JOINTS), FORCE, values])
    (tmp_path / "deflections.csv").write_text(text(rows, header), encoding="utf-8")

    def problem(*changes):
        content = FILE
        for old, new in changes:
            assert old in content
            content = content.replace(old, new)
        (tmp_path / "case.toml").write_text(content, encoding="utf-8")
        return tmp_path / "case.toml"

    return problem


def test_the_command_fits_a_load_test(problem, tmp_path):
    out = tmp_path / "out"
    assert main(["fit", str(problem()), "--out", str(out)]) == 0
    result = json.loads((out / "result.json").read_text(encoding="utf-8"))
    assert result["status"] == "converged"
    for found, true in zip(result["parameters"], COMPLIANCE, strict=False):
        assert abs(found["value"] - true) < 4 * found["std"]
    (test,) = result["traces"]
    assert (test["name"], test["samples"], test["units"]["x"]) == ("deflections.csv", 24, "um")
    assert test["noise"]["x"] == pytest.approx(10)
    assert test["noise_estimated"] == ["z"]
    assert test["noise"]["z"] == pytest.approx(10, rel=0.5)
    fitted = mx.load_case(out / "fitted.toml")
    assert float(fitted.robot.compliance[0]) == pytest.approx(result["parameters"][0]["value"], rel=1e-9)
    page = (out / "report.html").read_text(encoding="utf-8")
    for words in ("measured x [µm]", "fitted z [µm]", "number of the measurement", "24 measurements", "Converged"):
        assert words in page
    assert "spectral density" not in page


def test_traces_and_load_tests_of_a_file(problem, tmp_path):
    rows = ["time [s],Fx [N]", *(f"{i * 1e-4:g},{i + 1}" for i in range(100))]
    (tmp_path / "trace.csv").write_text("\n".join(rows), encoding="utf-8")
    more = '[[trace]]\nfile = "trace.csv"\n[[load_test]]\nfile = "deflections.csv"\nchannels = ["z"]\n'
    more += 'case = { robot = { tool = { mass = "0 kg" } } }\n[[load_test]]\n'
    found = load_fit(problem(("[[load_test]]\n", more)))
    assert [one.name for one in found.traces] == ["trace.csv", "deflections.csv", "deflections.csv"]
    assert [one.channels for one in found.traces] == [("Fx",), ("z",), XYZ]
    assert [float(case.robot.tool.mass) for case in found.cases] == [25, 0, 25]
    assert found.cases[0] is found.cases[2]


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("[[load_test]]", "[load_test]", "there is no [[load_test]], only load_test"),
        ('file = "deflections.csv"\n', "", '[[load_test]]: file is missing; it names the file: file = "load_test.csv"'),
        ('file = "deflections.csv"', 'file = "none.csv"', "none.csv: the load test cannot be read"),
        ("noise =", "window =", "[[load_test]]: unknown key window"),
        ("noise =", "channels =", "[[load_test]]: channels ="),
        ('{ x = "10 um", y = "10 um" }', '{ x = "10 N" }', "noise of x"),
        ("noise =", "case = { robot.compliance = [1, 1, 1, 1, 1, 1] }\nnoise =", "[[load_test]] 1, case: robot.compliance"),
        ('[[load_test]]\nfile = "deflections.csv"\nnoise', "[fit.unused]\nnoise", "unknown key unused"),
    ],
)
def test_a_case_file_that_cannot_be_used_is_refused(problem, old, new, words):
    with pytest.raises(ValueError, match=r"toml|csv") as error:
        load_fit(problem((old, new)))
    assert words in str(error.value)
