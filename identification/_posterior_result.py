"""What draws from the posterior of a fit say, and whether they can be trusted."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ._evaluate import Model
from ._result import FitResult

RHAT, ESS = 1.01, 400.0
"""R-hat from which on, and effective number of draws below which, a posterior is not to be trusted (Vehtari et al. 2021)."""

MEAN_AGREES, STD_AGREES, INTERVAL_AGREES = 0.2, 0.1, 0.3
"""Up to which distance of the mean from the estimate, in standard errors, relative difference of the standard deviation, and
distance of the ends of the 95 % intervals a posterior is as the fit says."""


@dataclass(frozen=True)
class Posterior:
    """Draws from the posterior of a fit.

    **Attributes:**

    - `status`: "sampled", or "interrupted" where the user stopped it.
    - `names`, `units`: of the parameters, in the order of the fit.
    - `draws`: their values in `units`, shape (chains, draws, n); `y` the solver's coordinates of the same.
    - `estimate`, `error`: value and standard error that the fit gave, in `units`, shape (n,); `interval` its 95 % intervals,
      shape (n, 2).
    - `rhat`, `ess`: rank-normalised split R-hat, and bulk effective sample size (Vehtari et al. 2021), shape (n,).
    - `divergences`: draws whose path could not be followed; `failures`: of them, those that came to where the simulation
      cannot be used.
    - `acceptance`: mean rate, near the one asked for where all is well.
    - `gradients`: of the posterior that were computed, those of the warm-up included.
    - `seconds`: wall time, compilation included.
    - `seed`: of the random numbers.
    - `reason`: why the posterior must not be trusted, with what to try; None where nothing speaks against it.
    """

    status: str
    names: tuple[str, ...]
    units: tuple[str, ...]
    draws: Float[np.ndarray, "chains draws n"]
    y: Float[np.ndarray, "chains draws n"]
    estimate: Float[np.ndarray, " n"]
    error: Float[np.ndarray, " n"]
    interval: Float[np.ndarray, "n 2"]
    rhat: Float[np.ndarray, " n"]
    ess: Float[np.ndarray, " n"]
    divergences: int
    failures: int
    acceptance: float
    gradients: int
    seconds: float
    seed: int
    reason: str | None

    @property
    def mean(self) -> Float[np.ndarray, " n"]:
        return self.draws.mean(axis=(0, 1))

    @property
    def std(self) -> Float[np.ndarray, " n"]:
        return self.draws.std(axis=(0, 1), ddof=1)

    @property
    def ci95(self) -> Float[np.ndarray, "n 2"]:
        """The middle 95 % of the draws."""
        return self.quantiles([0.025, 0.975]).T

    def quantiles(self, q: float | Sequence[float]) -> Float[np.ndarray, "... n"]:
        """Of the draws, 0 <= `q` <= 1."""
        return np.quantile(self.draws, q, axis=(0, 1))

    @property
    def shift(self) -> Float[np.ndarray, " n"]:
        """How far the mean lies from the estimate of the fit, in its standard errors."""
        return (self.mean - self.estimate) / self.error

    @property
    def ratio(self) -> Float[np.ndarray, " n"]:
        """The standard deviation over the standard error of the fit."""
        return self.std / self.error

    @property
    def agrees(self) -> bool:
        """Whether the fit, which takes the posterior for normal in the solver's coordinates (Laplace's approximation), says
        the same: means within 0.2 standard errors, standard deviations within 10 %, ends of intervals within 0.3."""
        ends = np.abs(self.ci95 - self.interval) / self.error[:, None]
        means, widths = np.abs(self.shift), np.abs(self.ratio - 1)
        return bool(max(means.max() / MEAN_AGREES, widths.max() / STD_AGREES, ends.max() / INTERVAL_AGREES) <= 1)

    def bands(self, result: FitResult, draws: int = 100) -> list[tuple[np.ndarray, np.ndarray]]:
        """Between which values the model lies with 95 %, by what is not known of the parameters: the noise comes on top.

        **Arguments:**

        - `result`: the fit that was sampled.
        - `draws`: how many are simulated, spread evenly over all of them; their traces are held in memory at once.

        Returns (low, high) of each trace and load test in SI units, shape (samples, channels) each, as `TraceFit.fitted`.

        Raises `ValueError` for another fit, and for fewer than two draws.
        """
        if result.asked.numbers.names != self.names:
            raise ValueError(
                f"result: a fit of {', '.join(result.asked.numbers.names)} given; these are draws of {', '.join(self.names)}"
            )
        if draws < 2:
            raise ValueError(f"draws: {draws} given; it must be at least 2")
        every = self.y.reshape(-1, len(self.names))
        chosen = every[np.linspace(0, len(every) - 1, min(draws, len(every))).round().astype(int)]
        found = _fitted(result.asked.model, jnp.asarray(chosen))
        ends = [np.quantile(np.asarray(one), [0.025, 0.975], axis=0) for one in found]
        return [(low.T, high.T) for low, high in ends]

    def to_json(self) -> dict[str, Any]:
        """What there is to say of it: plain dictionaries, lists and numbers, without the draws."""
        chains, draws, _ = self.draws.shape
        columns = zip(
            self.names, self.units, self.mean, self.std, self.ci95, self.rhat, self.ess, self.shift, self.ratio, strict=True
        )
        return {
            "status": self.status,
            "reason": self.reason,
            "agrees_with_fit": self.agrees,
            "parameters": [
                {
                    "name": name,
                    "unit": unit,
                    "mean": float(mean),
                    "std": float(std),
                    "ci95": ci95.tolist(),
                    "rhat": float(rhat),
                    "ess": float(ess),
                    "shift": float(shift),
                    "std_ratio": float(ratio),
                }
                for name, unit, mean, std, ci95, rhat, ess, shift, ratio in columns
            ],
            "chains": chains,
            "draws": draws,
            "divergences": self.divergences,
            "failures": self.failures,
            "acceptance": self.acceptance,
            "gradients": self.gradients,
            "seconds": round(self.seconds, 3),
            "seed": self.seed,
        }


@jax.jit
def _diagnostics(draws):
    from blackjax.diagnostics import ess_bulk, rhat

    return rhat(draws), ess_bulk(draws)


def mixing(draws: Float[np.ndarray, "chains draws n"]) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """R-hat and bulk effective sample size of each parameter."""
    rhat, ess = _diagnostics(jnp.asarray(draws))
    return np.atleast_1d(rhat), np.atleast_1d(ess)


def doubt(names, rhat, ess, divergences: int, failures: int, draws: int) -> str | None:
    """Why a posterior must not be trusted; None where nothing speaks against it."""
    reasons = []
    apart = [name for name, one in zip(names, rhat, strict=True) if not one < RHAT]
    if apart:
        reasons.append(
            f"the chains do not agree on {', '.join(apart)} (R-hat up to {np.max(rhat):.3f}, it must be below {RHAT:g}): "
            "give more draws and a longer warmup"
        )
    few = [name for name, one in zip(names, ess, strict=True) if not one >= ESS]
    if few:
        reasons.append(
            f"of {', '.join(few)} there are only {np.min(ess):.0f} independent draws, {ESS:g} are needed: give more draws"
        )
    if divergences:
        what = f"{divergences} of {draws} paths could not be followed"
        if failures:
            what += f", {failures} of them to where the simulation cannot be used"
        tries = "shorter steps (acceptance=0.95, with a longer warmup), bounds or priors" + (
            ", more sweeps" if failures else ""
        )
        reasons.append(f"{what}, and the draws may miss a part of the posterior: try {tries}")
    return ". ".join(reason[0].upper() + reason[1:] for reason in reasons) or None


@eqx.filter_jit
def _fitted(model: Model, y: Float[Array, "draws n"]):
    return jax.lax.map(lambda one: model.predict(one).fitted, y)
