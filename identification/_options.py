"""How a fit is made, apart from what it is asked: as the table [fit] of a case file says it, or arguments of `fit`."""

import difflib
import math
from dataclasses import dataclass, field

from millax._units import show

from ._noise import NoiseModel
from ._solver import SOLVERS
from ._starts import SPREAD


@dataclass(frozen=True)
class Options:
    """How a fit is made: as of `fit`; whether profiles are wanted, and how many draws of the posterior."""

    noise: NoiseModel = field(default_factory=NoiseModel)
    solver: str = "optimistix_lm"
    starts: int = 1
    spread: float = SPREAD
    seed: int = 0
    profile: bool = False
    posterior: int = 0

    def __post_init__(self):
        if self.solver not in SOLVERS:
            near = difflib.get_close_matches(str(self.solver), SOLVERS, n=1)
            choice = f"t must be one of {', '.join(SOLVERS)}"
            words = f". Did you mean {near[0]}? I{choice}" if near else f"; i{choice}"
            raise ValueError(f"solver: {self.solver!r} given{words}")
        for name, least in (("starts", 1), ("seed", 0), ("posterior", 0)):
            value = getattr(self, name)
            if isinstance(value, bool) or not isinstance(value, int) or value < least:
                raise ValueError(f"{name}: {show(value)} given; it must be a whole number of at least {least}")
        if isinstance(self.spread, bool) or not isinstance(self.spread, int | float) or not 1 < self.spread < math.inf:
            raise ValueError(f"spread: {show(self.spread)} given; it must be a factor greater than 1, such as 5")
        if not isinstance(self.profile, bool):
            raise ValueError(f"profile: {show(self.profile)} given; it must be true or false")
