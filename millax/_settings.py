"""Numerical settings: how the model is computed, never what it is."""

import equinox as eqx

from ._check import not_negative
from ._types import Scalar, as_number


class Settings(eqx.Module):
    """How long and how finely to simulate.

    **Arguments** (all static but `width`):

    - `periods`: tooth periods simulated, >= 1. The trace has periods * steps_per_tooth samples.
    - `steps_per_tooth`: time steps per tooth period, >= 10. The scheme is second order; at 40 the force error is below
      0.2 % (`make validate`).
    - `passes`: earlier tooth passes remembered, >= 1. One is enough while no tooth loses contact.
    - `blocks`: parts into which a tooth period is cut, a divisor of steps_per_tooth. Each is computed at once.
    - `sweeps`: fixed-point sweeps per block, >= 1. `Settings.suited` chooses `blocks` and `sweeps`; the residual that the
      last sweep leaves is part of every result.
    - `width`: half-width of the smoothed gates [m], >= 0; small against h_s and the feed per tooth. The bias of the mean
      force at the default is below 0.3 % (`make validate`); 0 is the hard model.
    """

    periods: int = eqx.field(static=True)
    steps_per_tooth: int = eqx.field(static=True, default=40)
    passes: int = eqx.field(static=True, default=3)
    blocks: int = eqx.field(static=True, default=1)
    sweeps: int = eqx.field(static=True, default=4)
    width: Scalar = eqx.field(converter=as_number, default=1e-6)

    def __check_init__(self):
        for name, least in (("periods", 1), ("steps_per_tooth", 10), ("passes", 1), ("blocks", 1), ("sweeps", 1)):
            value = getattr(self, name)
            if isinstance(value, bool) or not isinstance(value, int) or value < least:
                raise ValueError(f"simulation.{name}: {value!r} given; it must be a whole number of at least {least}")
        if self.steps_per_tooth % self.blocks:
            raise ValueError(
                f"simulation.blocks: {self.blocks} given; it must divide steps_per_tooth ({self.steps_per_tooth})"
            )
        not_negative("simulation.width", self.width, "m")

    @property
    def steps(self) -> int:
        """Number of samples of every trace."""
        return self.periods * self.steps_per_tooth
