"""The traces that come with the repository: they are what their generator makes, and the truth can be found in them."""

import subprocess
import sys
from pathlib import Path

import pytest

from identification import fit, load_fit
from millax._names import value_of

DATA = Path(__file__).parents[1] / "data_synthetic"
CASES = sorted(DATA.glob("*.toml"))


def test_regenerating_gives_the_same_bytes(tmp_path):
    subprocess.run([sys.executable, DATA / "generate.py", "--out", tmp_path], check=True)
    made = {file.name: file.read_bytes() for file in tmp_path.iterdir()}
    assert made == {file.name: file.read_bytes() for file in DATA.glob("*.csv")}


@pytest.mark.parametrize("path", CASES, ids=lambda path: path.stem)
def test_the_truth_is_found(path):
    problem = load_fit(path)
    result = fit(problem.cases, problem.traces, problem.parameters)
    assert result.success, result.message
    assert set(problem.truth) == {estimate.name for estimate in result.parameters}
    for name, true in problem.truth.items():
        guess, found = value_of(problem.case, name), value_of(result.case, name)
        # The relative standard error; it does not depend on the unit in which the estimate is given.
        error = result[name].std / result[name].value
        assert max(guess / true, true / guess) > 1.85, "the guess is to be wrong by a factor of about two"
        assert error < 0.01
        assert abs(found / true - 1) < min(3 * error, 0.01)
    (trace,) = result.traces
    for channel, rmse in trace.rmse.items():
        # 12 000 samples of white noise: their standard deviation is known to 0.65 %.
        assert rmse / trace.sigma[channel] == pytest.approx(1, abs=0.02)
