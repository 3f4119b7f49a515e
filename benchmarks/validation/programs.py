"""What is compiled again, and how long the demo takes."""

import os
import re
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import equinox as eqx
import jax

import millax as mx
from identification import load_result

from ..figures import Figure, below
from ..slot import slot

ROOT = Path(__file__).resolve().parents[2]


def figures():
    yield _traces()
    yield from _demo()
    yield from _killed()


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


DEMO = [sys.executable, "-m", "identification.cli", "fit", "data_synthetic/kr240_slot.toml", "--out"]


def _demo():
    with tempfile.TemporaryDirectory() as folder:
        begin = time.perf_counter()
        run = subprocess.run(
            [*DEMO, folder],
            cwd=ROOT,
            capture_output=True,
            text=True,
            check=False,
        )
        seconds = time.perf_counter() - begin
        yield Figure("demo: exit code", str(run.returncode), "0", run.returncode == 0)
        yield below("demo: wall time after installation", seconds, 60.0, form=".0f", unit=" s")


def _killed():
    """The demo, killed at its tenth iteration, and run again."""
    with tempfile.TemporaryDirectory() as apart, tempfile.TemporaryDirectory() as folder:
        quiet = {"cwd": ROOT, "stdout": subprocess.DEVNULL, "check": True}
        subprocess.run([*DEMO, apart], **quiet)
        whole = load_result(Path(apart) / "result.h5")
        run = subprocess.Popen(
            [*DEMO, folder], cwd=ROOT, env=os.environ | {"PYTHONUNBUFFERED": "1"}, stdout=subprocess.PIPE, text=True
        )
        assert run.stdout
        for line in run.stdout:
            at = re.match(r"fit: iteration (\d+)", line)
            if at and int(at[1]) >= 10:
                run.kill()
                break
        run.stdout.close()
        killed = run.wait() == -signal.SIGKILL
        subprocess.run([*DEMO, folder], **quiet)
        result = load_result(Path(folder) / "result.h5")
    resumed = re.search(r"Resumed after (\d+) iterations", result.message)
    saved = int(resumed[1]) if resumed else 0
    what = "demo: killed at its tenth iteration and run again, iterations not done again"
    yield Figure(what, f"{saved} of {result.iterations}", "> 0", killed and saved > 0)
    off = [abs(a.value - b.value) / b.std for a, b in zip(result.parameters, whole.parameters, strict=True) if b.std]
    yield below("demo: its estimates beside those of a fit left alone, in standard errors", max(off), 1e-3)
