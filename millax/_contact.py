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
import numpy as np
from jaxtyping import Array, Float

from ._chip import Angles
from ._forces import ForceLaw
from ._math import minimum, positive_part
from ._stock import Stock
from ._types import Scalar


class Borders(NamedTuple):
    """The borders as each tooth meets them in each step of a block, without the tool's displacement."""

    normals: Float[Array, "borders 2"]
    before: Float[Array, "borders teeth m"]
    """d at the start of the step [m], positive inside."""
    after: Float[Array, "borders teeth m"]
    """d at the end of the step [m]."""
    steepness: Float[Array, "borders teeth m"]
    """1/abs(N . n) at the middle of the step."""
    exits: Float[Array, "borders teeth m"]
    """1 where the border is behind the tip, 0 where it is before it."""

    def moved(self, x: Scalar) -> "Borders":
        """The borders as they are met after a feed of x [m]."""
        nearer = (self.normals[:, 0] * x)[:, None, None]
        return self._replace(before=self.before - nearer, after=self.after - nearer)


def borders_met(stock: Stock, radius: Scalar, centres, phi: np.ndarray, step_angle: float) -> Borders:
    """The borders met by teeth at the angles `phi` in the middle of each step, shape (blocks, 1, teeth, m).

    `centres` are the tool centres at the start and the end of each step: two pairs (x, y) [m] that broadcast with `phi`.
    """
    nx, ny = stock.normals.T[:, :, None, None]
    across = nx * np.cos(phi) - ny * np.sin(phi)
    # The tip moves on a circle: near the border it lies beyond its chord by d'' step²/12 on the average of the step.
    bulge = radius * across * step_angle**2 / 12

    def inside(centre, angle):
        x, y = centre
        towards = nx * np.cos(angle) - ny * np.sin(angle)
        return stock.offsets[:, None, None] - nx * x - ny * y - radius * towards - bulge

    return Borders(
        normals=jnp.broadcast_to(stock.normals, (len(phi), *stock.normals.shape)),
        before=inside(centres[0], phi - step_angle / 2),
        after=inside(centres[1], phi + step_angle / 2),
        # A ray nearly parallel to a border meets it in a step whose length does not matter.
        steepness=1 / jnp.sqrt(across**2 + 1e-6),
        exits=jnp.where(across > 0, 1.0, 0.0),
    )


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
    gap: Float[Array, "teeth m"],
    rate: Float[Array, "teeth m"],
    step_angle: float,
    width: Scalar,
) -> Contact:
    """Mean force, thickness and place of contact in each step.

    `gap` [m] is the thickness at the middle of the step, negative out of contact, and `rate` [m/rad] its change with the
    tooth angle.
    """
    half = jnp.sqrt(width**2 + (rate * step_angle / 2) ** 2 + 1e-30)
    h = positive_part(gap, half)
    if borders.normals.shape[0] == 0:
        return Contact(_mean_force(law, gap, half), h, jnp.zeros_like(h))
    shift = (borders.normals @ displacement)[:, None]
    start = _nearest((borders.before - shift) * borders.steepness + borders.exits * h, width)
    end = _nearest((borders.after - shift) * borders.steepness + borders.exits * h, width)
    # A step during which x hardly changes is widened to `width`: the mean stays defined, and is the value itself.
    length = jnp.sqrt((end - start) ** 2 + width**2 + 1e-24)
    middle = (start + end) / 2
    low, high = middle - length / 2, middle + length / 2

    ramp_low, ramp_high = jnp.clip(low, 0.0, h), jnp.clip(high, 0.0, h)
    full_low, full_high = jnp.maximum(low, h), jnp.maximum(high, h)
    full = full_high - full_low
    area = (ramp_high**2 - ramp_low**2) / 2 + h * full
    moment = (ramp_high**3 - ramp_low**3) / 3 + h * full * ((full_high + full_low) / 2)
    centre = jnp.where(area > 0, moment / jnp.where(area > 0, area, 1.0) - middle, 0.0)
    turn = centre * (end - start) / length**2 * step_angle
    force = (law.work(ramp_low, ramp_high) + _mean_force(law, gap + rate * turn, half) * full) / length
    return Contact(force, area / length, turn)


def _mean_force(law: ForceLaw, gap, half):
    """Mean of F_t over a thickness from gap - half to gap + half, 0 out of contact."""
    return law.work(jnp.maximum(gap - half, 0.0), jnp.maximum(gap + half, 0.0)) / (2 * half)


def _nearest(x: Float[Array, "borders teeth m"], width: Scalar) -> Float[Array, "teeth m"]:
    """Of several borders the one that leaves the thinnest chip."""
    nearest = x[0]
    for other in x[1:]:
        nearest = minimum(nearest, other, width)
    return nearest


def plane_force(angles: Angles, contact: Contact, kr: Scalar, depth: Scalar) -> tuple[Array, Array]:
    """Forces on the tool along x and y, summed over the teeth (E 29) [N], each of shape (m,)."""
    cos = angles.cos - angles.sin * contact.turn
    sin = angles.sin + angles.cos * contact.turn
    tangential = depth * contact.tangential
    radial = kr * tangential
    return jnp.sum(tangential * sin - radial * cos, axis=0), jnp.sum(tangential * cos + radial * sin, axis=0)
