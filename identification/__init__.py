"""identification: finding the parameters of a millax case from measured traces."""

from ._fit import Progress, fit
from ._fitfile import FitProblem, load_fit
from ._parameters import Parameter
from ._result import STATUS, Estimate, FitResult, TraceFit
from ._traces import Trace, TraceError, read_trace

__all__ = [
    "STATUS",
    "Estimate",
    "FitProblem",
    "FitResult",
    "Parameter",
    "Progress",
    "Trace",
    "TraceError",
    "TraceFit",
    "fit",
    "load_fit",
    "read_trace",
]
