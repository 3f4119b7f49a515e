"""Weighted linear least squares that say which unknowns cannot be known, and what the model misses beyond the noise."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.optimize import brentq

from ._uncertainty import RANK

NOTHING = 1e-12
"""An unknown that changes what was measured by less than this, over what the others do, does so by rounding."""


@dataclass(frozen=True)
class Weighted:
    """The solution of a weighted linear least-squares problem with n unknowns.

    **Attributes:**

    - `value`, `std`: of each unknown, shape (n,); of those that cannot be known they mean nothing.
    - `open`: projector onto the changes of the scaled unknowns that change nothing, shape (n, n).
    - `misfit`: standard deviation of what the model misses, None where there are no more measurements than knowns to tell.
    """

    value: Float[np.ndarray, " n"]
    std: Float[np.ndarray, " n"]
    open: Float[np.ndarray, "n n"]
    misfit: float | None

    def among(self, i: int) -> list[int]:
        """The unknowns that unknown `i` cannot be told apart from, itself included; none where it is known."""
        return [k for k, shared in enumerate(self.open[i]) if abs(shared) > RANK**0.5]


def weighted(design: Float[np.ndarray, "m n"], measured: Float[np.ndarray, " m"], std: Float[np.ndarray, " m"]) -> Weighted:
    """Unknowns x with which `design @ x` is nearest to `measured`.

    The variance of each measurement is std² + s². The misfit s is 0 where the weighted squares of the residuals then sum to
    no more than their number of degrees of freedom, and otherwise such that they sum to just that (Mandel and Paule, Anal.
    Chem. 42, 1970, 1194-1197). Standard errors follow from this variance.
    """
    size = np.linalg.norm(design, axis=0)
    scale = np.where(size > NOTHING * size.max(), size, np.inf)
    strength, directions = np.linalg.eigh((design / scale).T @ (design / scale))
    known = strength > RANK**2 * strength[-1]
    unscale = directions[:, known] / scale[:, None]
    reduced = design @ unscale

    def residuals(variance):
        """Weighted, and the solution they are of."""
        weight = 1 / np.sqrt(variance)
        z = np.linalg.lstsq(reduced * weight[:, None], measured * weight)[0]
        return (measured - reduced @ z) * weight, z

    def excess(extra):
        """By how much the squares sum to more than they should; it falls with the variance."""
        return float((residuals(std**2 + extra)[0] ** 2).sum()) - freedom

    freedom, extra = len(measured) - int(known.sum()), 0.0
    if freedom and excess(0.0) > 0:
        # With this variance alone the sum would be just right, and with std² beside it, it is less.
        most = float((residuals(np.ones_like(std))[0] ** 2).sum()) / freedom
        extra = float(brentq(excess, 0.0, most))  # pyright: ignore[reportArgumentType]
    z = residuals(std**2 + extra)[1]
    covariance = unscale @ np.linalg.inv((reduced.T / (std**2 + extra)) @ reduced) @ unscale.T
    return Weighted(
        value=unscale @ z,
        std=np.sqrt(np.diag(covariance)),
        open=directions[:, ~known] @ directions[:, ~known].T,
        misfit=float(np.sqrt(extra)) if freedom else None,
    )


def reasons(names: Sequence[str], found: Weighted) -> list[str | None]:
    """Why each unknown cannot be known; None where it can."""
    said: list[str | None] = []
    for i, name in enumerate(names):
        among = [names[k] for k in found.among(i)]
        many = f"{', '.join(among)} cannot be told apart by what was measured"
        said.append((many if len(among) > 1 else f"{name} changes nothing that was measured") if among else None)
    return said
