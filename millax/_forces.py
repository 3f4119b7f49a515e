"""Force laws: from chip thickness to the tangential force per unit of axial depth.

The engine needs of a law only its integral W, the cutting work: the mean force over a step in which the thickness grows
from a to b is W(a, b)/(b - a), exactly, whatever the law does in between. That mean is what smooths the laws: a jump of
the edge force or an infinite slope at h = 0 is spread over the change of thickness within a step, and over the width of
`Settings`. The radial force is F_r = k_r F_t (E 28), the axial one F_a = k_a F_t; with edge forces of their own,
radial and axial force have another share of the edge force than of the rest, and only that one.

Every law may have an edge force: a part of the force that is there whenever a tooth is in contact, whatever the thickness,
that of an edge which rubs and ploughs. In the linear law it is what makes the law's line miss the origin; the other two
bend near h = 0 by themselves, and have one only where it is given.
"""

import abc
import dataclasses
from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ._check import finite, not_negative, positive
from ._math import log1p
from ._types import Scalar, as_number, optional


class ForceLaw(eqx.Module):
    """F_t per unit of axial depth [N/m] as a function of chip thickness h [m], k_r = F_r/F_t and k_a = F_a/F_t.

    `ke` is the part k_E of F_t that does not depend on the thickness, 0 where it is None. With `kre` or `kae` the forces are
    those of an edge model, F_r = k_r (F_t - k_E) + k_rE and F_a = k_a (F_t - k_E) + k_aE; None: k_r k_E and k_a k_E.

    F_r pushes the tool away from the tooth, F_a along +z, up its axis. k_a is negative where the helix pulls the tool out of
    its holder, as a right-handed one does. None: there is no axial force, and none is computed.

    Every coefficient but the exponent m is one number for all teeth, or has the shape (teeth,): unequal teeth, as a worn one
    beside a sharp one. The laws below are then for thicknesses whose last axis is that of the teeth.

    With `process_damping` C [N/m], the flank of a tooth in contact presses on the wavy surface that it leaves, with a radial
    force C (n . u')/V per unit of axial depth: u' is the velocity of the vibration, n points from the tool centre to the tip
    and V = Omega R is the cutting speed (Tyler and Schmitz, J. Manuf. Process. 15, 2013, 69-76).
    """

    OWN: ClassVar[tuple[str, ...]] = ()
    """What else of a law may differ from tooth to tooth, beside what all laws have."""

    kr: eqx.AbstractVar[Scalar]
    # Laws that have them make them fields.
    ka = None
    ke = None
    kre = None
    kae = None
    process_damping = None

    @abc.abstractmethod
    def tangential(self, h: Float[Array, "..."]) -> Float[Array, "..."]:
        """F_t(h) [N/m] for h >= 0 [m]."""

    @abc.abstractmethod
    def work(self, low: Float[Array, "..."], high: Float[Array, "..."]) -> Float[Array, "..."]:
        """W, the integral of F_t from h = low to h = high [N], for 0 <= low <= high [m]."""

    @property
    def equal_teeth(self) -> bool:
        """Whether all teeth have the same coefficients."""
        return not self._by_tooth()

    def for_steps(self, teeth: int) -> "ForceLaw":
        """The law for arrays of shape (teeth, steps). Raises `ValueError` for coefficients of another number of teeth."""
        by_tooth = self._by_tooth()
        for name, values in by_tooth.items():
            if values.shape != (teeth,):
                raise ValueError(
                    f"force.{name}: shape {values.shape} given; it must be one number, or one for each of the {teeth} teeth"
                )
        return dataclasses.replace(self, **{name: values[:, None] for name, values in by_tooth.items()})

    def _by_tooth(self) -> dict[str, Array]:
        """The coefficients that every tooth has for itself."""
        given = {name: getattr(self, name) for name in (*self.OWN, "kr", "ka", "ke", "kre", "kae", "process_damping")}
        return {name: values for name, values in given.items() if values is not None and jnp.ndim(values)}

    @property
    def feels_contact(self) -> bool:
        """Whether some force depends on which part of a step a tooth is in contact, beside its thickness."""
        return self.own_edges is not None or self.process_damping is not None

    @property
    def own_edges(self) -> tuple[Scalar, Scalar] | None:
        """What F_r and F_a are beyond k_r F_t and k_a F_t wherever a tooth is in contact [N/m], None for nothing."""
        if self.kre is None and self.kae is None:
            return None
        ke, kre, kae = self.edges
        return kre - self.kr * ke, jnp.zeros(()) if self.ka is None else kae - self.ka * ke

    @property
    def edges(self) -> tuple[Scalar, Scalar, Scalar]:
        """k_E, k_rE and k_aE [N/m]."""
        ke = jnp.zeros(()) if self.ke is None else self.ke
        axial = jnp.zeros(()) if self.ka is None else self.ka * ke
        return ke, self.kr * ke if self.kre is None else self.kre, axial if self.kae is None else self.kae

    def _with_edge(self, law: Float[Array, "..."], of: Float[Array, "..."] | float = 1.0) -> Float[Array, "..."]:
        """F_t where the law without its edge gives `law`; or W, over a change `of` the thickness."""
        return law if self.ke is None else law + self.ke * of


