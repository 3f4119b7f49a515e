"""What a fit found, for programs and for files."""

import math
import os
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from millax import Case

from ._loadtest import LoadTest
from ._noise import Noise, NoiseModel
from ._question import Question
from ._starts import Waterfall
from ._store import load, save
from ._traces import Trace

if TYPE_CHECKING:
    from ._posterior_result import Posterior
    from ._profile import Profile

CONTENT = "result of a fit"

STATUS = {
    "converged": "every parameter is known",
    "not_identifiable": "the measurements do not determine every parameter",
    "at_bound": "a bound decides a parameter, not the measurements",
    "not_converged": "the solver did not reach an optimum",
    "interrupted": "stopped before the optimum",
    "cannot_start": "there is nothing to start from at the guess",
}
"""The possible outcomes of a fit. Only "converged" is an answer to the whole question."""


@dataclass(frozen=True)
class Estimate:
    """One fitted parameter, its numbers in `unit`.

    `std` and `ci95` are None where no uncertainty can be given; `reason` then says why. `widened` is by how much they are
    larger than they would be if what is left of the measurements were white noise.
    """

    name: str
    value: float
    unit: str
    std: float | None
    ci95: tuple[float, float] | None
    at_bound: bool
    identifiable: bool
    reason: str | None
    guess: float
    bounds: tuple[float | None, float | None]
    widened: float = 1.0

    def to_json(self) -> dict[str, Any]:
        return {
            "name": self.name,
            "value": self.value,
            "unit": self.unit,
            "std": self.std,
            "ci95": self.ci95 and list(self.ci95),
            "at_bound": self.at_bound,
            "identifiable": self.identifiable,
            "reason": self.reason,
            "guess": self.guess,
            "bounds": list(self.bounds),
            "widened": self.widened,
        }


@dataclass(frozen=True)
class TraceFit:
    """A trace or load test beside the fitted model.

    **Attributes:**

    - `trace`: what was measured.
    - `fitted`: the model, SI, shape (samples, channels): at the sample times, or of each deflection.
    - `sigma`: standard deviation of the noise per channel, SI, known or estimated; with outliers the scale of Student's t.
    - `fitted_std`: standard error of `fitted`, by what is not known of the parameters; None where there is no optimum.
    - `orders`: of the autoregressive process that the residuals of each channel seem to come from; 0 where they are white.
    """

    trace: Trace | LoadTest
    fitted: np.ndarray
    sigma: Mapping[str, float]
    fitted_std: np.ndarray | None
    orders: Mapping[str, int]

    @property
    def residuals(self) -> np.ndarray:
        """Measured - fitted, SI, shape (samples, channels)."""
        return self.trace.values - self.fitted

    @property
    def r2(self) -> dict[str, float | None]:
        """1 - (residual sum of squares)/(sum of squares about the mean) per channel; None for a constant channel."""
        about_mean = ((self.trace.values - self.trace.values.mean(0)) ** 2).sum(0)
        unexplained = (self.residuals**2).sum(0)
        return {
            channel: float(1 - u / a) if a > 0 else None
            for channel, u, a in zip(self.trace.channels, unexplained, about_mean, strict=True)
        }

    @property
    def rmse(self) -> dict[str, float]:
        """Root mean square of the residuals per channel, SI."""
        rms = np.sqrt((self.residuals**2).mean(0))
        return {channel: float(x) for channel, x in zip(self.trace.channels, rms, strict=True)}

    def to_json(self) -> dict[str, Any]:
        shown = self.trace.shown
        return {
            "name": self.trace.name,
            "samples": self.trace.samples,
            "r2": {channel: _finite(x) for channel, x in self.r2.items()},
            "rmse": {channel: _finite(shown(channel, x)) for channel, x in self.rmse.items()},
            "noise": {channel: _finite(shown(channel, x)) for channel, x in self.sigma.items()},
            "residuals_order": dict(self.orders),
            "noise_estimated": [channel for channel in self.trace.channels if channel not in self.trace.noise],
            "units": {channel: self.trace.unit(channel) for channel in self.trace.channels},
        }


