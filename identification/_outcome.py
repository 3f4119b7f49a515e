"""From the optimum of a fit to its result: values, intervals and words, in the units of a person."""

import importlib.metadata
import platform
from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np

from ._colour import Colour, band
from ._evaluate import Evaluation
from ._noise import Noise, NoiseModel
from ._parameters import FreeParameters
from ._question import Question
from ._result import Estimate, FitResult, TraceFit
from ._starts import Waterfall
from ._uncertainty import Uncertainty


@dataclass(frozen=True)
class Optimum:
    """Where a fit ended: coordinates, noise, the evaluation there if there is one, what is known, and what is left."""

    y: np.ndarray
    noise: Noise
    evaluation: Evaluation | None
    known: Uncertainty
    left: Colour | None


def verdict(asked: Question, known: Uncertainty, left: Colour) -> tuple[str, str]:
    """Status and message of a fit that reached an optimum."""
    reasons = dict.fromkeys(reason for reason in known.reason if reason)
    coloured = widening(asked, known, left)
    if not all(known.identifiable):
        status = "not_identifiable"
    elif any(known.at_bound):
        status = "at_bound"
    else:
        return "converged", f"All {len(asked.numbers)} parameters found.{coloured}"
    return status, ". ".join(reason[0].upper() + reason[1:] for reason in reasons) + f".{coloured}"


def widening(asked: Question, known: Uncertainty, left: Colour) -> str:
    """What is said of residuals that are not white; nothing where they are."""
    channels = [f"{channel} of {one.name}" for one in asked.measured for channel in one.channels]
    coloured = [channel for channel, order in zip(channels, left.orders, strict=True) if order]
    factors = [factor for factor, std in zip(known.widened, known.std, strict=True) if std is not None]
    if not coloured or not factors:
        return ""
    which = "all channels" if len(coloured) == len(channels) else ", ".join(coloured)
    return (
        f" The residuals of {which} are not white; the standard errors allow for that: they are {min(factors):.2g} to "
        f"{max(factors):.2g} times those for white noise."
    )


def outcome(
    asked: Question,
    optimum: Optimum,
    *,
    status: str,
    message: str,
    begun: bool,
    noise_model: NoiseModel,
    solver: str,
    iterations: int,
    seconds: float,
    waterfall: Waterfall | None,
) -> FitResult:
    """The `FitResult`; `asked` holds the cases with the settings that the fit needed."""
    numbers, y = asked.numbers, jnp.asarray(optimum.y)
    fitted = [numbers.insert(case, y, place) for place, case in enumerate(asked.cases)]
    return FitResult(
        status=status,
        message=message,
        parameters=_estimates(numbers, optimum.y, optimum.known),
        correlation=optimum.known.correlation,
        traces=_trace_fits(asked, optimum),
        cases=tuple(fitted[i] for i in asked.case_of),
        begun=begun,
        cost=np.nan if optimum.evaluation is None else optimum.evaluation.cost(np.asarray(optimum.noise.sigma)),
        iterations=iterations,
        seconds=seconds,
        versions=versions(),
        noise_model=noise_model,
        solver=solver,
        asked=asked,
        y=optimum.y,
        noise=optimum.noise,
        covariance=optimum.known.covariance,
        seed=None if waterfall is None else waterfall.seed,
        waterfall=waterfall,
    )


def _trace_fits(asked: Question, optimum: Optimum) -> tuple[TraceFit, ...]:
    found = optimum.evaluation
    if found is None:
        return ()
    sigma = iter(np.asarray(optimum.noise.sigma).tolist())
    orders = iter([0] * len(asked.samples) if optimum.left is None else optimum.left.orders)
    bands = [None] * len(found.fitted) if optimum.left is None else band(found, optimum.known.covariance)
    return tuple(
        TraceFit(
            one,
            np.asarray(fitted).T,
            {channel: next(sigma) for channel in one.channels},
            None if std is None else std.T,
            {channel: next(orders) for channel in one.channels},
        )
        for one, fitted, std in zip(asked.measured, found.fitted, bands, strict=True)
    )


def _estimates(numbers: FreeParameters, y: np.ndarray, known: Uncertainty) -> tuple[Estimate, ...]:
    values = np.asarray(numbers.values(jnp.asarray(y)))

    def estimate(i: int) -> Estimate:
        def shown(x):
            return numbers.shown(i, float(x))

        std, ci95, bounds = known.std[i], known.ci95[i], (numbers.low[i], numbers.high[i])
        return Estimate(
            name=numbers.names[i],
            value=shown(values[i]),
            unit=numbers.units[i],
            std=None if std is None else shown(std),
            ci95=None if ci95 is None else (shown(ci95[0]), shown(ci95[1])),
            at_bound=known.at_bound[i],
            identifiable=known.identifiable[i],
            reason=known.reason[i],
            guess=shown(numbers.guess[i]),
            bounds=(
                shown(bounds[0]) if np.isfinite(bounds[0]) else None,
                shown(bounds[1]) if np.isfinite(bounds[1]) else None,
            ),
            widened=float(known.widened[i]),
        )

    return tuple(estimate(i) for i in range(len(numbers)))


def versions() -> dict[str, str]:
    """The programs that a fit rests on."""
    packages = ("millax", "jax", "optimistix", "equinox", "numpy", "scipy")
    return {"python": platform.python_version()} | {name: importlib.metadata.version(name) for name in packages}
