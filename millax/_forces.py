"""Force laws: from chip thickness to the tangential force per unit of axial depth.

Every law gives F_t(h) and its integral W(h) from 0 to h, the cutting work per unit depth and unit length of cut. The
integral makes the mean force over a step in which the thickness ramps from h0 to h1 exact: (W(h1) - W(h0))/(h1 - h0).
The radial force is F_r = k_r F_t (E 28). Both are defined for h >= 0; the engine sees to it that h is never negative.
"""

import abc

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from ._check import finite, not_negative, positive
from ._types import Scalar, as_number


class ForceLaw(eqx.Module):
    """F_t per unit of axial depth [N/m] as a function of chip thickness h [m], and k_r = F_r/F_t."""

    kr: eqx.AbstractVar[Scalar]

    @abc.abstractmethod
    def tangential(self, h: Float[Array, "..."]) -> Float[Array, "..."]:
        """F_t(h) [N/m] for h >= 0 [m]."""

    @abc.abstractmethod
    def work(self, h: Float[Array, "..."]) -> Float[Array, "..."]:
        """W(h), the integral of F_t from 0 to h [N]."""


class LinearLaw(ForceLaw):
    """F_t = k_T h + k_E for h > 0 (E 24), with the jump at h = 0 regularised.

    The edge force jumps to k_E at first contact. Here it rises as k_E h/sqrt(h² + h_0²): within a relative (h_0/h)²/2 of
    k_E where h >> h_0.

    **Arguments:**

    - `kt`: cutting coefficient k_T [N/m²], > 0.
    - `kr`: radial over tangential force k_r [-].
    - `ke`: edge coefficient k_E [N/m], >= 0.
    - `h0`: regularisation h_0 of the edge force [m], > 0.
    """

    kt: Scalar = eqx.field(converter=as_number)
    kr: Scalar = eqx.field(converter=as_number)
    ke: Scalar = eqx.field(converter=as_number, default=0.0)
    h0: Scalar = eqx.field(converter=as_number, default=1e-6)

    def __check_init__(self):
        positive("force.kt", self.kt, "N/m^2")
        not_negative("force.ke", self.ke, "N/m")
        positive("force.h0", self.h0, "m")
        finite("force.kr", self.kr, "")

    def tangential(self, h):
        return self.kt * h + self.ke * h / jnp.sqrt(h**2 + self.h0**2)

    def work(self, h):
        return self.kt * h**2 / 2 + self.ke * (jnp.sqrt(h**2 + self.h0**2) - self.h0)


class ExponentialLaw(ForceLaw):
    """F_t = k_F h^m (E 25), regularised at 0.

    The slope of h^m is infinite at h = 0, which no gradient survives. Here F_t = k_F h (h² + h_0²)^((m - 1)/2): equal to
    k_F h^m but for a relative bias of (m - 1)/2 (h_0/h)² where h >> h_0, and of finite slope k_F h_0^(m - 1) at 0.

    **Arguments:**

    - `kf`: k_F [N/m^(1 + m)], > 0: the force per unit depth at h = 1 m.
    - `m`: exponent [-], 0 < m <= 1.
    - `kr`: radial over tangential force k_r [-].
    - `h0`: regularisation h_0 [m], > 0. The default, 0.1 µm, biases the force at h = 10 µm by less than 1e-4.
    """

    kf: Scalar = eqx.field(converter=as_number)
    m: Scalar = eqx.field(converter=as_number)
    kr: Scalar = eqx.field(converter=as_number)
    h0: Scalar = eqx.field(converter=as_number, default=1e-7)

    def __check_init__(self):
        positive("force.kf", self.kf, "N/m^(1+m)")
        positive("force.m", self.m, "")
        positive("force.h0", self.h0, "m")
        finite("force.kr", self.kr, "")

    def tangential(self, h):
        return self.kf * h * (h**2 + self.h0**2) ** ((self.m - 1) / 2)

    def work(self, h):
        power = (self.m + 1) / 2
        return self.kf * ((h**2 + self.h0**2) ** power - self.h0 ** (2 * power)) / (self.m + 1)


class FractionalLaw(ForceLaw):
    """F_t = k_0 h_s (u + r u²)/(1 + u), u = h/h_s (E 26, with the factor h_s that its dimensions need).

    dF_t/dh falls from k_0 at h = 0 to r k_0 = k_inf for h >> h_s.

    **Arguments:**

    - `k0`: stiffness of the cut for thin chips, per unit axial depth [N/m²], > 0.
    - `hs`: chip thickness h_s at which the law bends [m], > 0.
    - `r`: k_inf/k_0 [-], >= 0 (E: < 1).
    - `kr`: radial over tangential force k_r [-].
    """

    k0: Scalar = eqx.field(converter=as_number)
    hs: Scalar = eqx.field(converter=as_number)
    r: Scalar = eqx.field(converter=as_number)
    kr: Scalar = eqx.field(converter=as_number)

    def __check_init__(self):
        positive("force.k0", self.k0, "N/m^2")
        positive("force.hs", self.hs, "m")
        not_negative("force.r", self.r, "")
        finite("force.kr", self.kr, "")

    def tangential(self, h):
        u = h / self.hs
        return self.k0 * self.hs * (u + self.r * u**2) / (1 + u)

    def work(self, h):
        u = h / self.hs
        return self.k0 * self.hs**2 * (self.r * u**2 / 2 + (1 - self.r) * (u - jnp.log1p(u)))
