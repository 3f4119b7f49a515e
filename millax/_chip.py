"""Chip thickness: how much material each tooth meets, from the paths of the teeth that cut before it.

On the ray from the tool centre c through the tip, the material ends where tooth j = i + k cut k tooth periods earlier. To
second order in the displacement D_k = c(t) - c(t - k tau) between the two passes, the distance from the tip to that
surface is

    g_k = n . D_k + (e . D_k)²/(2 R) - (n . c'(t - k tau)) (e . D_k)/(Omega R),        e = dn/dphi,

with c' the whole velocity, feed included, and the chip thickness is h = max(0, min_k g_k). Of unequal teeth, R_i - R_j is
added to g_k; where they are not equally spaced, k tau is the time between the two teeth. Against exact tooth paths the
force error is 0.007 % in a nominal slot. Passes with abs(e . D_k) >= R are skipped: the two circles do not meet there.

The earlier passes are known while a block is computed; the present displacement changes with every sweep.
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


class Commanded(NamedTuple):
    """The motion of the teeth without vibration."""

    feed_per_tooth: Scalar
    feed_rate: Scalar
    tip_speed: Scalar
    """Omega R [m/s]."""
    radius: Scalar
    lead: Float[Array, "passes teeth 1"] | None = None
    """How long before the tooth that of the earlier pass cut, over the mean time between two teeth; None for 1, 2, ..."""
    excess: Float[Array, "passes teeth 1"] | None = None
    """R_i - R_{i + k}: by how much each tooth reaches farther than the one of the earlier pass [m]; None for equal teeth."""


class Earlier(NamedTuple):
    """The earlier passes 1 ... K in the steps of a block, as far as the thickness depends on them. Where the teeth are not
    equally spaced, each tooth has earlier motions of its own."""

    displacement: Float[Array, "passes 2 *teeth m"]
    """u(t - k tau) [m]."""
    velocity: Float[Array, "passes 2 *teeth m"]
    """u'(t - k tau) [m/s]."""
    commanded: Commanded

    def advance(self, k: int) -> Array:
        """The feed between pass k, from 0, and now [m]."""
        lead = self.commanded.lead
        return self.commanded.feed_per_tooth * (k + 1 if lead is None else lead[k])


Paths = tuple[tuple[Float[Array, "teeth m"], Float[Array, "teeth m"]], ...]
"""g_k [m] and e . D_k [m] of every pass."""


def paths(angles: Angles, earlier: Earlier, displacement: Float[Array, "2 m"]) -> Paths:
    """How far the tip of each tooth is from the surfaces left by the earlier passes."""
    _, feed_rate, tip_speed, radius, _, excess = earlier.commanded
    curvature, slowness = 1 / (2 * radius), 1 / tip_speed
    found = []
    for k in range(len(earlier.displacement)):
        dx = displacement[0] - earlier.displacement[k, 0] + earlier.advance(k)
        dy = displacement[1] - earlier.displacement[k, 1]
        vx = (earlier.velocity[k, 0] + feed_rate) * slowness
        vy = earlier.velocity[k, 1] * slowness
        across = -angles.sin * dx - angles.cos * dy
        slope = angles.cos * vx - angles.sin * vy
        gap = angles.cos * dx - angles.sin * dy + across * (across * curvature - slope)
        gap = gap if excess is None else gap + excess[k]
        found.append((jnp.where(jnp.abs(across) < radius, gap, radius), across))
    return tuple(found)


class Choice(NamedTuple):
    """Between the pass that leaves least so far and one more."""

    weight: Float[Array, "teeth m"]
    """1 where that one leaves less, 0 where it does not."""
    slope: Float[Array, "teeth m"]
    """Its derivative by the difference of what they leave [1/m]."""


def thickness(paths: Paths, width: Scalar, step_angle: float) -> tuple[Float[Array, "teeth m"], Float[Array, "teeth m"]]:
    """g_k [m] of the pass that leaves the least, negative out of contact, and e . D_k, its rate with the angle [m/rad]."""
    _, (gap, rate, _) = choices(paths, width, step_angle)
    return gap, rate


def choices(paths: Paths, width: Scalar, step_angle: float) -> tuple[tuple[Choice, ...], tuple[Array, Array, Array]]:
    """Whether the second pass and those after it leave less than all before; and the last of `least_so_far`."""
    least, *others = passes(paths, width, step_angle)
    found = []
    for other in others:
        found.append(Choice(*preferred(least[2], other[2], width)))
        least = blended(least, other, found[-1].weight)
    return tuple(found), least


def least_so_far(
    paths: Paths, choices: tuple[Choice, ...], width: Scalar, step_angle: float
) -> list[tuple[Array, Array, Array]]:
    """Of the first pass, the first two and so on: g, its rate and what counts, of the one that leaves the least."""
    least, *others = passes(paths, width, step_angle)
    found = [least]
    for other, choice in zip(others, choices, strict=True):
        found.append(blended(found[-1], other, choice.weight))
    return found


def passes(paths: Paths, width: Scalar, step_angle: float) -> list[tuple[Array, Array, Array]]:
    """g_k [m], its rate [m/rad], and by what the passes are compared: the mean thickness that is left in the step [m], up
    to how the width enters it (`_contact._mean` takes more).

    In a step in which a tooth begins or ends to cut, that is another pass than the one with the smallest g_k in its middle.
    """
    return [(gap, rate, positive_part(gap, half_change(rate, step_angle, width))) for gap, rate in paths]


def passes_by(gap, rate, width: Scalar, step_angle: float) -> tuple[Array, Array, Array]:
    """Derivatives of what `passes` compares, by g_k, its rate and the width."""
    half = half_change(rate, step_angle, width)
    t = jnp.clip(gap / half, -1.0, 1.0)
    by_half = (1 - t * t) / (4 * half)
    return (1 + t) / 2, by_half * rate * (step_angle / 2) ** 2, by_half * width


def blended(a, b, weight) -> tuple[Array, Array, Array]:
    """a where the weight is 0, b where it is 1."""
    x, y, z = (p + weight * (q - p) for p, q in zip(a, b, strict=True))
    return x, y, z
