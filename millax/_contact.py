"""Step-averaged cutting force of teeth that cross the borders of the stock.

A tooth that meets a border reaches full chip thickness within a fraction of one step. Sampling it would make the whole
scheme first order; here the force is integrated over the step in closed form. Within a step the distance d of the tip
from a border is linear in time, and so is the thickness

    x = d/abs(N . n)          border between centre and tip: material begins at the border (entry),
    x = h + d/abs(N . n)      border behind the tip: material ends at the border (exit),

of which the tooth meets clip(x, 0, h). With the law's integral W the mean of F_t over the step is then exact.
"""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from ._chip import Angles
from ._forces import ForceLaw
from ._math import minimum
from ._types import Scalar

_PARALLEL = 1e-3
"""Smallest abs(N . n) taken: a ray nearly parallel to a border meets it in a step whose length does not matter."""


class Borders(NamedTuple):
    """The borders as each tooth meets them in each step of a block, without the tool's displacement."""

    normals: Float[Array, "borders 2"]
    before: Float[Array, "borders teeth m"]
    """Distance of the tip inside the border at the start of the step [m]."""
    after: Float[Array, "borders teeth m"]
    """The same at the end of the step."""
    steepness: Float[Array, "borders teeth m"]
    """1/abs(N . n) [-]."""
    exits: Float[Array, "borders teeth m"]
    """1 where the border is behind the tip, 0 where it is before it."""


class Contact(NamedTuple):
    """Step averages for one tooth and step."""

    tangential: Float[Array, "teeth m"]
    """F_t per unit of axial depth [N/m]."""
    thickness: Float[Array, "teeth m"]
    """Chip thickness [m]."""
    turn: Float[Array, "teeth m"]
    """Angle by which the middle of the part in contact lies past the middle of the step [rad]."""


def crossing(
    law: ForceLaw,
    borders: Borders,
    displacement: Float[Array, "2 m"],
    thickness_at,
    step_angle: float,
    width: Scalar,
) -> Contact:
    """Mean force and thickness over each step; `thickness_at(turn)` is h at an angle past the middle of the step."""
    h = thickness_at(0.0)
    if borders.normals.shape[0] == 0:
        return Contact(law.tangential(h), h, jnp.zeros_like(h))
    shift = borders.normals @ displacement
    start = _nearest((borders.before - shift[:, None]) * borders.steepness + borders.exits * h, width)
    end = _nearest((borders.after - shift[:, None]) * borders.steepness + borders.exits * h, width)
    # A step during which x hardly changes is widened to `width`: the mean stays defined, and is the value itself.
    length = jnp.sqrt((end - start) ** 2 + width**2 + 1e-24)
    low, high = (start + end - length) / 2, (start + end + length) / 2

    inside = (jnp.maximum(high, 0.0) - jnp.maximum(low, 0.0)) / length
    turn = (1 - inside) / 2 * (end - start) / length * step_angle
    h = thickness_at(turn)
    ramp_low, ramp_high = jnp.clip(low, 0.0, h), jnp.clip(high, 0.0, h)
    full = jnp.maximum(high - h, 0.0) - jnp.maximum(low - h, 0.0)
    force = (law.work(ramp_high) - law.work(ramp_low) + law.tangential(h) * full) / length
    mean_thickness = ((ramp_high**2 - ramp_low**2) / 2 + h * full) / length
    return Contact(force, mean_thickness, turn)


def _nearest(x: Float[Array, "borders teeth m"], width: Scalar) -> Float[Array, "teeth m"]:
    """Of several borders the one that leaves the thinnest chip."""
    nearest = x[0]
    for other in x[1:]:
        nearest = minimum(nearest, other, width)
    return nearest


def plane_force(angles: Angles, contact: Contact, kr: Scalar, depth: Scalar) -> Float[Array, "2 m"]:
    """Force on the tool in the plane, summed over the teeth (E 29) [N]."""
    cos = angles.cos - angles.sin * contact.turn
    sin = angles.sin + angles.cos * contact.turn
    tangential = depth * contact.tangential
    radial = kr * tangential
    return jnp.stack([jnp.sum(tangential * sin - radial * cos, 0), jnp.sum(tangential * cos + radial * sin, 0)])
