"""A fit beside SciPy's `least_squares` with finite differences on the same simulation."""

import time
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from scipy.optimize import least_squares

import millax as mx
from identification import Parameter, fit, load_fit
from identification._compare import compare
from identification._parameters import free
from millax._names import replace, value_of

from ..demo import cut, recorded
from ..figures import Figure, below
from .run import Run

DEMO = Path(__file__).resolve().parents[2] / "data_synthetic" / "kr240_slot.toml"


NAMES = ("force.k0", "force.hs", "force.r", "force.kr", "structure.damping_ratio.x", "structure.stiffness.x")


def figures(run: Run):
    yield from _one_second()
    yield from _beside_scipy()


def _one_second():
    """Six parameters, each guess wrong by a factor of two, from 1 s of cutting at every step of the simulation."""
    case = cut(1.0)
    trace = recorded(case, 0)
    wrong = zip(NAMES, (2, 0.5, 2, 0.5, 2, 0.5), strict=True)
    parameters = [Parameter(name, factor * value_of(case, name)) for name, factor in wrong]
    result, seconds, first = _twice(lambda: fit(case, trace, parameters))
    what = f"fit of {len(NAMES)} parameters to 1 s, {trace.values.shape[0]} samples of 4 channels"
    yield below(f"{what}: time, compiled before ({result.iterations} evaluations)", seconds, 2.0, form=".2f", unit=" s")
    yield below(f"{what}: the first time, compilation included", first, 15.0, form=".1f", unit=" s")


def _beside_scipy():
    problem = load_fit(DEMO)
    ours, seconds, first = _twice(lambda: fit(problem.cases, problem.traces, problem.parameters))
    (theirs, simulations), scipy_seconds, _ = _twice(_scipy(problem, ours.case.settings.sweeps))
    (trace,) = problem.traces
    what = f"{len(problem.parameters)} parameters, {trace.values.size} numbers measured"
    yield Figure(f"fit, {what}: time, compiled before", f"{seconds:.2f} s", "", None)
    yield Figure("fit: the first time, compilation included", f"{first:.2f} s", "", None)
    yield Figure("fit: evaluations of simulation and Jacobian", f"{ours.iterations}", "", None)
    yield Figure("SciPy, finite differences: time, compiled before", f"{scipy_seconds:.2f} s", "", None)
    yield Figure("SciPy, finite differences: simulations", f"{simulations}", "", None)
    yield Figure("SciPy beside the fit", f"{scipy_seconds / seconds:.2f} ×", "", None)
    fitted = np.array([e.value for e in ours.parameters]) / [e.guess for e in ours.parameters]
    spread = np.array([e.std for e in ours.parameters]) / [e.guess for e in ours.parameters]
    apart = np.abs(np.exp(theirs.x) - fitted) / spread
    yield Figure("largest difference of the two estimates, in standard errors", f"{apart.max():.1e}", "", None)


def _twice(function):
    """The second result, its time [s], and the time of the first."""
    seconds = []
    for _ in range(2):
        begin = time.perf_counter()
        result = function()
        seconds.append(time.perf_counter() - begin)
    return result, seconds[1], seconds[0]


def _scipy(problem, sweeps: int):
    """The same least squares in logarithms of the parameters, from the same guess, with as many sweeps as `fit` needed."""
    case = problem.case.with_settings(sweeps=sweeps)
    numbers = free(case, list(problem.parameters))
    (trace,) = problem.traces
    comparison = compare(trace, case, numbers.names)
    sigma = np.array([trace.noise[channel] for channel in trace.channels])[:, None]
    names, guess = numbers.names, jnp.asarray(numbers.guess)

    @jax.jit
    def residuals(x):
        changed = replace(case, dict(zip(names, guess * jnp.exp(x), strict=True)))
        return ((comparison.predict(mx.simulate(changed, throw=False), changed) - comparison.measured) / sigma).ravel()

    def run():
        count = 0

        def counted(x):
            nonlocal count
            count += 1
            return np.asarray(residuals(x))

        return least_squares(counted, np.zeros(len(names))), count

    return run
