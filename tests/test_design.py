"""The next cut: information adds, nuisance is taken out, and what is predicted is what a joint question then gives."""

import dataclasses
import itertools

import jax.numpy as jnp
import numpy as np
import pytest
import xarray
from cases import ENDLESS, SLOT_FILE, slot

import millax as mx
from identification import Forecast, Parameter, Prior, Recording, check, design, synthetic_trace
from identification._information import added, knowledge, marginal
from identification._uncertainty import RANK
from identification.cli import main
from millax._members import FEED_PER_TOOTH, member
from millax._names import replace

CASE = slot(axes=(), stock=mx.Stock.box((-1.0, 1.0)), duration=0.024, start=(0.0, 0.0))
LAW = ("force.k0", "force.hs", "force.r", "force.kr")
NOISE = {"Fx": 2.0, "Fy": 3.0}
TIME = 0.002 + np.arange(160) / 10e3
"""Not the times of the simulation: the model is interpolated in each cut."""

MEASURED = synthetic_trace(CASE, TIME, ("Fx", "Fy"), NOISE, seed=0)
ASKED = [*LAW[:3], Parameter("force.kr", each=True)]
"""The ratio of forces differs from cut to cut, and is no aim."""

GRID = {FEED_PER_TOOTH: "0.02, 0.1, 0.3 mm", "cut.depth": "1, 3 mm"}
CUTS = list(itertools.product((2e-5, 1e-4, 3e-4), (1e-3, 3e-3)))
FOUND = design(CASE, MEASURED, ASKED, GRID, count=2)


def cut(feed_per_tooth, depth) -> mx.Case:
    return member(CASE, (FEED_PER_TOOTH, "cut.depth"), jnp.array([feed_per_tooth, depth]))


def chosen(forecast: Forecast) -> tuple[float, ...]:
    """Feed per tooth and depth [m]."""
    return tuple(1e-3 * value for value, _ in forecast.cut.values())


def information(case, names=LAW) -> np.ndarray:
    """About the logarithms, by differences of simulations and without anything of the package's own."""
    columns = []
    for name in names:
        section, key = name.split(".")
        value = float(getattr(getattr(case, section), key))
        ends = [mx.simulate(replace(case, {name: jnp.array(value * factor)})) for factor in (1 + 1e-5, 1 - 1e-5)]
        change = np.asarray(ends[0].force - ends[1].force)[:, :2] / 2e-5
        time = np.asarray(ends[0].time)
        columns.append([np.interp(TIME, time, f) / sigma for f, sigma in zip(change.T, NOISE.values(), strict=True)])
    jacobian = np.array(columns).reshape(len(names), -1)
    return jacobian @ jacobian.T


def of_three(case) -> np.ndarray:
    """About the first three, the fourth being unknown."""
    whole = information(case)
    return whole[:3, :3] - np.outer(whole[:3, 3], whole[3, :3]) / whole[3, 3]


def test_the_determinant_the_trace_and_one_variance_are_those_of_matrices_made_by_hand():
    today, new = of_three(CASE), [of_three(cut(*numbers)) for numbers in CUTS]
    inverse = [np.linalg.inv(today + one) for one in new]
    d = [np.linalg.det(one) ** (1 / 6) for one in inverse]
    a = [np.sqrt(np.trace(one) / 3) for one in inverse]
    c = [18e-6 * np.sqrt(one[1, 1]) for one in inverse]
    for criterion, expected in (("D", d), ("A", a), ("force.hs", c)):
        found = design(CASE, MEASURED, ASKED, GRID, criterion=criterion)
        np.testing.assert_allclose(found.table["uncertainty"].to_numpy().ravel(), expected, rtol=2e-4)
        np.testing.assert_allclose([chosen(one) for one in found.ranking], [CUTS[i] for i in np.argsort(expected)])
    best = int(np.argmin(d))
    then = [np.linalg.det(today + new[best] + one) for one in new]
    assert chosen(FOUND.next[1]) == pytest.approx(CUTS[int(np.argmax(then))])
    assert FOUND.next[1].uncertainty == pytest.approx(max(then) ** (-1 / 6), rel=2e-4)


