"""millax: a differentiable model of robotic milling."""

from ._case import Case
from ._casefile import CaseError, CaseFile, load_case
from ._clock import Clock
from ._cut import Cut
from ._forces import ExponentialLaw, ForceLaw, FractionalLaw, LinearLaw
from ._program import use_all_cores
from ._reductions import REDUCTIONS, Reduction
from ._runtime import set_up
from ._sensor import LowPass, Resonances, Sensor
from ._settings import Settings
from ._simulate import STATUS, Simulation, SimulationError, simulate
from ._stability import STABILITY_METHODS, StabilityProgress, limit_depth, spectral_radius, stability
from ._stock import Stock
from ._structure import Structure
from ._summary import summarize
from ._surface import Roughness, Wall, form_error, phases, roughness, wall_profile, walls
from ._sweep import SweepProgress, sweep
from ._tool import EndMill
from ._values import Values, sample

__all__ = [
    "REDUCTIONS",
    "STABILITY_METHODS",
    "STATUS",
    "Case",
    "CaseError",
    "CaseFile",
    "Clock",
    "Cut",
    "EndMill",
    "ExponentialLaw",
    "ForceLaw",
    "FractionalLaw",
    "LinearLaw",
    "LowPass",
    "Reduction",
    "Resonances",
    "Roughness",
    "Sensor",
    "Settings",
    "Simulation",
    "SimulationError",
    "StabilityProgress",
    "Stock",
    "Structure",
    "SweepProgress",
    "Values",
    "Wall",
    "form_error",
    "limit_depth",
    "load_case",
    "phases",
    "roughness",
    "sample",
    "set_up",
    "simulate",
    "spectral_radius",
    "stability",
    "summarize",
    "sweep",
    "use_all_cores",
    "wall_profile",
    "walls",
]
