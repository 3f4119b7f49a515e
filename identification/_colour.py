"""Residuals that are not white: recognised, and what they do to uncertainties.

Least squares is still right on average where noise is correlated in time, but (J^T J)^-1 is not its covariance: that is

    (J^T J)^-1  (J^T R J)  (J^T J)^-1,

R being the correlation of the residuals e over their size. R is that of an autoregressive process, fitted to the residuals
of each channel with the order that the Bayesian information criterion asks for; order 0 is white. Channels are taken to
scatter independently of each other.
"""

from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from scipy.signal import lfilter

from ._compare import Comparison
from ._evaluate import Evaluation, Model
from ._noise import Noise, predictor, reflections

ORDERS = 60
"""Highest order looked at; at most one for 20 samples."""


@dataclass(frozen=True)
class Colour:
    """The correlation that residuals have left.

    - `orders`: of the autoregressive process of each channel; 0 where it is white.
    - `information`: J^T R J, with what was known before; None where every channel is white.
    """

    orders: tuple[int, ...]
    information: Float[np.ndarray, "n n"] | None


def colour(model: Model, noise: Noise, evaluation: Evaluation) -> Colour:
    """The `Colour` of the residuals of an evaluation at the optimum."""
    orders, total = [], np.asarray(evaluation.prior)[:, :-1].T @ np.asarray(evaluation.prior)[:, :-1]
    parts = zip(model.comparisons, model.noises(noise), model.residuals(evaluation.fitted), evaluation.changes, strict=True)
    for one, part, residuals, changes in parts:
        errors, jacobian = (np.asarray(x) for x in _independent(part, residuals, changes))
        for channel, error in enumerate(errors):
            fitted = process(error) if isinstance(one, Comparison) else np.zeros(0)
            orders.append(len(fitted))
            total = total + noise.information * correlated_square(jacobian[:, channel], fitted)
    return Colour(tuple(orders), total if any(orders) else None)


@jax.jit
def _independent(noise: Noise, residuals: Array, changes: Array) -> tuple[Array, Array]:
    """Independent residuals over the size of their noise, and their derivatives."""
    errors, along = jax.linearize(noise.independent, residuals)
    return errors / noise.sigma[:, None], jax.vmap(along)(changes) / noise.sigma[:, None]


def process(errors: Float[np.ndarray, " samples"]) -> Float[np.ndarray, " p"]:
    """Reflection coefficients of the autoregressive process that residuals seem to come from; none for white ones.

    Of all orders the one with the smallest n log(v_p) + p log(n), v_p the variance of the error of prediction.
    """
    n = len(errors)
    found = reflections(errors[None], min(ORDERS, n // 20))[0]
    left = np.concatenate([[0.0], np.cumsum(np.log1p(-np.minimum(found**2, 1 - 1e-12)))])
    return found[: int(np.argmin(n * left + np.arange(len(left)) * np.log(n)))]


def correlated_square(
    jacobian: Float[np.ndarray, "n samples"], reflection: Float[np.ndarray, " p"]
) -> Float[np.ndarray, "n n"]:
    """J R J^T, R the correlation matrix of an autoregressive process: R = v L L^T, L its impulse response as a lower
    triangular matrix and v the part of the variance that is not predicted, but for the first few samples."""
    if len(reflection) == 0:
        return jacobian @ jacobian.T
    along = np.asarray(lfilter([1.0], np.concatenate([[1.0], -predictor(reflection)]), jacobian[:, ::-1], axis=1))
    return float(np.prod(1 - reflection**2)) * (along @ along.T)


def band(evaluation: Evaluation, covariance: Float[np.ndarray, "n n"]) -> tuple[Float[np.ndarray, "channels samples"], ...]:
    """Standard error of the fitted model [SI], of each trace and load test: sqrt(J C J^T) sample by sample, C the covariance
    of the coordinates. Parameters whose uncertainty is not known count as known exactly."""
    known = np.nan_to_num(covariance)
    return tuple(
        np.sqrt(np.maximum(np.asarray(jnp.einsum("ics,ij,jcs->cs", change, known, change)), 0.0))
        for change in evaluation.changes
    )
