"""Information about parameters: adding it, taking out what nobody asks for, and what it leaves unknown.

A factor F stands for the Fisher information F^T F about the solver's coordinates y, with rows in units of the noise: a
Jacobian, whitened. Information of independent measurements adds, so their factors are put one below the other. The matrix
F^T F itself is never made: it would halve the digits.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from ._uncertainty import INVOLVED, RANK, insensitive


class Knowledge(NamedTuple):
    """What information says of n parameters. Leading axes are a batch.

    - `std`: standard errors of y; infinite where the information leaves a parameter open.
    - `left`: how many combinations of the parameters are left open.
    - `radius`: geometric mean of the semi-axes of the ellipsoid of y that is 68 % probable along each of them, of those axes
      that are known: det(F^T F)^(-1/2n) where all are. Infinite where none is.
    """

    std: Float[np.ndarray, "... n"]
    left: Int[np.ndarray, "..."]
    radius: Float[np.ndarray, "..."]

    def of(self, i: int) -> "Knowledge":
        """Of one of a batch."""
        return Knowledge(*(column[i] for column in self))


def knowledge(factors: Float[np.ndarray, "... rows n"]) -> Knowledge:
    """What the information of `factors` says. A combination counts as open, and a parameter in it, as in `_uncertainty`."""
    rows, n = factors.shape[-2:]
    if rows < n:
        factors = np.concatenate([factors, np.zeros((*factors.shape[:-2], n - rows, n))], axis=-2)
    scale = np.where(insensitive(factors), np.inf, np.linalg.norm(factors, axis=-2))
    _, s, directions = np.linalg.svd(factors / scale[..., None, :], full_matrices=False)
    known = s > RANK * s[..., :1]
    involved = (np.abs(directions) > INVOLVED) & ~known[..., None]
    with np.errstate(divide="ignore"):
        weights = np.where(known, 1 / s, 0.0)
        axes = -np.log(np.linalg.svd(factors, compute_uv=False))
    variance = np.sum((weights[..., None] * directions) ** 2, axis=-2) / scale**2
    number = known.sum(axis=-1)
    mean = np.where(known, axes, 0.0).sum(axis=-1) / np.maximum(number, 1)
    return Knowledge(
        std=np.where(involved.any(axis=-2), np.inf, np.sqrt(variance)),
        left=n - number,
        radius=np.where(number > 0, np.exp(mean), np.inf),
    )


def added(factor: Float[np.ndarray, "rows n"], others: Float[np.ndarray, "... more n"]) -> Float[np.ndarray, "... r n"]:
    """The factor of one information together with each of others."""
    return np.concatenate([np.broadcast_to(factor, (*others.shape[:-2], *factor.shape)), others], axis=-2)


def marginal(jacobian: Float[np.ndarray, "rows n"], kept: Float[np.ndarray, " n"]) -> Float[np.ndarray, "k k"]:
    """The factor of what the measurements say about the parameters that are `kept`, while the others are free as well.

    Its information is the Schur complement A - B D^-1 B^T of the whole, D the block of the others: the inverse of the block
    of the covariance that belongs to those kept. It is made by taking from the columns kept what the others reach.
    """
    ours, others = jacobian[:, kept], jacobian[:, ~kept]
    length = np.linalg.norm(others, axis=0)
    basis, s, _ = np.linalg.svd(others[:, length > 0] / length[length > 0], full_matrices=False)
    basis = basis[:, s > RANK * s[0]] if len(s) else basis
    left = ours - basis @ (basis.T @ ours)
    every = np.concatenate([left, np.zeros((ours.shape[1], ours.shape[1]))])
    return np.asarray(np.linalg.qr(every, mode="r"))
