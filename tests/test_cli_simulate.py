"""`millax simulate`: files, exit codes, and nothing left behind when it cannot be done."""

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from cases import SLOT_FILE

import millax as mx
from identification import _simulate_command
from identification.cli import main

TEXT = f"""\
{SLOT_FILE}
[structure]
axes = ["x", "y"]
mass = "100 kg"
stiffness = "3e5 N/m"
damping_ratio = 0.05
[simulation]
duration = "0.06 s"
"""


@pytest.fixture
def case_file(tmp_path):
    path = tmp_path / "case.toml"
    path.write_text(TEXT)
    return path


def files(folder: Path) -> set[str]:
    return {str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file()}


def refuse(arguments, capsys, code: int) -> str:
    """The error of a command that must fail with this exit code and without a traceback."""
    assert main([str(argument) for argument in arguments]) == code
    captured = capsys.readouterr()
    assert "Traceback" not in captured.err + captured.out
    assert captured.err.startswith("error: ")
    return captured.err


def test_the_files_of_a_simulation(case_file, tmp_path, capsys):
    out = tmp_path / "deep" / "result"
    assert main(["simulate", str(case_file), "--out", str(out)]) == 0
    assert files(out) == {"trace.csv", "summary.json", "trace.png"}
    assert files(tmp_path) == {"case.toml", *(f"deep/result/{name}" for name in files(out))}

    header = (out / "trace.csv").read_text().splitlines()[0]
    assert header == "time [s],Fx [N],Fy [N],Fz [N],x [m],y [m]"
    table = np.loadtxt(out / "trace.csv", delimiter=",", skiprows=1)
    sim = mx.simulate(mx.load_case(case_file))
    np.testing.assert_allclose(table[:, 0], sim.time, rtol=1e-9)
    np.testing.assert_allclose(table[:, 1:4], sim.force, rtol=1e-9)
    np.testing.assert_allclose(table[:, 4:], sim.displacement, rtol=1e-9)

    summary = json.loads((out / "summary.json").read_text())
    assert summary["mean_force.y"]["unit"] == "N"
    assert summary["mean_force.y"]["value"] > 0
    assert (out / "trace.png").read_bytes().startswith(b"\x89PNG")
    # Plain lines where nobody looks at a terminal.
    printed = capsys.readouterr().out
    assert f"mean_force.y: {summary['mean_force.y']['value']:.4g} N" in printed.splitlines()
    assert "\x1b" not in printed


def test_the_wall_of_a_cut_that_leaves_one(case_file, tmp_path):
    out = tmp_path / "out"
    case_file.write_text(
        TEXT.replace("[structure]", '[stock]\ny = ["-20 mm", "0 mm"]\n[structure]').replace('"0.06 s"', '"0.16 s"')
    )
    assert main(["simulate", str(case_file), "--out", str(out)]) == 0
    assert files(out) == {"trace.csv", "summary.json", "trace.png", "surface.png"}
    summary = json.loads((out / "summary.json").read_text())
    assert "form_error.left" not in summary
    # The tool is pushed towards +y, away from the wall at its right.
    assert 0 < summary["form_error.right"]["value"] < 1e-3
    assert summary["phase_II.begin"]["value"] == pytest.approx(0.15, abs=5e-3)


def test_chip_thickness_on_request(case_file, tmp_path):
    assert main(["simulate", str(case_file), "--out", str(tmp_path / "out"), "--chip-thickness"]) == 0
    with open(tmp_path / "out" / "trace.csv") as file:
        assert file.readline().strip().endswith("y [m],h1 [m],h2 [m],h3 [m],h4 [m]")
        assert len(file.readline().split(",")) == 10


def test_a_rigid_tool(case_file, tmp_path):
    start, end = TEXT.index("[structure]"), TEXT.index("[simulation]")
    case_file.write_text(TEXT[:start] + TEXT[end:])
    assert main(["simulate", str(case_file), "--out", str(tmp_path / "out")]) == 0
    with open(tmp_path / "out" / "trace.csv") as file:
        assert file.readline().strip() == "time [s],Fx [N],Fy [N],Fz [N]"


