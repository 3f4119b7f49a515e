"""Conventions, said once.

Units
    SI and radians everywhere inside: m, kg, s, N, rad/s. Units appear only at the border (case files, traces).
Workpiece frame
    x along the feed, z along the spindle axis towards the tool, y completing a right-handed frame.
Tooth angle
    A tooth at angle phi sits at c + R n(phi) with n = (cos phi, -sin phi): phi is measured from the feed direction and
    grows clockwise (E 30). e = dn/dphi = (-sin phi, -cos phi) is the direction of cut.
Forces
    Forces act *on the tool*.

Sources: E = ESDA 2012 (elasto-dynamic model of robotic milling), C = COROUSSO deliverable 1.4 (2013),
H = Ha 2019 (inverse dynamics and calibration of cutting force).
"""

import jax.numpy as jnp
from jaxtyping import Array, Float

Scalar = Float[Array, ""]
Vector = Float[Array, " n"]
Matrix = Float[Array, "n n"]

AXES = ("x", "y", "z")
"""Directions of the workpiece frame, in the order of every force and displacement vector."""


def as_number(value) -> Array:
    """`value` as a floating-point array: the converter of every physical field, so that each is a differentiable leaf."""
    return jnp.asarray(value, dtype=float)


def optional(value) -> Array | None:
    """The same, None if there is none."""
    return None if value is None else as_number(value)
