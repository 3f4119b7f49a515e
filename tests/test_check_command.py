"""`millax check`: what the measurements of a case file can say, before any fit."""

import numpy as np
import pytest
from cases import SLOT_FILE

import millax as mx
from identification import check, load_fit, synthetic_trace
from identification.cli import main

CASE = f"""\
{SLOT_FILE.replace("teeth = 4", "teeth = 2")}start = ["20 mm", 0]
[simulation]
duration = "60 ms"
[fit.free]
force.k0 = "8 kN/mm^2"
force.hs = "30 um"
"""
TRACE = '[[trace]]\nfile = "trace.csv"\nnoise = { Fx = "2 N", Fy = "2 N" }\n'


@pytest.fixture
def problem(tmp_path):
    """Write a case file with more in it, and its trace with some samples changed."""

    def problem(more="", change=lambda values: values):
        case = mx.CaseFile.from_text(CASE).case
        time = (np.arange(case.settings.steps) + 0.5) * float(case.cut.tooth_period(case.tool)) / 40
        trace = synthetic_trace(case, time, ("Fx", "Fy"), {"Fx": 2.0, "Fy": 2.0}, 0)
        values = change(trace.values.copy())
        rows = [f"{t:.9g},{x:.9g},{y:.9g}" for t, (x, y) in zip(trace.time, values, strict=True)]
        (tmp_path / "trace.csv").write_text("\n".join(["time [s],Fx [N],Fy [N]", *rows]) + "\n", encoding="utf-8")
        (tmp_path / "case.toml").write_text(CASE + more + TRACE, encoding="utf-8")
        return tmp_path / "case.toml"

    return problem


def test_what_can_be_known_is_said_with_its_error(problem, capsys):
    path = problem()
    assert main(["check", str(path)]) == 0
    shown = capsys.readouterr().out
    assert "The measurements determine all 2 parameters." in shown
    assert "force.k0: guess 8.000 kN/mm^2, expected standard error 0.0" in shown
    assert "force.k0 and force.hs are hard to tell apart: correlation -0.9" in shown
    found = load_fit(path)
    asked = check(found.cases, found.traces, found.parameters)
    assert f"condition number {asked.condition:.3g}" in shown
    (pair,) = asked.pairs(0.9)
    assert pair == ("force.k0", "force.hs", asked.correlation[0, 1])
    assert asked.pairs(0.999999) == []
    # Two columns of length 1 at the angle a have singular values sqrt(1 +- cos a), and correlation -cos a.
    c = abs(asked.correlation[0, 1])
    assert asked.condition == pytest.approx(np.sqrt((1 + c) / (1 - c)), rel=1e-6)


def test_what_cannot_be_known_is_named_and_is_a_no(problem, capsys):
    assert main(["check", str(problem("cut.depth = {}\n"))]) == 1
    shown = capsys.readouterr().out
    assert "force.k0, cut.depth cannot be told apart" in shown
    assert "cut.depth: guess 1.000 mm, expected standard error not known" in shown


def cut_off(values):
    return np.minimum(values, 0.7 * values.max(axis=0))


def test_a_trace_that_is_saturated_is_a_no_and_a_warning_of_a_fit(problem, capsys, tmp_path):
    path = problem(change=cut_off)
    assert main(["check", str(path)]) == 1
    assert "warning: trace.csv: Fy" in capsys.readouterr().out
    main(["fit", str(path), "--out", str(tmp_path / "out")])
    assert "sensor, amplifier or converter is saturated" in capsys.readouterr().out


def test_input_that_cannot_be_used_is_an_error(problem, capsys, tmp_path):
    assert main(["check", str(problem("force.kk = {}\n"))]) == 2
    assert "force.kk: unknown parameter" in capsys.readouterr().err
    assert main(["check", str(tmp_path / "none.toml")]) == 2