def test_the_errors_predicted_are_those_of_a_joint_question_once_the_cut_is_made():
    made = cut(*chosen(FOUND.next[0]))
    both = check([CASE, made], [MEASURED, synthetic_trace(made, TIME, ("Fx", "Fy"), NOISE, seed=1)], ASKED)
    assert FOUND.parameters == LAW[:3]
    assert list(FOUND.next[0].std.values()) == pytest.approx([p.std for p in both.parameters[:3]], rel=1e-6)
    alone = check(CASE, MEASURED, ASKED).parameters[:3]
    assert list(FOUND.today.std.values()) == pytest.approx([p.std for p in alone], rel=1e-6)
    assert FOUND.next[0].shrinks(FOUND.today) == pytest.approx(FOUND.today.uncertainty / FOUND.next[0].uncertainty)


@pytest.mark.long
def test_clock_and_offset_of_the_new_cut_are_not_taken_for_known():
    """They have priors or none, and where the speed differs the instrument reads the model with another kernel."""
    case = dataclasses.replace(CASE, sensor=mx.Sensor(bias=(5.0, -3.0, 0.0)), clock=mx.Clock(0.0021))
    own = [
        Parameter("clock.start", each=True, prior=Prior(0.0021, std=2e-6)),
        Parameter("sensor.bias.x", each=True),
        Parameter("force.kr", prior=Prior(0.3, std=0.001)),
    ]
    time = np.arange(160) / 10e3
    measured = synthetic_trace(case, time, ("Fx", "Fy"), NOISE, seed=0)
    asked = [*LAW[:2], *own]
    found = design(case, measured, asked, {"cut.spindle_speed": [900.0, 1250.0]}, criterion="force.k0")
    assert found.parameters == ("force.k0", "force.hs", "force.kr")
    for i, speed in enumerate((900.0, 1250.0)):
        other = member(case, ("cut.spindle_speed",), jnp.array([speed])).with_settings(periods=40)
        trace = synthetic_trace(other, time, ("Fx", "Fy"), NOISE, seed=1)
        both = {p.name: p.std for p in check([case, other], [measured, trace], asked).parameters}
        std = found.table["standard_error"].to_numpy()[i]
        np.testing.assert_allclose(std, [both[name] for name in found.parameters], rtol=1e-6)


def test_marginal_information_is_the_inverse_of_a_block_of_the_covariance():
    rng = np.random.default_rng(3)
    jacobian, kept = rng.normal(size=(30, 5)) * [1, 1e4, 1e-3, 1, 1], np.array([True, False, True, True, False])
    factor = marginal(jacobian, kept)
    covariance = np.linalg.inv(jacobian.T @ jacobian)[np.ix_(kept, kept)]
    np.testing.assert_allclose(np.linalg.inv(factor.T @ factor), covariance, rtol=1e-9)
    # What is not felt at all, or twice the same, takes nothing more.
    more = np.concatenate([jacobian, np.zeros((30, 1)), 3 * jacobian[:, 1:2]], axis=1)
    again = marginal(more, np.append(kept, [False, False]))
    np.testing.assert_allclose(again.T @ again, factor.T @ factor, rtol=1e-9)


def test_information_adds():
    rng = np.random.default_rng(4)
    one, others = rng.normal(size=(9, 3)), rng.normal(size=(6, 4, 3))
    known = knowledge(added(one, others))
    for i, other in enumerate(others):
        covariance = np.linalg.inv(one.T @ one + other.T @ other)
        np.testing.assert_allclose(known.std[i], np.sqrt(np.diag(covariance)), rtol=1e-9)
        assert known.radius[i] == pytest.approx(np.linalg.det(covariance) ** (1 / 6), rel=1e-9)
    assert not known.left.any()


