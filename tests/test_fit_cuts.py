"""`millax fit` over several cuts, each with its own case and with shared parameters."""

import json

import numpy as np
import pytest
from cases import SLOT_FILE

import millax as mx
from identification import load_fit
from identification.cli import main

CASE = f"""\
{SLOT_FILE}start = ["20 mm", 0]
[simulation]
duration = "20 ms"
"""
QUESTION = """
[fit.free]
force.k0 = "8 kN/mm^2"
force.hs = "30 um"
[[trace]]
file = "first.csv"
noise = { Fx = "2 N", Fy = "2 N" }
[[trace]]
file = "second.csv"
noise = { Fx = "2 N", Fy = "2 N" }
case = { cut.feed_rate = "1 m/min", tool.diameter = "16 mm" }
"""


def measured(case: mx.Case, seed: int) -> str:
    sim = mx.simulate(case)
    force = np.asarray(sim.force)[:, :2] + np.random.default_rng(seed).normal(scale=2, size=(len(sim.time), 2))
    rows = [f"{t:.9g},{x:.9g},{y:.9g}" for t, (x, y) in zip(sim.time, force, strict=True)]
    return "\n".join(["time [s],Fx [N],Fy [N]", *rows]) + "\n"


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A case file with its two traces."""
    folder = tmp_path_factory.mktemp("cuts")
    (folder / "case.toml").write_text(CASE + QUESTION, encoding="utf-8")
    for name in ("first.csv", "second.csv"):  # to read the cases of the file, any trace will do
        (folder / name).write_text("time [s],Fx [N]\n" + "".join(f"{1e-4 * i},1\n" for i in range(200)), encoding="utf-8")
    text = (CASE + QUESTION).replace(', Fy = "2 N"', "")
    (folder / "read.toml").write_text(text, encoding="utf-8")
    for i, case in enumerate(load_fit(folder / "read.toml").cases):
        (folder / ("first.csv", "second.csv")[i]).write_text(measured(case, i), encoding="utf-8")
    return folder


def test_every_trace_has_its_case(folder):
    problem = load_fit(folder / "case.toml")
    first, second = problem.cases
    assert first is problem.case
    assert float(second.cut.feed_rate) == pytest.approx(1 / 60)
    assert float(second.tool.radius) == pytest.approx(8e-3)
    assert float(second.cut.depth) == float(first.cut.depth)


def test_one_fit_finds_what_the_cuts_share(folder, tmp_path):
    out = tmp_path / "out"
    assert main(["fit", str(folder / "case.toml"), "--out", str(out)]) == 0
    result = json.loads((out / "result.json").read_text(encoding="utf-8"))
    for e, true in zip(result["parameters"], (5, 18), strict=True):
        assert abs(e["value"] - true) < 4 * e["std"]
    assert [trace["name"] for trace in result["traces"]] == ["first.csv", "second.csv"]
    fitted = mx.load_case(out / "fitted.toml")
    assert float(fitted.force.hs) == pytest.approx(1e-6 * result["parameters"][1]["value"])
    assert "second.csv" in (out / "report.html").read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("cut.feed_rate = ", "cut.feed = ", ["[[trace]] 2, case: cut.feed is not a key of [cut]", "feed_rate"]),
        ('"1 m/min"', '"1 m"', ["[[trace]] 2, case: cut.feed_rate"]),
        ('cut.feed_rate = "1 m/min"', "force.k0 = 5e9", ["force.k0 given", "force.k0 is free"]),
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
