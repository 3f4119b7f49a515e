"""What float32 would save, and what it costs in accuracy."""

import warnings

import jax
import numpy as np

import millax as mx

from ..figures import Figure
from ..slot import slot
from ..timing import interleaved
from .run import Run


def figures(run: Run):
    case = slot(duration=run.duration)

    def single():
        with jax.enable_x64(False), warnings.catch_warnings():
            warnings.simplefilter("ignore")
            return mx.simulate(jax.tree.map(np.float32, case), throw=False)

    times = interleaved({"float64": lambda: mx.simulate(case), "float32": single}, max(3, run.rounds // 2))
    double, float32 = mx.simulate(case), single()
    for name in ("force", "displacement"):
        exact, rough = np.asarray(getattr(double, name)), np.asarray(getattr(float32, name))
        assert rough.dtype == np.float32
        error = np.abs(rough - exact)
        yield Figure(
            f"float32, {name}: largest error over the largest value", f"{error.max() / np.abs(exact).max():.1e}", "", None
        )
        rms = np.sqrt((error**2).mean() / (exact**2).mean())
        yield Figure(f"float32, {name}: root mean square error", f"{rms:.1e}", "", None)
    yield Figure("float32 beside float64: time", f"{times.ratio('float32', 'float64'):.2f} ×", "", None)
    run.bars["millax, float32"] = 1e9 * times.seconds("float32") / case.settings.steps
