"""The clock of a trace, which is not that of a simulation."""

import equinox as eqx
import numpy as np
from jaxtyping import Array, Float

from ._check import finite
from ._types import Scalar, as_number


class Clock(eqx.Module):
    """When, in the time of the simulation, a sample of a trace was taken:

        t_sim = start + (1 + speed_error) (t - t_1),

    t the time stamp of the sample and t_1 that of the first one. In the time of the simulation the spindle turns exactly at
    its speed and the first tooth points along the feed at 0: so `start` is the spindle phase of a trace within a cut, up to
    whole turns, and `speed_error` is that of the spindle, where it is small.

    **Arguments:**

    - `start`: [s].
    - `speed_error`: true over commanded spindle speed, less 1 [-], > -1.

    Raises `ValueError` for numbers that are not finite.
    """

    start: Scalar = eqx.field(converter=as_number, default=0.0)
    speed_error: Scalar = eqx.field(converter=as_number, default=0.0)

    def __check_init__(self):
        for name, unit in (("start", "s"), ("speed_error", "")):
            value = getattr(self, name)
            if value.shape != ():
                raise ValueError(f"clock.{name}: shape {value.shape} given; it must be one number")
            finite(f"clock.{name}", value, unit)

    def __call__(self, time: Float[Array | np.ndarray, " samples"]) -> Float[Array, " samples"]:
        """Times of the simulation [s] for those of a trace [s]."""
        return self.start + (1 + self.speed_error) * (time - time[0])