def test_a_combination_that_nothing_tells_is_left_open():
    apart = np.array([[1.0, 1.0, 0.0, 0.0], [2.0, 2.0, 0.0, 0.0], [0.0, 0.0, 4.0, 0.0]])
    hardly = apart + np.array([[0.0, RANK / 100, 0.0, 0.0], [0.0] * 4, [0.0] * 4])
    known = knowledge(np.array([apart, hardly]))
    np.testing.assert_array_equal(known.left, [2, 2])
    np.testing.assert_allclose(known.std, [[np.inf, np.inf, 0.25, np.inf]] * 2)
    np.testing.assert_allclose(known.radius, (np.sqrt(10.0) * 4) ** -0.5)
    assert np.isinf(knowledge(np.zeros((2, 3))).radius)


@pytest.mark.long
def test_what_makes_most_known_comes_first_where_nothing_was_measured():
    found = design(CASE, (), LAW, GRID, recording=Recording(("Fx", "Fy"), "16 ms", "10 kHz", NOISE, "2 ms"))
    assert found.today.left == 4
    assert all(std is None for std in found.today.std.values())
    assert found.next[0].left == 0
    assert found.next[0].known_since(found.today) == list(LAW)
    assert np.isinf(found.next[0].shrinks(found.today))
    expected = [np.linalg.det(information(cut(*numbers))) ** (-1 / 8) for numbers in CUTS]
    np.testing.assert_allclose(found.table["uncertainty"].to_numpy().ravel(), expected, rtol=2e-4)


@pytest.mark.parametrize(
    ("name", "values", "status", "reason"),
    [
        (FEED_PER_TOOTH, "0.05, 0.1 mm", [[0, 3], [0, 3]], ""),
        pytest.param(
            "cut.spindle_speed", "10000, 60000 rpm", [[0, 3], [-1, -1]], "at least 4 are needed", marks=pytest.mark.long
        ),
    ],
)
def test_a_cut_that_cannot_be_simulated_or_recorded_is_not_ranked(name, values, status, reason):
    found = design(CASE, MEASURED, ASKED, {name: values, "cut.depth": "1, 1e305 mm"})
    np.testing.assert_array_equal(found.table["status"], status)
    fine = np.array(status) == 0
    assert [one.cut["cut.depth"] for one in found.ranking] == [(1.0, "mm")] * fine.sum()
    np.testing.assert_array_equal(np.isfinite(found.table["uncertainty"]), fine)
    np.testing.assert_array_equal(np.isfinite(found.table["standard_error"]).all(axis=-1), fine)
    why = found.table["reason"].to_numpy()
    assert (why[0, 0], why[0, 1]) == ("", mx.STATUS[3])
    assert reason in why[1, 0]


@pytest.mark.long
def test_a_cut_that_chatters_is_not_ranked_however_much_its_derivatives_promise():
    case = slot(mass=0.04, stiffness=1.34e6, damping_ratio=0.011, stock=ENDLESS, start=(0.0, 0.0), sweeps=12, blocks=5)
    rec = Recording(("Fx", "Fy"), "16 ms", "10 kHz", NOISE)
    found = design(case, (), ["force.k0", "force.kr"], {"cut.depth": "0.02, 2 mm"}, recording=rec)
    np.testing.assert_array_equal(found.table["status"], [0, -1])
    assert "chatters" in str(found.table["reason"].to_numpy()[1])
    assert len(found.ranking) == 1


def refused(match, **others):
    asked = {"case": CASE, "measured": MEASURED, "parameters": ASKED, "grid": GRID} | others
    with pytest.raises(ValueError, match=match):
        design(asked.pop("case"), asked.pop("measured"), asked.pop("parameters"), asked.pop("grid"), **asked)


