"""The cutter."""

from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ._check import concrete, finite, not_negative, positive
from ._types import Scalar, as_number, optional

STEEPEST = np.deg2rad(75)
"""Largest helix angle [rad]."""

TURN = 1e-5
"""What the pitch angles may miss of a turn [rad]: rounding, in a file or in single precision."""


class EndMill(eqx.Module):
    """A cylindrical end mill with straight, equal and equally spaced teeth unless told otherwise.

    At a height z above its tip, tooth i of the turning tool stands at the angle theta_i(z) = psi_i - z tan(beta)/R from
    where tooth 0 has its tip: psi_i is the sum of the pitch angles of the teeth before it, 2 pi i/N_z without any given.
    Tooth i + 1 cuts before tooth i. Its radius is

        R_i(z) = R + dR_i + rho cos(theta_i(z) - lambda).

    **Arguments:**

    - `diameter`: D = 2 R [m], > 0.
    - `teeth`: number of teeth N_z, an integer >= 1. Static: another number of teeth is another program.
    - `helix`: helix angle beta [rad], 0 to 75 degrees; the upper part of a tooth comes later. None: straight.
    - `pitch`: angle from each tooth to the next one [rad], > 0, shape (teeth,); a turn in sum. The last one is what the
      others leave of the turn, and is only checked. None: 2 pi/N_z each.
    - `runout`: deviation dR_i of the radius of each tooth [m], shape (teeth,). None: none.
    - `offset`: runout of the tool as a whole: distance rho of its axis from that of the spindle [m], >= 0. None: none.
    - `offset_angle`: direction lambda of that offset, from tooth 0 [rad]. Given with `offset`.

    Raises `ValueError` for numbers out of these ranges.
    """

    diameter: Scalar = eqx.field(converter=as_number)
    teeth: int = eqx.field(static=True)
    helix: Scalar | None = eqx.field(converter=optional, default=None)
    pitch: Float[Array, " teeth"] | None = eqx.field(converter=optional, default=None)
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
        if self.pitch is not None:
            self._check_pitch(self.pitch)
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

    def _check_pitch(self, pitch) -> None:
        positive("tool.pitch", pitch, "rad")
        if pitch.shape != (self.teeth,):
            raise ValueError(
                f"tool.pitch: shape {pitch.shape} given; it is the angle from each of the {self.teeth} teeth to the next one"
            )
        angles = concrete(pitch)
        if angles is not None and abs(np.sum(angles) - 2 * np.pi) > TURN:
            raise ValueError(
                f"tool.pitch: the angles given sum to {np.rad2deg(np.sum(angles)):.6g} deg; they are those from each tooth "
                "to the next, all around, and must sum to a turn, 360 deg"
            )

    @property
    def radius(self) -> Scalar:
        """R = D/2 [m]."""
        return self.diameter / 2

    @property
    def equal_teeth(self) -> bool:
        """Whether all teeth are of one radius and equally spaced."""
        return self.pitch is None and self.equal_radii

    @property
    def equal_radii(self) -> bool:
        """Whether all teeth reach equally far."""
        return self.runout is None and self.offset is None

    @property
    def spacing(self) -> Any:
        """psi_i [rad], shape (teeth,): how far each tooth is ahead of tooth 0. Of NumPy where it is known beforehand."""
        if self.pitch is None:
            return np.arange(self.teeth) * (2 * np.pi / self.teeth)
        return jnp.concatenate([jnp.zeros(1), jnp.cumsum(self.pitch[:-1])])

    def lead(self, passes: int) -> Float[Array, "passes teeth"] | None:
        """By how much the tooth that cuts one pass earlier is ahead of each, two passes earlier and so on, in parts of
        2 pi/N_z: 1, 2, ... [-]. None where the teeth are equally spaced."""
        if self.pitch is None:
            return None
        turns, earlier = np.divmod(np.arange(self.teeth) + np.arange(1, passes + 1)[:, None], self.teeth)
        spacing = self.spacing * (self.teeth / (2 * np.pi))
        return spacing[earlier] + self.teeth * turns - spacing

    def lag(self, z: Float[Array, "..."]) -> Float[Array, "..."]:
        """z tan(beta)/R [rad]: by which angle a tooth stands behind its tip at the height z [m]."""
        return jnp.zeros_like(z) if self.helix is None else z * jnp.tan(self.helix) / self.radius

    @property
    def shortest(self) -> Scalar | float:
        """The smallest pitch angle, in parts of 2 pi/N_z [-]."""
        lead = self.lead(1)
        return 1.0 if lead is None else jnp.min(lead)

    def deviation(self, lag: Float[Array, "..."]) -> Float[Array, "... teeth"] | None:
        """R_i - R [m] where a tooth stands `lag` [rad] behind its tip, None for equal teeth."""
        if self.equal_radii:
            return None
        found = jnp.zeros((*jnp.shape(lag), self.teeth))
        if self.runout is not None:
            found = found + self.runout
        if self.offset is not None and self.offset_angle is not None:
            theta = self.spacing - lag[..., None] - self.offset_angle
            found = found + self.offset * jnp.cos(theta)
        return found
