"""The cutter."""

import equinox as eqx

from ._check import positive
from ._types import Scalar, as_number


class EndMill(eqx.Module):
    """A straight-fluted end mill with equally spaced teeth.

    **Arguments:**

    - `diameter`: D [m], > 0.
    - `teeth`: number of teeth N_z, an integer >= 1. Static: another number of teeth is another program.

    Raises `ValueError` for a diameter that is not positive or fewer than one tooth.
    """

    diameter: Scalar = eqx.field(converter=as_number)
    teeth: int = eqx.field(static=True)

    def __check_init__(self):
        positive("tool.diameter", self.diameter, "m")
        if isinstance(self.teeth, bool) or not isinstance(self.teeth, int) or self.teeth < 1:
            raise ValueError(f"tool.teeth: {self.teeth!r} given; it must be a whole number of at least 1")

    @property
    def radius(self) -> Scalar:
        """R = D/2 [m]."""
        return self.diameter / 2
