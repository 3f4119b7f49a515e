"""Honest intervals: thousands of noisy traces of one cut, each fitted, with white and with coloured noise.

Each fit is that of `identification.fit`, by its parts, with many in one program: the noise is estimated with the parameters.
"""

from collections.abc import Iterator

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from scipy.signal import lfilter

from identification._colour import colour
from identification._evaluate import Evaluation, Model, evaluate, evaluation
from identification._fleet import batches, solve_many
from identification._noise import Noise, NoiseModel, reflections
from identification._profile import LIMIT
from identification._question import question

from ..demo import NOISE, cut, recorded
from ..figures import Figure

REALISATIONS = 2000
NAMES = (
    "force.k0",
    "force.hs",
    "force.r",
    "force.kr",
    "structure.damping_ratio.x",
    "structure.stiffness.x",
)
AR = 0.5
"""Correlation of coloured noise from one sample to the next."""


def figures(realisations: int = REALISATIONS) -> Iterator[Figure]:
    model, sigma = _problem()
    rng = np.random.default_rng(20261129)
    yield from _study("white noise", model, sigma, 0.0, NoiseModel(), rng, realisations)
    yield from _study(f"AR(1) noise, {AR}, in the fit", model, sigma, AR, NoiseModel(order=1), rng, realisations)
    yield from _study(f"AR(1) noise, {AR}, found afterwards", model, sigma, AR, NoiseModel(), rng, realisations)


def _problem() -> tuple[Model, np.ndarray]:
    """The demo's slot, 0.15 s of it, at the truth: y = 0."""
    case = cut(0.15)
    return question(case, recorded(case, None), NAMES).model, np.array(list(NOISE.values()))


def _study(
    what: str, model: Model, sigma: np.ndarray, ar: float, kind: NoiseModel, rng: np.random.Generator, m: int
) -> Iterator[Figure]:
    n, clean = len(NAMES), np.asarray(model.comparisons[0].measured)
    white = rng.normal(size=(m, *clean.shape))
    start = white[..., :1] / np.sqrt(1 - ar**2)
    drawn = lfilter([1.0], [1.0, -ar], np.concatenate([start, white[..., 1:]], axis=-1), axis=-1) * np.sqrt(1 - ar**2)
    measured = [(clean + sigma[:, None] * one,) for one in np.asarray(drawn)]
    truth = Noise(sigma, np.full((len(sigma), kind.order), ar), None)
    best = Noise(sigma, np.full((len(sigma), 1 if ar else 0), ar), None)
    bound = _std(evaluate(model, best, jnp.zeros(n)).whitened(sigma)[:, :-1])

    first = np.stack([one.y for one in solve_many(model, truth, np.zeros((m, n)), measured=measured)])
    found = _evaluations(model, [truth] * m, first, measured)
    estimated = [_noise(one, values, kind, n) for one, values in zip(found, measured, strict=True)]
    y, cost, std, along = np.zeros((m, n)), np.zeros(m), np.zeros((m, n)), np.zeros((m, n, n))
    widened = np.ones((m, n))
    fits = list(solve_many(model, estimated, first, measured=measured))
    found = _evaluations(model, estimated, np.stack([one.y for one in fits]), measured)
    for i, (one, there, noise) in enumerate(zip(fits, found, estimated, strict=True)):
        jacobian = one.triangle[:, :-1]
        covariance = np.linalg.inv(jacobian.T @ jacobian)
        naive = np.sqrt(np.diag(covariance))
        left = colour(_of(model, measured[i]), noise, there).information
        if left is not None:
            covariance = covariance @ left @ covariance
        y[i], cost[i], std[i] = one.y, one.cost, np.sqrt(np.diag(covariance))
        widened[i] = std[i] / naive
        along[i] = covariance / np.diag(covariance)
    ratio = y.std(axis=0, ddof=1) / bound
    for name, value in zip(NAMES, ratio, strict=True):
        if ar and not kind.order:
            # Least squares is not the best there is for coloured noise; what counts is that it says how good it is.
            yield Figure(f"{what}: {name}, standard deviation over Cramér-Rao bound", f"{value:.3f}", "", None)
        else:
            yield _within(f"{what}: {name}, standard deviation over Cramér-Rao bound", value, 0.95, 1.05, ".3f")
    covered = np.mean(np.abs(y) < LIMIT * std, axis=0)
    for name, value in zip(NAMES, covered, strict=True):
        yield _within(f"{what}: {name}, truth within the interval by covariance", 100 * value, 93, 97, ".1f", " %")

    # The truth lies in the interval by the profile where holding the parameter there costs less than the limit.
    starts = np.concatenate([y - along[:, :, i] * y[:, i : i + 1] for i in range(n)])
    held = np.repeat(np.eye(n, dtype=bool), m, axis=0)
    ended = solve_many(model, estimated * n, starts, held, measured * n)
    rise = np.array([one.cost for one in ended]).reshape(n, m) - cost
    covered = np.mean(rise < (LIMIT * widened.T) ** 2, axis=1)
    for name, value in zip(NAMES, covered, strict=True):
        yield _within(f"{what}: {name}, truth within the interval by profile", 100 * value, 93, 97, ".1f", " %")


def _evaluations(model: Model, noises, at: np.ndarray, measured) -> Iterator[Evaluation]:
    """Model and Jacobian of many fits, in batches."""

    @jax.jit
    def evaluated(noise, y, values):
        return jax.vmap(lambda noise, y, values: evaluation(_of(model, values), noise, y))(noise, y, values)

    for count, lanes in batches(noises, at, measured):
        found = jax.tree.map(np.asarray, evaluated(*lanes))
        for i in range(count):
            yield jax.tree.map(lambda leaf, i=i: leaf[i], found)


def _noise(found: Evaluation, measured, kind: NoiseModel, n: int) -> Noise:
    """Estimated from residuals, as in a fit."""
    residuals = np.asarray(found.fitted[0]) - measured[0]
    channels, samples = residuals.shape
    noise = Noise(np.ones(channels), reflections(residuals, kind.order), None)
    size = np.linalg.norm(np.asarray(noise.white(jnp.asarray(residuals))), axis=1) / np.sqrt(samples - n / channels)
    return Noise(size, noise.reflection, None)


def _of(model: Model, measured) -> Model:
    return eqx.tree_at(lambda m: [one.measured for one in m.comparisons], model, list(measured))


def _std(jacobian: np.ndarray) -> np.ndarray:
    return np.sqrt(np.diag(np.linalg.inv(jacobian.T @ jacobian)))


def _within(what: str, value: float, low: float, high: float, form: str, unit: str = "") -> Figure:
    return Figure(what, f"{value:{form}}{unit}", f"{low:g} to {high:g}{unit}", bool(low <= value <= high))