@eqx.filter_custom_jvp
def work(law: ForceLaw, low: Float[Array, "..."], high: Float[Array, "..."]) -> Float[Array, "..."]:
    """`law.work`, whose derivative by its limits is the force itself: cheaper than to differentiate an integral."""
    return law.work(low, high)


@work.def_jvp
def _work_jvp(primals, tangents):
    law, low, high = primals
    by_law, dlow, dhigh = tangents
    value = law.work(low, high)
    change = jnp.zeros_like(value)
    if jax.tree.leaves(by_law):
        of_law = eqx.filter_jvp(lambda law: law.work(low, high), (law,), (by_law,))[1]
        change = change if of_law is None else change + of_law  # k_a, for one, is not in W
    if dhigh is not None:
        change = change + law.tangential(high) * dhigh
    if dlow is not None:
        change = change - law.tangential(low) * dlow
    return value, change


class LinearLaw(ForceLaw):
    """F_t = k_T h + k_E for h > 0 (E 24), and by default F_r = k_r F_t, F_a = k_a F_t.

    With `kre` or `kae` the forces are those of the linear edge model (Budak, Altintas and Armarego 1996),
    F_r = k_r k_T h + k_rE and F_a = k_a k_T h + k_aE: its K_tc, K_rc, K_ac are k_T, k_r k_T, k_a k_T.

    **Arguments:**

    - `kt`: cutting coefficient k_T [N/m²], > 0.
    - `kr`: radial over tangential force k_r [-].
    - `ke`: edge coefficient k_E [N/m], >= 0.
    - `ka`: axial over tangential force k_a [-], see `ForceLaw`.
    - `kre`: radial edge coefficient k_rE [N/m]; None is k_r k_E.
    - `kae`: axial edge coefficient k_aE [N/m], along +z like F_a; None is k_a k_E. Needs `ka`.
    - `process_damping`: C [N/m], >= 0, see `ForceLaw`. None: none.
    """

    OWN = ("kt",)

    kt: Scalar = eqx.field(converter=as_number)
    kr: Scalar = eqx.field(converter=as_number)
    ke: Scalar = eqx.field(converter=as_number, default=0.0)
    ka: Scalar | None = eqx.field(converter=optional, default=None)
    kre: Scalar | None = eqx.field(converter=optional, default=None)
    kae: Scalar | None = eqx.field(converter=optional, default=None)
    process_damping: Scalar | None = eqx.field(converter=optional, default=None)

    def __check_init__(self):
        positive("force.kt", self.kt, "N/m^2")
        finite("force.kr", self.kr, "")
        _check_options(self)

    def tangential(self, h):
        return self.kt * h + self.ke

    def work(self, low, high):
        return (self.kt * (low + high) / 2 + self.ke) * (high - low)


