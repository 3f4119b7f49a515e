"""`millax fit` over several cuts, each with its own case: here a robot in two poses, with shared parameters."""

import json

import numpy as np
import pytest
from cases import SLOT_FILE

import millax as mx
from identification import load_fit
from identification.cli import main

CASE = f"""\
{SLOT_FILE}start = ["20 mm", 0]
[robot]
model = "kuka_kr270"
joints = ["90 deg", "-50 deg", "120 deg", "180 deg", "25 deg", "180 deg"]
compliance = [0.26e-6, 0.15e-6, 0.26e-6, 1.79e-6, 1.52e-6, 2.13e-6]
damping_ratio = 0.05
[simulation]
duration = "60 ms"
blocks = 5
"""
QUESTION = """
[fit.free]
robot.compliance.joint_1 = "0.4e-6 rad/(N m)"
robot.compliance.joint_2 = 0.2e-6
[[trace]]
file = "first.csv"
noise = { Fx = "2 N", Fy = "2 N", x = "1 um", y = "1 um" }
[[trace]]
file = "second.csv"
noise = { Fx = "2 N", Fy = "2 N", x = "1 um", y = "1 um" }
case = { robot.joints = ["60 deg", "-70 deg", "110 deg", "150 deg", "50 deg", "120 deg"], cut.spindle_speed = "7000 rpm" }
"""


def measured(case: mx.Case, seed: int) -> str:
    sim = mx.simulate(case)
    columns = np.column_stack([np.asarray(sim.force)[:, :2], 1e6 * np.asarray(sim.displacement)[:, :2]])
    columns += np.random.default_rng(seed).normal(size=columns.shape) * [2, 2, 1, 1]
    rows = [",".join(f"{x:.9g}" for x in row) for row in np.column_stack([sim.time, columns])]
    return "\n".join(["time [s],Fx [N],Fy [N],x [um],y [um]", *rows]) + "\n"


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A case file with its two traces."""
    folder = tmp_path_factory.mktemp("poses")
    (folder / "case.toml").write_text(CASE + QUESTION, encoding="utf-8")
    for name in ("first.csv", "second.csv"):  # to read the cases of the file, any trace will do
        (folder / name).write_text("time [s],Fx [N]\n" + "".join(f"{1e-4 * i},1\n" for i in range(200)), encoding="utf-8")
    text = (CASE + QUESTION).replace(', Fy = "2 N", x = "1 um", y = "1 um"', "")
    (folder / "read.toml").write_text(text, encoding="utf-8")
    for i, case in enumerate(load_fit(folder / "read.toml").cases):
        (folder / ("first.csv", "second.csv")[i]).write_text(measured(case, i), encoding="utf-8")
    return folder


def test_every_trace_has_its_case(folder):
    problem = load_fit(folder / "case.toml")
    first, second = problem.cases
    assert first is problem.case
    assert float(second.robot.joints[1]) == pytest.approx(np.deg2rad(-70))
    assert float(second.cut.spindle_speed) == pytest.approx(7000 * 2 * np.pi / 60)
    assert float(second.cut.depth) == float(first.cut.depth)


def test_one_fit_finds_what_the_poses_share(folder, tmp_path):
    out = tmp_path / "out"
    assert main(["fit", str(folder / "case.toml"), "--out", str(out)]) == 0
    result = json.loads((out / "result.json").read_text(encoding="utf-8"))
    for e, true in zip(result["parameters"], (0.26e-6, 0.15e-6), strict=True):
        assert abs(e["value"] - true) < 4 * e["std"]
    assert [trace["name"] for trace in result["traces"]] == ["first.csv", "second.csv"]
    fitted = mx.load_case(out / "fitted.toml")
    assert float(fitted.robot.compliance[0]) == pytest.approx(result["parameters"][0]["value"])
    assert "second.csv" in (out / "report.html").read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("cut.spindle_speed = ", "cut.speed = ", ["[[trace]] 2, case: cut.speed is not a key of [cut]", "spindle_speed"]),
        ('"60 deg", "-70 deg"', '"60 mm", "-70 deg"', ["[[trace]] 2, case: robot.joints[0]"]),
        ('cut.spindle_speed = "7000 rpm"', "robot.compliance = [1]", ["robot.compliance given", "joint_1 is free"]),
        ("case = {", "case = 3 # {", ["case = 3 given", "a table"]),
    ],
)
def test_what_cannot_be_is_refused_in_words(folder, old, new, words):
    text = CASE + QUESTION
    assert old in text
    path = folder / "bad.toml"
    path.write_text(text.replace(old, new), encoding="utf-8")
    with pytest.raises(mx.CaseError) as error:
        load_fit(path)
    assert all(word in str(error.value) for word in words), str(error.value)
