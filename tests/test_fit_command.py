"""`millax fit`: files, exit codes, and nothing left behind when the input cannot be used."""

import json

import numpy as np
import pytest
from cases import SLOT_FILE

import millax as mx
from identification import Parameter, _command, load_fit, load_result
from identification.cli import main

CASE = f"""\
{SLOT_FILE}
[simulation]
duration = "0.03 s"
"""
QUESTION = """
[fit.free]
force.k0 = { guess = "8 kN/mm^2", bounds = ["1 kN/mm^2", "none"] }
"force.kr" = 0.5
[fit.truth]
force = { k0 = "5000 N/mm^2", kr = 0.3 }
[[trace]]
file = "trace.csv"
channels = ["Fx", "Fy"]
noise = { Fx = "2 N" }
"""


@pytest.fixture(scope="module")
def trace_text():
    """What `millax simulate` writes, with noise."""
    case = mx.CaseFile.from_text(CASE).case
    sim = mx.simulate(case)
    force = np.asarray(sim.force) + np.random.default_rng(3).normal(scale=2.0, size=sim.force.shape)
    rows = [f"{t:.9g},{x:.6g},{y:.6g},0" for t, (x, y, _) in zip(sim.time, force, strict=True)]
    return "\n".join(["time [s],Fx [N],Fy [N],Fz [N]", *rows]) + "\n"


@pytest.fixture
def make(tmp_path, trace_text):
    """Write a case file and its trace, with replacements."""

    def make(changes=(), trace=trace_text):
        text = CASE + QUESTION
        for old, new in changes:
            assert old in text
            text = text.replace(old, new)
        if trace is not None:
            (tmp_path / "trace.csv").write_text(trace, encoding="utf-8")
        path = tmp_path / "case.toml"
        path.write_text(text, encoding="utf-8")
        return path

    return make


def run(path, out):
    return main(["fit", str(path), "--out", str(out)])


def test_the_question_of_a_file(make):
    problem = load_fit(make())
    assert [p.name for p in problem.parameters] == ["force.k0", "force.kr"]
    assert problem.parameters[0].guess == "8 kN/mm^2"
    assert problem.parameters[0].bounds == ("1 kN/mm^2", None)
    assert isinstance(problem.parameters[1], Parameter)
    assert problem.truth == {"force.k0": pytest.approx(5e9), "force.kr": 0.3}
    assert problem.traces[0].channels == ("Fx", "Fy")
    assert problem.traces[0].noise == {"Fx": 2.0}


def test_a_fit_writes_what_was_found(make, tmp_path, capsys):
    path, out = make(), tmp_path / "out"
    assert run(path, out) == 0
    assert {file.name for file in out.iterdir()} == {"result.json", "fitted.toml", "report.html", "result.h5"}
    result = json.loads((out / "result.json").read_text(encoding="utf-8"))
    assert load_result(out / "result.h5").to_json() == result
    assert result["status"] == "converged"
    k0, kr = result["parameters"]
    assert (k0["name"], k0["unit"], k0["at_bound"], k0["identifiable"]) == ("force.k0", "kN/mm^2", False, True)
    assert abs(k0["value"] - 5) < 4 * k0["std"]
    assert k0["ci95"][0] < k0["value"] < k0["ci95"][1]
    assert abs(kr["value"] - 0.3) < 4 * kr["std"]
    correlation = np.array(result["correlation"])
    np.testing.assert_allclose(np.diag(correlation), 1)
    (trace,) = result["traces"]
    assert trace["name"] == "trace.csv"
    assert set(trace["r2"]) == set(trace["rmse"]) == {"Fx", "Fy"}
    assert trace["r2"]["Fx"] > 0.98
    assert trace["noise"]["Fx"] == 2
    assert trace["noise_estimated"] == ["Fy"]
    assert trace["noise"]["Fy"] == pytest.approx(2, rel=0.15)
    assert result["iterations"] > 2
    assert result["seconds"] > 0
    assert {"millax", "jax", "optimistix"} <= set(result["versions"])
    assert result["seed"] is None

    fitted = mx.CaseFile.read(out / "fitted.toml")
    assert float(fitted.case.force.k0) == pytest.approx(k0["value"] * 1e9, rel=1e-9)
    assert "# per unit depth" in fitted.text
    assert fitted.leaf("force.k0").unit == "N/mm^2"
    assert int(mx.simulate(fitted.case).status) == 0

    printed = capsys.readouterr().out
    assert "compiling" in printed
    assert "fit: iteration 2, cost" in printed
    assert "converged: All 2 parameters found." in printed


@pytest.mark.long
def test_the_fitted_case_has_the_sweeps_that_the_fit_needed(make, tmp_path):
    structure = '[structure]\naxes = ["x"]\nmass = "100 kg"\nstiffness = "1e8 N/m"\ndamping_ratio = 0.05\n'
    case = make([("[simulation]\n", f"{structure}[simulation]\nsweeps = 1   # too few\n")])
    assert int(mx.simulate(mx.load_case(case), throw=False).status) == 1
    main(["fit", str(case), "--out", str(tmp_path / "fit")])
    assert int(mx.simulate(mx.load_case(tmp_path / "fit" / "fitted.toml"), throw=False).status) == 0


def test_an_answer_that_is_no_is_exit_code_1_and_written(make, tmp_path):
    path, out = make([('"force.kr" = 0.5', "cut.depth = {}")]), tmp_path / "out"
    assert run(path, out) == 1
    result = json.loads((out / "result.json").read_text(encoding="utf-8"))
    assert result["status"] == "not_identifiable"
    assert result["parameters"][0]["std"] is None
    assert result["parameters"][0]["ci95"] is None
    assert "cannot be told apart" in result["parameters"][0]["reason"]
    assert result["correlation"] == [[None, None], [None, None]]
    assert "cannot be told apart" in (out / "report.html").read_text(encoding="utf-8")


