"""millax: a differentiable model of robotic milling."""

from ._case import Case
from ._casefile import CaseError, CaseFile, load_case
from ._cut import Cut
from ._forces import ExponentialLaw, ForceLaw, FractionalLaw, LinearLaw
from ._settings import Settings
from ._simulate import STATUS, Simulation, SimulationError, simulate
from ._stock import Stock
from ._structure import Structure
from ._summary import summarize
from ._tool import EndMill

__all__ = [
    "STATUS",
    "Case",
    "CaseError",
    "CaseFile",
    "Cut",
    "EndMill",
    "ExponentialLaw",
    "ForceLaw",
    "FractionalLaw",
    "LinearLaw",
    "Settings",
    "Simulation",
    "SimulationError",
    "Stock",
    "Structure",
    "load_case",
    "simulate",
    "summarize",
]