def test_what_cannot_be_used_is_refused_with_a_way_out():
    refused(r"cut.dept: unknown parameter; did you mean cut.depth", grid={"cut.dept": "1, 2 mm"})
    refused(r"force.kr: it is to be found, so it cannot be chosen", grid={"force.kr": "0.2, 0.3"})
    refused(r"cut.feed_per_tooth: it is to be found", parameters=["force.k0", "cut.feed_rate"])
    refused(r"grid: empty", grid={})
    refused(r"grid: one cut given", grid={"cut.depth": "1 mm"})
    refused(r'criterion: "E" given; it must be D, A or the name of a parameter: force.k0', criterion="E")
    refused(r"count: 0 given", count=0)
    refused(r"every parameter has a value of its own", parameters=[Parameter("force.k0", each=True)])
    refused(r"channels: none given", measured=())
    refused(r"rate: not given", measured=(), recording=Recording(("Fx",)))
    refused(r"duration: not given", measured=(), recording=Recording(("Fx",), rate="10 kHz"))
    refused(r"rate: 0.0 given", recording=Recording(rate=0.0))
    refused(r"noise of x: not given", recording=Recording(("Fx", "x")))
    refused(r'noise of Fx: "0 N" given; it must be greater than 0', recording=Recording(noise={"Fx": "0 N"}))
    refused(r"noise: 'Fz' is unknown; known are Fx, Fy", recording=Recording(noise={"Fz": "1 N"}))
    refused(r"samples; it must be from 2", recording=Recording(duration=1e-6))


FILE = (
    SLOT_FILE
    + """
start = ["0 mm", "0 mm"]
[stock]
x = ["-1 m", "1 m"]
[simulation]
duration = "24 ms"
[fit.free]
force.k0 = {}
force.hs = {}
force.r = {}
force.kr = { each = true }
"""
)
TRACE = '[[trace]]\nfile = "trace.csv"\nnoise = { Fx = "2 N", Fy = "3 N" }\n'
VARY = ("--vary", "cut.feed_per_tooth=0.02, 0.1, 0.3 mm", "--vary", "cut.depth=1, 3 mm")


def test_the_command_says_what_to_cut_next(tmp_path, capsys):
    columns = np.column_stack([MEASURED.time, MEASURED.values])
    np.savetxt(tmp_path / "trace.csv", columns, delimiter=",", header="time [s],Fx [N],Fy [N]", comments="", fmt="%.12g")
    path = tmp_path / "case.toml"
    path.write_text(FILE + TRACE)
    assert main(["design", str(path), *VARY, "--out", str(tmp_path / "out"), "--count", "2"]) == 0
    said = capsys.readouterr().out
    assert f"cut next: {FOUND.next[0].words}. Standard errors shrink" in said
    assert f"and then: {FOUND.next[1].words}." in said
    assert "cut.depth is the largest of those given" in said
    assert "force.hs: 18.00 µm, today" in said
    table = xarray.load_dataset(tmp_path / "out" / "design.nc", engine="h5netcdf")
    np.testing.assert_allclose(table["uncertainty"], FOUND.table["uncertainty"], rtol=1e-6)
    assert (tmp_path / "out" / "design.png").stat().st_size > 10000


def test_the_command_refuses_what_cannot_be_used(tmp_path, capsys):
    path, out = tmp_path / "case.toml", tmp_path / "out"
    path.write_text(FILE)
    assert main(["design", str(path), *VARY, "--out", str(out)]) == 2
    assert "channels: none given" in capsys.readouterr().err
    assert main(["design", str(path), *VARY, "--out", str(out), "--noise", "Fx"]) == 2
    assert '--noise "Fx": it must be NAME=VALUE' in capsys.readouterr().err
    new = ["--channels", "Fx,Fy", "--rate", "10 kHz", "--noise", "Fx=2 N", "--noise", "Fy=3 N"]
    fast = ["--vary", "cut.spindle_speed=60000, 70000 rpm"]
    assert main(["design", str(path), *fast, *new, "--duration", "16 ms", "--out", str(out)]) == 1
    said = capsys.readouterr()
    assert "no candidate can be ranked" in said.err
    assert "at least 4 are needed" in said.out
    assert (out / "design.nc").exists()
    assert not (out / "design.png").exists()
