"""Chip thickness: how much material each tooth meets, from the paths of the teeth that cut before it.

On the ray from the tool centre c through the tip, the material ends where tooth j = i + k cut k tooth periods earlier. To
second order in the displacement D_k = c(t) - c(t - k tau) between the two passes, the distance from the tip to that
surface is

    g_k = n . D_k + (e . D_k)²/(2 R) - (n . c'(t - k tau)) (e . D_k)/(Omega R),        e = dn/dphi,

with c' the whole velocity, feed included, and the chip thickness is h = max(0, min_k g_k). Against exact tooth paths the
force error is 0.007 % in a nominal slot. Passes with abs(e . D_k) >= R are skipped: the two circles do not meet there.

The surfaces left by earlier passes are known while a block is computed, so everything that depends on them is computed
once (`past_surfaces`); what depends on the present displacement is repeated in every sweep (`thickness`).
"""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from ._math import half_change, positive_part, preferred
from ._types import Scalar


class Angles(NamedTuple):
    """Directions of the teeth at the middle of each step of a block: n = (cos, -sin), e = (-sin, -cos)."""

    cos: Float[Array, "teeth m"]
    sin: Float[Array, "teeth m"]


class PastSurfaces(NamedTuple):
    """What g_k takes from earlier passes: n . D_k and e . D_k without the present displacement, the slope of the path."""

    radial: Float[Array, "passes teeth m"]
    tangential: Float[Array, "passes teeth m"]
    slope: Float[Array, "passes teeth m"]


def past_surfaces(
    angles: Angles,
    past_displacement: Float[Array, "passes 2 m"],
    past_velocity: Float[Array, "passes 2 m"],
    feed_per_tooth: Scalar,
    feed_rate: Scalar,
    tip_speed: Scalar,
) -> PastSurfaces:
    """Surfaces left 1 ... K tooth periods earlier; `tip_speed` is Omega R [m/s], the rest [m] and [m/s]."""
    k = jnp.arange(1, past_displacement.shape[0] + 1, dtype=feed_per_tooth.dtype)[:, None, None]
    x = k * feed_per_tooth - past_displacement[:, 0, None, :]
    y = -past_displacement[:, 1, None, :]
    vx = (feed_rate + past_velocity[:, 0, None, :]) / tip_speed
    vy = past_velocity[:, 1, None, :] / tip_speed
    return PastSurfaces(
        radial=angles.cos * x - angles.sin * y,
        tangential=-angles.sin * x - angles.cos * y,
        slope=angles.cos * vx - angles.sin * vy,
    )


def thickness(
    angles: Angles,
    past: PastSurfaces,
    displacement: Float[Array, "2 m"],
    radius: Scalar,
    width: Scalar,
    step_angle: float,
) -> tuple[Float[Array, "teeth m"], Float[Array, "teeth m"]]:
    """g_k [m] of the pass that leaves the least, negative out of contact, and its rate e . D_k [m/rad] with the tooth angle.

    The least on the average of the step: in a step in which a tooth begins or ends to cut, that is another pass than the
    one with the smallest g_k in its middle.
    """
    ux, uy = displacement
    radial = angles.cos * ux - angles.sin * uy
    tangential = -angles.sin * ux - angles.cos * uy
    passes = []
    for k in range(past.radial.shape[0]):
        across = tangential + past.tangential[k]
        gap = radial + past.radial[k] + across * (across / (2 * radius) - past.slope[k])
        gap = jnp.where(jnp.abs(across) < radius, gap, radius)
        passes.append((gap, across, positive_part(gap, half_change(across, step_angle, width))))
    least, *others = passes
    for other in others:
        weight = preferred(least[2], other[2], width)
        least = [a + weight * (b - a) for a, b in zip(least, other, strict=True)]
    return least[0], least[1]
