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
from jaxtyping import Array, Bool, Float

from ._chip import Angles
from ._forces import ForceLaw, UnitLaw, work
from ._math import half_change, minimum, positive_part, stored
from ._stock import Stock
from ._types import Scalar


class Borders(NamedTuple):
    """The borders as each tooth meets them in each step of a block, without the tool's displacement."""

    normals: Float[Array, "2 borders 1 1"]
    """N, the same in all steps."""
    before: Float[Array, "borders teeth m"]
    """d at the start of the step [m], positive inside."""
    after: Float[Array, "borders teeth m"]
    """d at the end of the step [m]."""
    steepness: Float[Array, "borders teeth m"]
    """1/abs(N . n) at the middle of the step."""
    exits: Float[Array, "borders teeth m"]
    """1 where the border is behind the tip, 0 where it is before it."""
    bulge: Float[Array, "borders teeth m"]
    """By how much x lies beyond the chord of the tip's path in the middle of the step [m]."""

    def moved(self, x: Scalar) -> "Borders":
        """The borders as they are met after a feed of x [m]."""
        nearer = self.normals[..., 0, :, :, :] * x
        return self._replace(before=self.before - nearer, after=self.after - nearer)


def borders_met(stock: Stock, radius, centres, phi, step_angle: float) -> Borders:
    """The borders met by teeth at the angles `phi` in the middle of each step, shape (..., 1, teeth, m).

    `radius` is that of each tooth, `centres` are the tool centres at the start and the end of each step, two pairs [m]; they
    broadcast with `phi`.
    """
    nx, ny = stock.normals.T[:, :, None, None]
    across = nx * jnp.cos(phi) - ny * jnp.sin(phi)
    # A ray nearly parallel to a border meets it in a step whose length does not matter.
    steepness = 1 / jnp.sqrt(across**2 + 1e-6)

    def inside(centre, angle):
        x, y = centre
        towards = nx * jnp.cos(angle) - ny * jnp.sin(angle)
        return stock.offsets[:, None, None] - nx * x - ny * y - radius * towards

    return Borders(
        normals=jnp.broadcast_to(stock.normals.T[:, :, None, None], (*phi.shape[:-3], 2, len(stock.normals), 1, 1)),
        before=inside(centres[0], phi - step_angle / 2),
        after=inside(centres[1], phi + step_angle / 2),
        steepness=steepness,
        exits=jnp.where(across > 0, 1.0, 0.0),
        bulge=-radius * across * steepness * step_angle**2 / 8,  # the tip moves on a circle
    )


class Contact(NamedTuple):
    """Step averages for one tooth and step."""

    tangential: Float[Array, "teeth m"]
    """F_t per unit of axial depth [N/m]."""
    engaged: Float[Array, "teeth m"] | None
    """Part of the step in contact [-]; None where no force depends on it."""
    turn: Float[Array, "teeth m"] | None
    """Angle by which the middle of the part in contact lies past the middle of the step [rad]; None: in the middle."""
    thickness: Float[Array, "teeth m"]
    """Chip thickness [m]."""


def fully_inside(law: ForceLaw, gap, rate, step_angle: float, width: Scalar) -> Contact:
    """Mean force and thickness in each step of teeth that meet no border; arguments as in `crossing`."""
    change = gap, rate, step_angle, width
    engaged = _mean_force(UnitLaw(), *change) if law.feels_contact else None
    return Contact(_mean_force(law, *change), engaged, None, _mean_thickness(*change))