def test_a_fit_that_cannot_start_leaves_no_fitted_case(make, tmp_path):
    path, out = (
        make([('"force.kr" = 0.5', 'cut.start.y = "0 mm"'), ("[simulation]", 'start = ["-10 mm", "0 mm"]\n[simulation]')]),
        tmp_path / "out",
    )
    out.mkdir()
    (out / "fitted.toml").write_text("from an earlier run")
    assert run(path, out) == 1
    assert {file.name for file in out.iterdir()} == {"result.json", "report.html", "result.h5"}
    assert "do not depend on cut.start.y" in json.loads((out / "result.json").read_text(encoding="utf-8"))["message"]


def test_ctrl_c_saves_the_best_so_far(make, tmp_path, monkeypatch):
    def interrupted(progress):
        if progress.iteration == 3:
            raise KeyboardInterrupt
        return "line"

    monkeypatch.setattr(_command, "_line", interrupted)
    out = tmp_path / "out"
    assert run(make(), out) == 130
    assert json.loads((out / "result.json").read_text(encoding="utf-8"))["status"] == "interrupted"
    assert (out / "fitted.toml").exists()


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ([('"8 kN/mm^2"', '"0.5 kN/mm^2"')], "guess 0.5 kN/mm^2 must lie strictly between 1 kN/mm^2"),
        ([('"8 kN/mm^2"', '"8 kN"')], "the unit kN cannot be converted"),
        ([('["1 kN/mm^2", "none"]', '["1 kN/mm^2"]')], 'they are two, "none" where there is none'),
        ([("guess =", "gues =")], "[fit.free.force.k0]: unknown key gues. Did you mean guess?"),
        ([("force.k0 = {", "force.k00 = {")], "did you mean force.k0"),
        ([("force.k0 = {", "structure.mass = {")], "unknown parameter"),
        ([('"force.kr" = 0.5', 'cut.start.y = "0 mm"')], "cut.start.y is not a number of this case file"),
        ([("[fit.free]", "[fit.fre]")], "[fit]: unknown key fre. Did you mean free?"),
        ([("[fit.truth]", "[fit.prior]")], "[fit]: unknown key prior"),
        ([("[fit.free]", '[fit]\nsolver = "scipy"\n[fit.free]')], "Did you mean scipy_trf? It must be one of optimistix_lm"),
        ([("[fit.free]", "[fit]\nstarts = 0\n[fit.free]")], "starts: 0 given; it must be a whole number of at least 1"),
        ([("[fit.free]", "[fit]\nspread = 1\n[fit.free]")], "spread: 1 given; it must be a factor greater than 1"),
        ([("[fit.free]", '[fit]\nprofile = "yes"\n[fit.free]')], "it must be true or false"),
        ([("[fit.free]", "[fit]\nnoise = { ordr = 1 }\n[fit.free]")], "unknown key ordr. Did you mean order?"),
        ([("[fit.free]", "[fit]\nnoise = { order = 99 }\n[fit.free]")], "order 99 given"),
        ([("force = { k0", "forces = { k0")], "forces.k0: unknown parameter"),
        ([("[[trace]]", "[trace]")], "there is no [[trace]]"),
        ([('file = "trace.csv"\n', "")], "file is missing"),
        ([('file = "trace.csv"', 'file = "none.csv"')], "none.csv: the trace cannot be read"),
        ([("channels =", "chanels =")], "unknown key chanels. Did you mean channels?"),
        ([('["Fx", "Fy"]', '"Fx"')], "it must be a list"),
        ([('["Fx", "Fy"]', '["Fx", "x"]'), ("\n[[", "\n[[")], "no column x"),
        ([('["Fx", "Fy"]', '["Fx", "Fz"]')], "channel Fz is zero throughout"),
        ([("Fx = ", "Fq = ")], "'Fq' is unknown"),
        ([('"0.03 s"', '"0.02 s"')], "Raise simulation.duration"),
        ([("teeth = 4", "teeth = 0")], "tool.teeth"),
    ],
)
def test_input_that_cannot_be_used_is_exit_code_2_and_leaves_nothing(make, tmp_path, capsys, changes, words):
    out = tmp_path / "out"
    assert _command.run_fit(make(changes), out) == 2
    assert not out.exists()
    captured = capsys.readouterr()
    # Long messages may be broken into lines.
    assert words in captured.err.replace("\n", " ").replace("  ", " ")
    assert "Traceback" not in captured.err


def test_no_fit_table(tmp_path, capsys):
    (tmp_path / "case.toml").write_text(CASE)
    assert run(tmp_path / "case.toml", tmp_path / "out") == 2
    assert "[fit.free] is missing" in capsys.readouterr().err


def test_a_trace_with_a_hole_is_exit_code_2(make, tmp_path, trace_text, capsys):
    lines = trace_text.splitlines()
    lines[7] = lines[7].replace(lines[7].split(",")[1], "NaN")
    assert run(make(trace="\n".join(lines)), tmp_path / "out") == 2
    assert "row 8, column Fx" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_a_fit_is_not_lost_when_writing_its_report_fails(make, tmp_path, monkeypatch):
    def full(*_, **__):
        raise OSError(28, "No space left on device", "report.html")

    monkeypatch.setattr(_command, "write_report", full)
    out = tmp_path / "out"
    assert run(make(), out) == 2
    assert {file.name for file in out.iterdir()} == {"result.h5"}
    assert load_result(out / "result.h5").success
