"""identification: finding the parameters of a millax case from measured traces and deflections."""

import importlib
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from ._align import align
    from ._average import SynchronousAverage, synchronous_average
    from ._design import Design, Forecast, design
    from ._fit import fit
    from ._fitfile import FitProblem, load_fit
    from ._identifiability import Check, Prospect, check
    from ._loadtest import LoadTest, read_load_test
    from ._meanforce import mean_force_fit
    from ._meanresult import Coefficient, CutMeans, MeanForceFit
    from ._measured import TraceError
    from ._noise import NoiseModel
    from ._parameters import Parameter, Prior, Tie
    from ._posterior import sample
    from ._posterior_result import Posterior
    from ._profile import Profile, profile
    from ._quality import Finding, quality
    from ._recording import Recording
    from ._result import STATUS, Estimate, FitResult, TraceFit, load_result
    from ._running import Progress
    from ._solver import SOLVERS
    from ._starts import Waterfall
    from ._synthetic import synthetic_trace
    from ._traces import Trace, read_trace

__all__ = [
    "SOLVERS",
    "STATUS",
    "Check",
    "Coefficient",
    "CutMeans",
    "Design",
    "Estimate",
    "Finding",
    "FitProblem",
    "FitResult",
    "Forecast",
    "LoadTest",
    "MeanForceFit",
    "NoiseModel",
    "Parameter",
    "Posterior",
    "Prior",
    "Profile",
    "Progress",
    "Prospect",
    "Recording",
    "SynchronousAverage",
    "Tie",
    "Trace",
    "TraceError",
    "TraceFit",
    "Waterfall",
    "align",
    "check",
    "design",
    "fit",
    "load_fit",
    "load_result",
    "mean_force_fit",
    "profile",
    "quality",
    "read_load_test",
    "read_trace",
    "sample",
    "synchronous_average",
    "synthetic_trace",
]

_HOMES = {
    "_align": ("align",),
    "_design": ("Design", "Forecast", "design"),
    "_average": ("SynchronousAverage", "synchronous_average"),
    "_fit": ("fit",),
    "_fitfile": ("FitProblem", "load_fit"),
    "_identifiability": ("Check", "Prospect", "check"),
    "_loadtest": ("LoadTest", "read_load_test"),
    "_meanforce": ("mean_force_fit",),
    "_meanresult": ("Coefficient", "CutMeans", "MeanForceFit"),
    "_measured": ("TraceError",),
    "_noise": ("NoiseModel",),
    "_parameters": ("Parameter", "Prior", "Tie"),
    "_profile": ("Profile", "profile"),
    "_posterior": ("sample",),
    "_posterior_result": ("Posterior",),
    "_quality": ("Finding", "quality"),
    "_recording": ("Recording",),
    "_running": ("Progress",),
    "_result": ("STATUS", "Estimate", "FitResult", "TraceFit", "load_result"),
    "_solver": ("SOLVERS",),
    "_starts": ("Waterfall",),
    "_synthetic": ("synthetic_trace",),
    "_traces": ("Trace", "read_trace"),
}


def __getattr__(name: str):
    # Loaded when asked for: the command line has to set XLA's environment before anything imports JAX.
    for home, names in _HOMES.items():
        if name in names:
            return getattr(importlib.import_module(f".{home}", __name__), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
