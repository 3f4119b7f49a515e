"""The notebooks run as scripts, from the directory in which Jupyter opens them."""

import os
import subprocess
import sys
from pathlib import Path

import jupytext
import pytest

NOTEBOOKS = sorted((Path(__file__).parents[1] / "notebooks").glob("*.py"))


LONG = ("02", "03", "04", "05", "06", "07", "08", "10")
"""Notebooks that take half a minute and more each."""


def _marked(path: Path):
    return pytest.param(path, marks=pytest.mark.long) if path.stem.startswith(LONG) else path


@pytest.mark.parametrize("path", [_marked(path) for path in NOTEBOOKS], ids=[path.stem for path in NOTEBOOKS])
def test_a_notebook_runs(path):
    environment = os.environ | {"MPLBACKEND": "Agg"}
    run = subprocess.run([sys.executable, path.name], cwd=path.parent, env=environment, capture_output=True, text=True)
    assert run.returncode == 0, run.stderr


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_opens_in_jupyter(path):
    cells = jupytext.read(path).cells
    assert cells[0].cell_type == "markdown"
    assert {cell.cell_type for cell in cells} == {"markdown", "code"}