@dataclass(frozen=True)
class FitResult:
    """The outcome of a fit.

    **Attributes:**

    - `status`: a key of `identification.STATUS`; "converged" is the good one.
    - `message`: the outcome in words, with what to try.
    - `parameters`: the estimates, in the order asked for.
    - `correlation`: of the estimates, shape (n, n); NaN where no uncertainty can be given.
    - `traces`: each trace and load test beside the fitted model, in the order given.
    - `cases`: of each of them, its case with the estimates in it.
    - `begun`: whether there was anything to start from; if not, the estimates are the guesses.
    - `cost`: sum of the squares of the independent residuals over their noise, and of what was known before; NaN where
      nothing could be simulated.
    - `iterations`: evaluations of model and Jacobian.
    - `seconds`: wall time, compilation included.
    - `versions`: of the programs that made it.
    - `noise_model`, `solver`: as they were asked for.
    - `asked`: the question, as it was put to the solver.
    - `y`: the solver's coordinates of the estimates, shape (n,), and `covariance` theirs, NaN where it is not known.
    - `noise`: of all channels, one trace or load test after the other.
    - `seed`: of random numbers; None where none are drawn.
    - `waterfall`: where fits from other starts ended; None where there was one start.
    - `profiles`: of the likelihood, see `profile`; none where they were not asked for.
    - `posterior`: drawn, see `sample`; None where it was not asked for.
    """

    status: str
    message: str
    parameters: tuple[Estimate, ...]
    correlation: np.ndarray
    traces: tuple[TraceFit, ...]
    cases: tuple[Case, ...]
    begun: bool
    cost: float
    iterations: int
    seconds: float
    versions: Mapping[str, str]
    noise_model: NoiseModel
    solver: str
    asked: Question
    y: np.ndarray
    noise: Noise
    covariance: np.ndarray
    seed: int | None = None
    waterfall: Waterfall | None = None
    profiles: tuple["Profile", ...] = ()
    posterior: "Posterior | None" = None

    @property
    def case(self) -> Case:
        """The case of the first trace or load test, with the estimates in it."""
        return self.cases[0]

    @property
    def success(self) -> bool:
        """Whether the whole question is answered."""
        return self.status == "converged"

    @property
    def has_optimum(self) -> bool:
        """Whether the fit reached one, known or not."""
        return self.begun and self.status in ("converged", "at_bound", "not_identifiable")

    def __getitem__(self, name: str) -> Estimate:
        """The estimate of the parameter called `name`."""
        for estimate in self.parameters:
            if estimate.name == name:
                return estimate
        raise KeyError(f"{name} was not free; free were {', '.join(e.name for e in self.parameters)}")

    def save(self, path: str | os.PathLike) -> None:
        """Keep everything in one HDF5 file, "fit.h5", from which `identification.load_result` gives back the same result,
        bit for bit: the question with its measurements and cases, estimates and covariance, the fitted model.

        Raises `ValueError` where a case holds an object that is not of millax, such as a force law of your own; `OSError`
        where the file cannot be written. What was there before then stays.
        """
        save(path, CONTENT, self)

    def to_json(self) -> dict[str, Any]:
        """The content of `result.json`: plain dictionaries, lists and numbers, None for what is not known."""
        return {
            "status": self.status,
            "message": self.message,
            "parameters": [estimate.to_json() for estimate in self.parameters],
            "correlation": [[_finite(x) for x in row] for row in self.correlation],
            "traces": [trace.to_json() for trace in self.traces],
            "noise": {
                "distribution": self.noise_model.distribution,
                "degrees": self.noise_model.degrees if self.noise_model.distribution == "student" else None,
                "order": self.noise_model.order,
            },
            "solver": self.solver,
            "starts": None if self.waterfall is None else self.waterfall.to_json(),
            "profiles": [one.to_json() for one in self.profiles],
            "posterior": None if self.posterior is None else self.posterior.to_json(),
            "iterations": self.iterations,
            "seconds": round(self.seconds, 3),
            "versions": dict(self.versions),
            "seed": self.seed,
        }


def load_result(path: str | os.PathLike) -> FitResult:
    """The result that `FitResult.save` kept in the file `path`, complete: what follows a fit can follow it.

    Raises `ValueError` for a file that is no such result, is damaged, or comes from a version of millax whose results have
    other fields; `OSError` where it cannot be read. Nothing in the file is run: it may come from anybody.
    """
    return load(path, CONTENT, FitResult)


def _finite(x: float | None) -> float | None:
    """JSON has no NaN."""
    return float(x) if x is not None and math.isfinite(x) else None
