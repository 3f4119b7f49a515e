"""What the README says can be done."""

import ast
import contextlib
import io
import re
import textwrap
from pathlib import Path

import numpy as np
import pytest

import millax as mx
from identification import NoiseModel, Parameter, load_fit, synthetic_trace
from identification._options import Options

ROOT = Path(__file__).parents[1]
TEXT = (ROOT / "README.md").read_text(encoding="utf-8")


def blocks(language: str) -> list[str]:
    return [textwrap.dedent(block) for block in re.findall(rf"```{language}\n(.*?)```", TEXT, flags=re.DOTALL)]


def test_the_examples_run(monkeypatch):
    monkeypatch.chdir(ROOT)
    fitting, sure, sweeping = blocks("python")
    names = {}
    with contextlib.redirect_stdout(io.StringIO()) as out:
        exec(fitting, names)
    assert "force.k0 = 51" in out.getvalue()
    assert isinstance(ast.parse(sure), ast.Module)  # it takes a while, and its parts are tested by themselves
    with contextlib.redirect_stdout(io.StringIO()) as out:
        exec(sweeping, names)
    assert "thickest_chip" in names["result"]
    assert "cut.spindle_speed" in out.getvalue()


def test_the_case_file_can_be_simulated():
    case, *_ = blocks("toml")
    assert mx.CaseFile.from_text(case).case.settings.periods == 1334


def test_the_tables_of_a_fit_are_accepted(tmp_path):
    case, fit, *_ = blocks("toml")
    header = re.search(r"(?m)^ *(time \[.*\])$", TEXT)[1]
    rows = [f"{0.1 * i:.1f},1,2,3,4" for i in range(100)]
    (tmp_path / "trace.csv").write_text("\n".join([header, *rows]), encoding="utf-8")
    (tmp_path / "case.toml").write_text(case + fit, encoding="utf-8")
    problem = load_fit(tmp_path / "case.toml")
    assert {p.name for p in problem.parameters} == {"force.k0", "force.kr", "structure.damping_ratio.x"}


@pytest.mark.long
def test_the_example_of_starts_and_profiles_runs(monkeypatch):
    monkeypatch.chdir(ROOT)
    fitting, sure, _ = blocks("python")
    names = {}
    with contextlib.redirect_stdout(io.StringIO()) as out:
        exec(fitting, names)
        exec(sure, names)
    assert "8 of 8 starts reached the best optimum" in out.getvalue()
    assert "force.hs (" in out.getvalue()


def test_what_is_said_of_how_to_fit_is_accepted(tmp_path):
    case, free, _, how, *_ = blocks("toml")
    rows = [f"{0.1 * i:.1f},1,2,3,4" for i in range(100)]
    (tmp_path / "trace.csv").write_text("\n".join(["time [ms],Fx [N],Fy [N],x [um],y [um]", *rows]), encoding="utf-8")
    (tmp_path / "case.toml").write_text(case + free.replace("[fit.free]", how + "[fit.free]"), encoding="utf-8")
    options = load_fit(tmp_path / "case.toml").options
    assert options == Options(NoiseModel("student", order=2), "scipy_trf", 20, 5, 0, True, 2000)


def test_what_measured_a_trace_can_be_said_and_be_free(tmp_path):
    case, _, instrument, *_ = blocks("toml")
    path = tmp_path / "case.toml"
    path.write_text(case + instrument, encoding="utf-8")
    file = mx.CaseFile.read(path)
    time = 5.0 + np.arange(2000) / 10e3
    trace = synthetic_trace(file.case.with_settings(periods=200), time, ("Fx", "Fy"), {"Fx": 1.0}, 0)
    rows = [f"{t:.4f},{x:.9g},{y:.9g}" for t, (x, y) in zip(time, trace.values, strict=True)]
    (tmp_path / "slot.csv").write_text("\n".join(["time [s],Fx [N],Fy [N]", *rows]), encoding="utf-8")
    problem = load_fit(path)
    assert [p.name for p in problem.parameters if isinstance(p, Parameter) and p.each] == [
        "clock.start",
        "clock.speed_error",
        "sensor.bias.x",
    ]
    assert 0.02 <= float(problem.cases[0].clock.start) < 0.026


def test_a_robot_takes_the_place_of_the_structure_and_has_poses(tmp_path):
    case, _, _, _, robot, poses, load_test = blocks("toml")
    other = re.sub(r"\[structure\].*?(?=\[simulation\])", lambda _: robot, case, flags=re.DOTALL)
    rows = [f"{0.1 * i:.1f},1,2,3,4" for i in range(100)]
    for name in ("pose1.csv", "pose2.csv"):
        (tmp_path / name).write_text("\n".join(["time [ms],Fx [N],Fy [N],x [um],y [um]", *rows]), encoding="utf-8")
    (tmp_path / "case.toml").write_text(f'{other}\n[[trace]]\nfile = "pose1.csv"\n{poses}', encoding="utf-8")
    problem = load_fit(tmp_path / "case.toml")
    assert [round(float(case.robot.joints[0]), 4) for case in problem.cases] == [1.5708, 1.0472]
    assert [p.name for p in problem.parameters] == ["robot.compliance.joint_4"]
    header = "q1 [deg],q2 [deg],q3 [deg],q4 [deg],q5 [deg],q6 [deg],Fx [N],Fy [N],Fz [N],x [um],y [um],z [um]"
    (tmp_path / "deflections.csv").write_text(f"{header}\n10,-50,120,180,25,180,0,0,-500,1,2,-300\n", encoding="utf-8")
    (tmp_path / "both.toml").write_text((tmp_path / "case.toml").read_text() + load_test, encoding="utf-8")
    assert len(load_fit(tmp_path / "both.toml").traces) == 3


@pytest.mark.parametrize("target", sorted(t for t in set(re.findall(r"\]\(([^)]+)\)", TEXT)) if not t.startswith("https:")))
def test_a_link_leads_somewhere(target):
    assert (ROOT / target).exists()
