"""The posterior of a fit by sampling: what is known of the parameters where they do not scatter normally."""

import math
import time
from collections.abc import Callable

import jax
import numpy as np

from ._noise import HIGHEST_ORDER
from ._posterior_result import Posterior, doubt, mixing
from ._result import FitResult
from ._running import Progress

COLOURED = 0.1
"""By how much standard errors may differ from those for white noise in a posterior that takes the noise for white."""


def sample(
    result: FitResult,
    *,
    draws: int = 3000,
    chains: int = 4,
    warmup: int = 100,
    acceptance: float = 0.65,
    seed: int = 0,
    progress: Callable[[Progress], None] | None = None,
) -> Posterior:
    """Draw from the posterior of a fit by the No-U-Turn sampler of blackjax, started from the fit's covariance.

    The posterior is the likelihood that was fitted, times the priors of the fit, times a prior that is flat in the value of
    each parameter within its bounds (for a `Prior` with a `factor`, in its logarithm). With one bound or none a flat prior
    has no end: from 1 to 10 it takes a number for as likely as from 11 to 20, where one that is flat in the logarithm would
    prefer the first. That matters where the measurements hardly tell a parameter: then give it a second bound, or a `Prior`.
    Where the simulation cannot be used the posterior is zero.

    The size of normal noise that was estimated is integrated out, with the prior 1/sigma: -(n/2) log(sum of squares) in
    place of -(sum of squares)/(2 sigma²) for a channel of n samples. The scale of Student's t, and the coefficients of
    autoregressive noise, stay as they were estimated.

    **Arguments:**

    - `result`: a fit that answered the whole question, `result.success`.
    - `draws`: how many to keep, of all chains together; made up to 25 or a multiple of it in every chain.
    - `chains`: how many, >= 2; each has a thread of its own, and as many run at a time as there are processors.
    - `warmup`: draws of each chain that are thrown away, made up likewise, in which it comes from where it began to where
      the posterior is, and the length of its steps is adapted.
    - `acceptance`: mean rate to which the length of a step is adapted, between 0 and 1. Three steps make a draw where the
      posterior is nearly normal; where it is bent, more and shorter ones are needed: 0.9 or 0.95.
    - `seed`: of the random numbers: the same gives the same draws.
    - `progress`: called with a `Progress` after every 25 draws of all chains; its `iteration` is their number.

    Returns a `Posterior`; look at its `reason`. Ctrl-C ends it with the draws so far.

    Raises `ValueError` for a fit without a covariance (a parameter that is not identifiable or at a bound, no optimum), for
    one whose residuals are not as its noise model says, and for numbers that are out of range; `ImportError` without
    blackjax.
    """
    try:
        from . import _chains
    except ModuleNotFoundError as error:
        if error.name != "blackjax":
            raise
        raise ImportError('sampling needs blackjax: pip install "millax[posterior]"', name="blackjax") from None
    for name, value, least in (("draws", draws, 1), ("chains", chains, 2), ("warmup", warmup, 1)):
        if value < least:
            raise ValueError(f"{name}: {value} given; it must be at least {least}")
    if not 0 < acceptance < 1:
        raise ValueError(f"acceptance: {acceptance:g} given; it must lie between 0 and 1, such as 0.65")
    _refuse(result)

    first = time.perf_counter()
    tell = progress or (lambda _: None)

    def report(stage: str, done: int) -> None:
        tell(Progress(stage, done, np.nan, time.perf_counter() - first))

    report("compiling", 0)
    density, block = _chains.Density.of(result), _chains.BLOCK
    found, gradients, interrupted = _chains.drawn(
        density,
        chains=chains,
        warmup=math.ceil(warmup / block),
        kept=math.ceil(draws / (chains * block)),
        acceptance=acceptance,
        seed=seed,
        report=report,
    )
    numbers = result.asked.numbers
    y = jax.vmap(jax.vmap(density.y))(found.z)
    shown = np.asarray(jax.vmap(jax.vmap(numbers.values))(y)) * [numbers.shown(i, 1.0) for i in range(len(numbers))]
    rhat, ess = mixing(shown)
    divergences, failures = int(found.diverged.sum()), int((found.diverged & found.failed).sum())
    return Posterior(
        status="interrupted" if interrupted else "sampled",
        names=numbers.names,
        units=numbers.units,
        draws=shown,
        y=np.asarray(y),
        estimate=np.array([e.value for e in result.parameters]),
        error=np.array([e.std for e in result.parameters]),
        interval=np.array([e.ci95 for e in result.parameters]),
        rhat=rhat,
        ess=ess,
        divergences=divergences,
        failures=failures,
        acceptance=float(found.acceptance.mean()),
        gradients=gradients,
        seconds=time.perf_counter() - first,
        seed=seed,
        reason=doubt(numbers.names, rhat, ess, divergences, failures, found.diverged.size),
    )


def _refuse(result: FitResult) -> None:
    """Raise `ValueError` for a fit whose posterior cannot be sampled."""
    if not result.success:
        raise ValueError(f"there is nothing to start a sampler from, the fit ended as {result.status}: {result.message}")
    widened = max((e.widened for e in result.parameters), key=lambda factor: abs(factor - 1))
    if abs(widened - 1) <= COLOURED:
        return
    orders = [order for trace in result.traces for order in trace.orders.values()]
    order = min(result.noise_model.order + max(orders), HIGHEST_ORDER)
    text = (
        "the residuals are not as the noise model says: they are correlated in time, and a standard error is "
        f"{widened:.2g} times what it would be without that, so that the posterior would be wrong by as much."
    )
    if result.noise_model.order < order:
        raise ValueError(f"{text} Fit with noise that is: fit(..., noise=NoiseModel(order={order}))")
    raise ValueError(
        f"{text} The highest order of noise does not describe it: the model misses something; the fit allows for it"
    )
