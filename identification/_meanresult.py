"""What mean forces say of the force coefficients."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from millax import LinearLaw

COEFFICIENTS = {"ktc": "N/m^2", "krc": "N/m^2", "kac": "N/m^2", "kte": "N/m", "kre": "N/m", "kae": "N/m"}
"""Every coefficient and its unit."""


@dataclass(frozen=True)
class Coefficient:
    """A force coefficient in SI units; `value` and `std` are None where it cannot be known, and `reason` then says why."""

    name: str
    value: float | None
    unit: str
    std: float | None
    reason: str | None


@dataclass(frozen=True)
class CutMeans:
    """The mean forces of one cut.

    **Attributes:**

    - `name`: of its trace.
    - `feed_per_tooth`: f_z [m].
    - `turns`: whole turns in steady cutting, over which the means are taken.
    - `channels`: those of Fx, Fy, Fz that were measured.
    - `measured`: mean forces on the tool [N], shape (channels,).
    - `std`: their standard errors by the scatter from turn to turn [N], shape (channels,).
    - `fitted`: what the coefficients make of them [N], shape (channels,).
    """

    name: str
    feed_per_tooth: float
    turns: int
    channels: tuple[str, ...]
    measured: Float[np.ndarray, " channels"]
    std: Float[np.ndarray, " channels"]
    fitted: Float[np.ndarray, " channels"]


@dataclass(frozen=True)
class MeanForceFit:
    """Force coefficients from mean forces.

    **Attributes:**

    - `coefficients`: k_tc, k_rc, k_ac [N/m²], k_te, k_re, k_ae [N/m], in the order of `COEFFICIENTS`.
    - `cuts`: measured and fitted means, in the order given.
    - `misfit`: per channel, standard deviation of what the linear law misses of a mean beyond its scatter [N]; 0 where the
      scatter explains all, None where there are too few means to tell.
    """

    coefficients: tuple[Coefficient, ...]
    cuts: tuple[CutMeans, ...]
    misfit: Mapping[str, float | None]

    def __getitem__(self, name: str) -> Coefficient:
        """The coefficient called `name`."""
        if name not in COEFFICIENTS:
            raise KeyError(f"{name} is no force coefficient; there are {', '.join(COEFFICIENTS)}")
        return self.coefficients[list(COEFFICIENTS).index(name)]

    @property
    def r2(self) -> dict[str, float | None]:
        """1 - (residual sum of squares)/(sum of squares about the average) of the means of each channel. Where the cuts
        differ in feed alone, that of a straight line against feed. None for fewer than 3 cuts: a line meets two points."""
        found = {}
        for channel in self.misfit:
            having = [(cut, cut.channels.index(channel)) for cut in self.cuts if channel in cut.channels]
            measured, fitted = np.array([(cut.measured[i], cut.fitted[i]) for cut, i in having]).T
            about = ((measured - measured.mean()) ** 2).sum()
            found[channel] = float(1 - ((measured - fitted) ** 2).sum() / about) if len(having) > 2 and about > 0 else None
        return found

    def law(self) -> LinearLaw:
        """The linear law with these coefficients, a start for a fit: k_T = k_tc, k_r = k_rc/k_tc, k_a = k_ac/k_tc.

        Without both axial coefficients it has no axial force. An edge coefficient k_te < 0, which the law does not allow and
        noise can make of a small one, counts as 0. Raises `ValueError` where k_tc, k_rc, k_te or k_re is not known, and
        where k_tc is not positive.
        """
        ktc, krc, kte, kre = (self._known(name) for name in ("ktc", "krc", "kte", "kre"))
        kac, kae = self["kac"].value, self["kae"].value
        if not ktc > 0:
            raise ValueError(
                f"ktc is {ktc:.4g} N/m^2; it must be greater than 0. Are the forces those on the tool, along the feed (x) "
                "and to its left (y), and does the tool turn clockwise?"
            )
        axial = {} if kac is None or kae is None else {"ka": kac / ktc, "kae": kae}
        return LinearLaw(kt=ktc, kr=krc / ktc, ke=max(kte, 0.0), kre=kre, **axial)

    def _known(self, name: str) -> float:
        value, reason = self[name].value, self[name].reason
        if value is None:
            raise ValueError(f"{name} is not known, and without it there is no force law: {reason}")
        return value