class ExponentialLaw(ForceLaw):
    """F_t = k_F h^m (E 25).

    **Arguments:**

    - `kf`: k_F [N/m^(1 + m)], > 0: the force per unit depth at h = 1 m.
    - `m`: exponent [-], > 0 (E: < 1). The slope at h = 0, infinite for m < 1, is finite in the step mean.
    - `kr`: radial over tangential force k_r [-].
    - `ka`: axial over tangential force k_a [-], see `ForceLaw`.
    - `ke`, `kre`, `kae`: edge coefficients [N/m], as of `LinearLaw`; k_E is added to F_t. None: no edge force.
    - `process_damping`: C [N/m], >= 0, see `ForceLaw`. None: none.
    """

    OWN = ("kf",)

    kf: Scalar = eqx.field(converter=as_number)
    m: Scalar = eqx.field(converter=as_number)
    kr: Scalar = eqx.field(converter=as_number)
    ka: Scalar | None = eqx.field(converter=optional, default=None)
    ke: Scalar | None = eqx.field(converter=optional, default=None)
    kre: Scalar | None = eqx.field(converter=optional, default=None)
    kae: Scalar | None = eqx.field(converter=optional, default=None)
    process_damping: Scalar | None = eqx.field(converter=optional, default=None)

    def __check_init__(self):
        positive("force.kf", self.kf, "N/m^(1+m)")
        positive("force.m", self.m, "")
        finite("force.kr", self.kr, "")
        _check_options(self)

    def tangential(self, h):
        return self._with_edge(self.kf * h**self.m)

    def work(self, low, high):
        return self._with_edge(self.kf * (high ** (1 + self.m) - low ** (1 + self.m)) / (1 + self.m), high - low)


class FractionalLaw(ForceLaw):
    """F_t = k_0 h_s (u + r u²)/(1 + u), u = h/h_s (E 26, with the factor h_s that its dimensions need).

    dF_t/dh falls from k_0 at h = 0 to r k_0 = k_inf for h >> h_s.

    **Arguments:**

    - `k0`: stiffness of the cut for thin chips, per unit axial depth [N/m²], > 0.
    - `hs`: chip thickness h_s at which the law bends [m], > 0.
    - `r`: k_inf/k_0 [-], >= 0 (E: < 1).
    - `kr`: radial over tangential force k_r [-].
    - `ka`: axial over tangential force k_a [-], see `ForceLaw`.
    - `ke`, `kre`, `kae`: edge coefficients [N/m], as of `LinearLaw`; k_E is added to F_t. None: no edge force.
    - `process_damping`: C [N/m], >= 0, see `ForceLaw`. None: none.
    """

    OWN = ("k0", "hs", "r")

    k0: Scalar = eqx.field(converter=as_number)
    hs: Scalar = eqx.field(converter=as_number)
    r: Scalar = eqx.field(converter=as_number)
    kr: Scalar = eqx.field(converter=as_number)
    ka: Scalar | None = eqx.field(converter=optional, default=None)
    ke: Scalar | None = eqx.field(converter=optional, default=None)
    kre: Scalar | None = eqx.field(converter=optional, default=None)
    kae: Scalar | None = eqx.field(converter=optional, default=None)
    process_damping: Scalar | None = eqx.field(converter=optional, default=None)

    def __check_init__(self):
        positive("force.k0", self.k0, "N/m^2")
        positive("force.hs", self.hs, "m")
        not_negative("force.r", self.r, "")
        finite("force.kr", self.kr, "")
        _check_options(self)

    def tangential(self, h):
        u = h / self.hs
        return self._with_edge(self.k0 * self.hs * (u + self.r * u**2) / (1 + u))

    def work(self, low, high):
        per_hs = 1 / self.hs
        u, step = low * per_hs, (high - low) * per_hs
        # log1p of the ratio, not a difference of logarithms: short steps lose no digits.
        area = self.r * step * (u + step / 2) + (1 - self.r) * (step - log1p(step / (1 + u)))
        return self._with_edge(self.k0 * self.hs**2 * area, high - low)


class UnitLaw(ForceLaw):
    """F_t = 1 N/m wherever there is contact: its mean over a step is the part of the step in contact."""

    kr: Scalar = eqx.field(converter=as_number, default=0.0)
    ka: Scalar | None = None

    def tangential(self, h):
        return jnp.ones_like(h)

    def work(self, low, high):
        return high - low


def _check_options(law: ForceLaw) -> None:
    for name in ("process_damping", "ke"):
        if getattr(law, name) is not None:
            not_negative(f"force.{name}", getattr(law, name), "N/m")
    for name, unit in (("ka", ""), ("kre", "N/m"), ("kae", "N/m")):
        if getattr(law, name) is not None:
            finite(f"force.{name}", getattr(law, name), unit)
    if law.kae is not None and law.ka is None:
        raise ValueError("force.kae: given without force.ka; give both, ka = 0 if the axial force is of the edge alone")
