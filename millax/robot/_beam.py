"""A link as an elastic beam: its stiffness at the end, and how its sections move with that end."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._check import concrete, finite, positive
from .._types import Scalar, as_number, optional

POINTS, WEIGHTS = (np.polynomial.legendre.leggauss(4)[0] + 1) / 2, np.polynomial.legendre.leggauss(4)[1] / 2
"""Sections at which the masses of a beam stand, as parts of its length, and parts of its mass. Gauss's points: exact for
polynomials of degree 7, and the kinetic energy of the shapes below has degree 6."""

MOTIONS = ("stretch", "sag_y", "sag_z", "twist", "turn_y", "turn_z")
"""How the end of a beam moves: along its axes x, y, z, then about them."""


class Beam(eqx.Module):
    """A straight uniform Bernoulli beam, from the origin of a joint to that of the next one, or to the flange.

    Its axes: x along the beam, y the part of `side` across it, z completing them. Its mass is that of the link, uniform.

    **Arguments:**

    - `area`: A of the cross-section [m²], > 0.
    - `second_moment_y`, `second_moment_z`: I_y (bending in the plane x, z) and I_z (x, y) [m⁴], > 0.
    - `torsion`: torsion constant J_t [m⁴], > 0: I_y + I_z for a round section.
    - `young`: E [Pa], > 0.
    - `shear`: G [Pa], > 0.
    - `side`: a direction in the frame of the link, not along the beam [-], shape (3,). None: any, for equal moments.

    Raises `ValueError` for numbers out of these ranges, and for unequal moments without a side.
    """

    area: Scalar = eqx.field(converter=as_number)
    second_moment_y: Scalar = eqx.field(converter=as_number)
    second_moment_z: Scalar = eqx.field(converter=as_number)
    torsion: Scalar = eqx.field(converter=as_number)
    young: Scalar = eqx.field(converter=as_number)
    shear: Scalar = eqx.field(converter=as_number)
    side: Float[Array, " 3"] | None = eqx.field(converter=optional, default=None)

    def __check_init__(self):
        for name, unit in (
            ("area", "m²"),
            ("second_moment_y", "m⁴"),
            ("second_moment_z", "m⁴"),
            ("torsion", "m⁴"),
            ("young", "Pa"),
            ("shear", "Pa"),
        ):
            value = getattr(self, name)
            if value.shape != ():
                raise ValueError(f"beam.{name}: shape {value.shape} given; it must be one number")
            positive(f"beam.{name}", value, unit)
        if self.side is not None:
            if self.side.shape != (3,):
                raise ValueError(f"beam.side: shape {self.side.shape} given; it must be (3,), a direction")
            finite("beam.side", self.side, "")
            return
        moments = concrete(self.second_moment_y), concrete(self.second_moment_z)
        if moments[0] is not None and moments[1] is not None and moments[0] != moments[1]:
            raise ValueError(
                f"beam.side: none given, with second moments of {moments[0]:g} and {moments[1]:g} m⁴; give the direction of "
                "the section's y axis, in the frame of the link"
            )

    @staticmethod
    def tube(outer, inner=0.0, young=210e9, shear=81e9) -> "Beam":
        """A round tube, of steel unless said otherwise.

        **Arguments:**

        - `outer`, `inner`: diameters [m]; `inner` 0: a solid shaft.
        - `young`, `shear`: E, G [Pa].
        """
        d, b = as_number(outer), as_number(inner)
        moment = jnp.pi * (d**4 - b**4) / 64
        return Beam(jnp.pi * (d**2 - b**2) / 4, moment, moment, 2 * moment, young, shear)

    def axes(self, line: Float[Array, " 3"]) -> Float[Array, "3 3"]:
        """Its axes as columns, in the frame in which it runs along `line`."""
        x = line / jnp.linalg.norm(line)
        side = jnp.eye(3)[jnp.argmin(jnp.abs(x))] if self.side is None else self.side
        across = side - (side @ x) * x
        y = across / jnp.linalg.norm(across)
        return jnp.stack([x, y, jnp.cross(x, y)], axis=1)

    def compliance(self, length: Scalar) -> Float[Array, "6 6"]:
        """Motion of its end in its axes by force and moment there: L/EA, L³/3EI, L²/2EI, L/EI, L/GJ_t [m/N], [rad/(N m)]."""
        bend_y = length / (self.young * self.second_moment_z)  # in the direction y
        bend_z = length / (self.young * self.second_moment_y)
        own = [
            length / (self.young * self.area),
            bend_y * length**2 / 3,
            bend_z * length**2 / 3,
            length / (self.shear * self.torsion),
            bend_z,
            bend_y,
        ]
        both_y, both_z = bend_y * length / 2, -bend_z * length / 2
        return jnp.diag(jnp.stack(own)).at[1, 5].set(both_y).at[5, 1].set(both_y).at[2, 4].set(both_z).at[4, 2].set(both_z)

    @property
    def gyration(self) -> Float[Array, " 3"]:
        """Squares of the radii of gyration of a section about x, y, z [m²]."""
        return (
            jnp.stack([self.second_moment_y + self.second_moment_z, self.second_moment_y, self.second_moment_z]) / self.area
        )


def shapes(part: Float[np.ndarray, " sections"]) -> tuple[Float[np.ndarray, "sections 3"], Float[np.ndarray, "sections 3"]]:
    """How much of the end's motion, along x, y, z and about them, a section at this part x/L of the length takes part in:
    diag(f, g, g) and diag(f, h, h) of a beam loaded at its end (E 13, C 20), f = x/L, g = x²(3L - x)/(2L³) and
    h = 2x(L - x/2)/L² (C 21; E 14 prints half of it)."""
    f, g, h = part, part**2 * (3 - part) / 2, part * (2 - part)
    return np.stack([f, g, g], axis=1), np.stack([f, h, h], axis=1)
