"""What is compiled again, and how long the demo takes."""

import subprocess
import sys
import tempfile
import time
from pathlib import Path

import equinox as eqx
import jax

import millax as mx

from ..figures import Figure, below
from ..slot import slot

ROOT = Path(__file__).resolve().parents[2]


def figures():
    yield _traces()
    yield from _demo()


def _traces():
    """Compilations of one simulation when every number of the case changes, three times."""
    count = 0

    class Counted(mx.FractionalLaw):
        def work(self, low, high):
            nonlocal count
            count += 1
            return super().work(low, high)

    case = eqx.tree_at(lambda c: c.force, slot(duration=0.01), Counted(5e9, 18e-6, 0.1, 0.3))
    mx.simulate(case)
    first = count
    for factor in (1.01, 1.02, 1.03):
        mx.simulate(jax.tree.map(lambda leaf, f=factor: leaf * f if eqx.is_inexact_array(leaf) else leaf, case))
    return Figure("compilations when only numbers change", f"{count - first}", "0", count == first)


def _demo():
    with tempfile.TemporaryDirectory() as folder:
        begin = time.perf_counter()
        run = subprocess.run(
            [sys.executable, "-m", "identification.cli", "fit", "data_synthetic/kr240_slot.toml", "--out", folder],
            cwd=ROOT,
            capture_output=True,
            text=True,
            check=False,
        )
        seconds = time.perf_counter() - begin
        yield Figure("demo: exit code", str(run.returncode), "0", run.returncode == 0)
        yield below("demo: wall time after installation", seconds, 60.0, form=".0f", unit=" s")