def test_results_replace_those_of_an_earlier_run_and_nothing_else(case_file, tmp_path):
    out = tmp_path / "out"
    out.mkdir()
    (out / "trace.csv").write_text("old")
    (out / "notes.txt").write_text("mine")
    assert main(["simulate", str(case_file), "--out", str(out)]) == 0
    assert files(out) == {"trace.csv", "summary.json", "trace.png", "notes.txt"}
    assert (out / "trace.csv").read_text().startswith("time [s]")


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("hs =", "hz =", "force.hz is not a key of [force]. Did you mean hs?"),
        ('k0 = "5000 N/mm^2"', "", "force.k0 is missing"),
        ("5000 N/mm^2", "5000 N", 'force.k0: "5000 N" given'),
        ('"20 mm"', '"-20 mm"', 'tool.diameter: "-20 mm" given; it must be greater than 0'),
        ('"1 mm"', '"-1 mm"', 'cut.depth: "-1 mm" given; it must be greater than 0'),
        ("teeth = 4", "teeth = 0", "tool.teeth: 0 given; it must be a whole number of at least 1"),
        ("[simulation]", "[simulation]\nsteps_per_tooth = 5", "simulation.steps_per_tooth: 5 given"),
        ('"100 kg"', '"1 mg"', "simulation.steps_per_tooth: 40 given; the fastest mode"),
        ("[force]", "[force", "not valid TOML"),
    ],
)
def test_bad_input_has_exit_code_2_and_leaves_no_file(case_file, tmp_path, capsys, old, new, words):
    assert old in TEXT
    case_file.write_text(TEXT.replace(old, new))
    message = refuse(["simulate", case_file, "--out", tmp_path / "out"], capsys, 2)
    assert f"error: {case_file}: " in message
    assert words in message
    assert files(tmp_path) == {"case.toml"}
    assert not (tmp_path / "out").exists()


def test_a_case_that_is_not_there(tmp_path, capsys):
    message = refuse(["simulate", tmp_path / "nothing.toml", "--out", tmp_path / "out"], capsys, 2)
    assert "nothing.toml: the case file cannot be read: No such file" in message
    assert not (tmp_path / "out").exists()


def test_a_file_where_the_directory_should_be(case_file, tmp_path, capsys):
    (tmp_path / "out").write_text("mine")
    message = refuse(["simulate", case_file, "--out", tmp_path / "out"], capsys, 2)
    assert "give a directory" in message
    assert (tmp_path / "out").read_text() == "mine"


def test_a_deflection_larger_than_the_tool_radius_has_exit_code_1(case_file, tmp_path, capsys):
    case_file.write_text(TEXT.replace('"3e5 N/m"', '"100 N/m"').replace('"100 kg"', '"1 kg"'))
    message = refuse(["simulate", case_file, "--out", tmp_path / "out"], capsys, 1)
    assert "radius" in message
    assert files(tmp_path) == {"case.toml"}


def test_an_interrupt_leaves_no_file(case_file, tmp_path, capsys, monkeypatch):
    def interrupted(case):
        raise KeyboardInterrupt

    monkeypatch.setattr(_simulate_command, "simulate", interrupted)
    message = refuse(["simulate", case_file, "--out", tmp_path / "out"], capsys, 130)
    assert "interrupted" in message
    assert files(tmp_path) == {"case.toml"}


@pytest.mark.parametrize("arguments", [[], ["simulate"], ["simulate", "case.toml"], ["mill", "case.toml"]])
def test_a_wrong_command_line_has_exit_code_2(arguments, capsys):
    with pytest.raises(SystemExit) as stop:
        main(arguments)
    assert stop.value.code == 2
    assert "usage: millax" in capsys.readouterr().err


def test_the_command_line_computes_in_double_precision(case_file, tmp_path):
    """In a process of its own, where no test has enabled it."""
    out = tmp_path / "out"
    environment = {name: value for name, value in os.environ.items() if name not in ("JAX_ENABLE_X64", "XLA_FLAGS")}
    command = [sys.executable, "-m", "identification.cli", "simulate", str(case_file), "--out", str(out)]
    subprocess.run(command, check=True, capture_output=True, env=environment, cwd=Path(__file__).parents[1])
    table = np.loadtxt(out / "trace.csv", delimiter=",", skiprows=1)
    np.testing.assert_allclose(np.diff(table[:, 0]), 0.06 / 1600, rtol=1e-5)
    sim = mx.simulate(mx.load_case(case_file))
    for found, expected in ((table[:, 1:4], sim.force), (table[:, 4:], sim.displacement)):
        # Where the thickness hardly changes in a step, the mean of the law loses half of its digits; single precision would
        # leave none of these.
        np.testing.assert_allclose(found, expected, rtol=1e-7, atol=1e-8 * np.abs(expected).max())


def test_a_warning_is_a_line_for_the_user(tmp_path, capsys):
    path = tmp_path / "cut.toml"
    path.write_text(TEXT.replace("teeth = 4", 'teeth = 4\nrunout = ["0 um", "150 um", "0 um", "0 um"]'))
    assert main(["simulate", str(path), "--out", str(tmp_path / "out")]) == 0
    assert "note: tool: its teeth differ in radius by 150 µm" in capsys.readouterr().out
