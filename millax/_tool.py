"""The cutter."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ._check import concrete, finite, not_negative, positive
from ._types import Scalar, as_number, optional

STEEPEST = np.deg2rad(75)
"""Largest helix angle [rad]."""


class EndMill(eqx.Module):
    """A cylindrical end mill with equally spaced teeth, straight and equal unless told otherwise.

    At a height z above its tip, tooth i of the turning tool stands at the angle theta_i(z) = 2 pi i/N_z - z tan(beta)/R
    from where tooth 0 has its tip, and its radius is

        R_i(z) = R + dR_i + rho cos(theta_i(z) - lambda).

    **Arguments:**

    - `diameter`: D = 2 R [m], > 0.
    - `teeth`: number of teeth N_z, an integer >= 1. Static: another number of teeth is another program.
    - `helix`: helix angle beta [rad], 0 to 75 degrees; the upper part of a tooth comes later. None: straight.
    - `runout`: deviation dR_i of the radius of each tooth [m], shape (teeth,). None: none.
    - `offset`: runout of the tool as a whole: distance rho of its axis from that of the spindle [m], >= 0. None: none.
    - `offset_angle`: direction lambda of that offset, from tooth 0 [rad]. Given with `offset`.

    Raises `ValueError` for numbers out of these ranges.
    """

    diameter: Scalar = eqx.field(converter=as_number)
    teeth: int = eqx.field(static=True)
    helix: Scalar | None = eqx.field(converter=optional, default=None)
    runout: Float[Array, " teeth"] | None = eqx.field(converter=optional, default=None)
    offset: Scalar | None = eqx.field(converter=optional, default=None)
    offset_angle: Scalar | None = eqx.field(converter=optional, default=None)

    def __check_init__(self):
        positive("tool.diameter", self.diameter, "m")
        if isinstance(self.teeth, bool) or not isinstance(self.teeth, int) or self.teeth < 1:
            raise ValueError(f"tool.teeth: {self.teeth!r} given; it must be a whole number of at least 1")
        if self.helix is not None:
            not_negative("tool.helix", self.helix, "rad")
            steep = concrete(self.helix)
            if steep is not None and np.any(steep > STEEPEST):
                raise ValueError(f"tool.helix: {float(steep):g} rad given; it must be at most {STEEPEST:.4g} rad (75 deg)")
        if self.runout is not None:
            finite("tool.runout", self.runout, "m")
            if self.runout.shape != (self.teeth,):
                raise ValueError(
                    f"tool.runout: shape {self.runout.shape} given; it is the deviation of the radius of each of the "
                    f"{self.teeth} teeth"
                )
        if (self.offset is None) != (self.offset_angle is None):
            raise ValueError("tool: give offset and offset_angle together, or neither")
        if self.offset is not None:
            not_negative("tool.offset", self.offset, "m")
            finite("tool.offset_angle", self.offset_angle, "rad")

    @property
    def radius(self) -> Scalar:
        """R = D/2 [m]."""
        return self.diameter / 2

    @property
    def equal_teeth(self) -> bool:
        """Whether all teeth are alike, so that every tooth period is like the one before."""
        return self.runout is None and self.offset is None

    def lag(self, z: Float[Array, "..."]) -> Float[Array, "..."]:
        """z tan(beta)/R [rad]: by which angle a tooth stands behind its tip at the height z [m]."""
        return jnp.zeros_like(z) if self.helix is None else z * jnp.tan(self.helix) / self.radius

    def deviation(self, lag: Float[Array, "..."]) -> Float[Array, "... teeth"] | None:
        """R_i - R [m] where a tooth stands `lag` [rad] behind its tip, None for equal teeth."""
        if self.equal_teeth:
            return None
        found = jnp.zeros((*jnp.shape(lag), self.teeth))
        if self.runout is not None:
            found = found + self.runout
        if self.offset is not None and self.offset_angle is not None:
            theta = jnp.arange(self.teeth) * (2 * np.pi / self.teeth) - lag[..., None] - self.offset_angle
            found = found + self.offset * jnp.cos(theta)
        return found