def crossing(
    law: ForceLaw,
    borders: Borders,
    displacement: Float[Array, "2 m"],
    gap: Float[Array, "teeth m"],
    rate: Float[Array, "teeth m"],
    step_angle: float,
    width: Scalar,
    near: Bool[Array, ""],
) -> Contact:
    """Mean force, thickness and place of contact in each step, where a tooth is near a border.

    `gap` [m] is the thickness at the middle of the step, negative out of contact, and `rate` [m/rad] its change with the
    tooth angle.
    """

    def passage(borders, displacement, gap, rate, width):
        """Chip thickness, and x at the start and the end of the step."""
        h = _mean_thickness(gap, rate, step_angle, width)
        shift = borders.normals[0] * displacement[0] + borders.normals[1] * displacement[1]
        start = (borders.before - shift) * borders.steepness + borders.exits * h
        end = (borders.after - shift) * borders.steepness + borders.exits * h
        raised = borders.bulge * _raise(start, end, borders.bulge)
        return h, _nearest(start + raised, width), _nearest(end + raised, width)

    def parts(h, start, end, rate, width):
        """The thickness where x begins to count and where it ceases to; how long h is met in full; mean and place."""
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
        return ramp_low, ramp_high, full / length, 1 / length, area / length, turn

    def forces(law, gap, rate, turn, ramp_low, ramp_high, part, per_length, width):
        # The rest of the step, at full thickness, is shorter than the step and lies past its middle by `turn`.
        plateau = _mean_force(law, gap + rate * turn, rate * part, step_angle, width)
        return work(law, ramp_low, ramp_high) * per_length + plateau * part

    h, start, end = stored(near, passage, borders, displacement, gap, rate, width)
    ramp_low, ramp_high, part, per_length, mean, turn = stored(near, parts, h, start, end, rate, width)
    met = gap, rate, turn, ramp_low, ramp_high, part, per_length, width
    engaged = forces(UnitLaw(), *met) if law.feels_contact else None
    return Contact(forces(law, *met), engaged, turn, mean)


def _raise(start, end, bulge):
    """By which part of the height of an arc its chord has to be raised to have the same mean positive part.

    The arc is chord + 4 bulge s (1 - s). With the chord positive on a part p of the step, the mean gains 2 p² - 4/3 p³ times
    the bulge from the arc, and p times a raise of the chord. The part is taken in between, at the mean height of the arc.
    """
    length = jnp.abs(end - start) + 1e-12
    high = jnp.maximum(start, end) + 2 / 3 * bulge
    part = jnp.clip(high / length, 0.0, 1.0)
    return part * (2 - 4 / 3 * part)


def _mean_force(law: ForceLaw, gap, rate, step_angle: float, width: Scalar):
    """Mean of F_t over a step in which the thickness changes by `rate` [m/rad] around `gap`, 0 out of contact."""
    return _mean(lambda low, high: work(law, low, high), gap, rate, step_angle, width)


def _mean_thickness(gap, rate, step_angle: float, width: Scalar):
    """Of the same step."""
    return _mean(lambda low, high: (high - low) * (high + low) / 2, gap, rate, step_angle, width)


def _mean(integral, gap, rate, step_angle: float, width: Scalar):
    """Half of the width goes to the range of thicknesses and half to the border of contact: without the latter, the slope of
    an edge force, which begins all at once, would jump where the range reaches the border."""
    half = half_change(rate, step_angle, width / 2)
    low, high = (positive_part(gap + end, width / 2) for end in (-half, half))
    return integral(low, high) / (2 * half)


def _nearest(x: Float[Array, "borders teeth m"], width: Scalar) -> Float[Array, "teeth m"]:
    """Of several borders the one that leaves the thinnest chip."""
    nearest = x[0]
    for other in x[1:]:
        nearest = minimum(nearest, other, width)
    return nearest


def force_on_tool(
    angles: Angles,
    tangential,
    engaged,
    turn,
    law: ForceLaw,
    depth: Scalar,
    velocity: tuple[Array, ...],
    damping: Scalar | None,
) -> tuple[Array, ...]:
    """Forces on the tool along x and y (E 29), and z where the law has an axial force, summed over the teeth [N], each of
    shape (m,); `tangential`, `engaged` and `turn` as in `Contact`, `velocity` of the tool [m/s] and process `damping`
    [N s/m²], if any."""
    cos, sin = angles
    if turn is not None:
        cos, sin = cos - sin * turn, sin + cos * turn
    tangential = depth * tangential
    radial = law.kr * tangential
    axial = None if law.ka is None else law.ka * tangential
    if engaged is not None and law.own_edges is not None:
        of_radial, of_axial = law.own_edges
        radial = radial + depth * of_radial * engaged
        axial = None if axial is None else axial + depth * of_axial * engaged
    if engaged is not None and damping is not None:
        vx, vy = velocity
        radial = radial + depth * damping * engaged * (cos * vx - sin * vy)
    in_plane = tangential * sin - radial * cos, tangential * cos + radial * sin
    return tuple(jnp.sum(along, axis=0) for along in (in_plane if axial is None else (*in_plane, axial)))
