"""Posteriors of fits by sampling: where they are normal beside the fit itself, where they are not beside an integral."""

import time

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

import identification as ident
import millax as mx
from millax._names import value_of

from ..demo import cut, recorded
from ..figures import Figure, below, near
from ..slot import slot
from .recovery import GUESS


def figures():
    yield from _normal()
    yield from _skewed()
    yield from _bent()


def _normal():
    """Six parameters of 0.3 s of force and displacement, their noise estimated."""
    truth = cut(0.3)
    trace = recorded(truth, 0, known=False)
    names = list(GUESS)[:6]
    result = ident.fit(truth, trace, [ident.Parameter(name, guess=value_of(truth, name) * GUESS[name]) for name in names])
    begin = time.process_time()
    found = ident.sample(result)
    spent = time.process_time() - begin
    what = "six parameters of 0.3 s, four channels"
    yield below(f"{what}: largest R-hat", found.rhat.max(), 1.01, form=".4f")
    yield Figure(f"{what}: smallest bulk ESS", f"{found.ess.min():.0f}", "> 400", bool(found.ess.min() > 400))
    yield below(f"{what}: divergences", found.divergences, 0, form="d")
    yield below(f"{what}: wall time, compilation included", found.seconds, 60, form=".0f", unit=" s")
    yield Figure(f"{what}: time of all processors", f"{spent:.0f} s", "", None)
    yield Figure(f"{what}: gradients", str(found.gradients), "", None)
    for name, shift, ratio in zip(names, found.shift, found.ratio, strict=True):
        yield below(f"{name}: mean beside that of the fit, in standard errors", abs(shift), 0.2)
        yield near(f"{name}: standard deviation over that of the fit", ratio, 1.0, 0.1, form=".3f")


def _skewed():
    """Two parameters that a short trace with much noise hardly tells, one of them within bounds; the noise is estimated."""
    case, trace = _short(sigma=200.0)
    names, low, high = ("force.r", "force.kr"), 0.1, 0.6
    result = ident.fit(case, trace, [names[0], ident.Parameter(names[1], bounds=(low, high))])
    found = ident.sample(result, draws=10000)

    @jax.jit
    def log(r, kr):
        changed = eqx.tree_at(lambda c: (c.force.r, c.force.kr), case, (r, kr))
        residuals = mx.simulate(changed, throw=False).force[:, :2] - trace.values
        return -len(residuals) / 2 * jnp.sum(jnp.log(jnp.sum(residuals**2, axis=0)))

    values = np.linspace(0.001, 0.3, 100), low + (high - low) * (np.arange(60) + 0.5) / 60
    density = np.array([[float(log(r, kr)) for kr in values[1]] for r in values[0]])
    density = np.exp(density - density.max())
    what = "force.r and force.kr of 0.03 s with much noise"
    yield below(f"{what}: largest R-hat", found.rhat.max(), 1.01, form=".4f")
    yield Figure(f"{what}: smallest bulk ESS", f"{found.ess.min():.0f}", "> 400", bool(found.ess.min() > 400))
    yield Figure(f"{what}: as the fit says", "yes" if found.agrees else "no", "no", not found.agrees)
    for i, (name, value) in enumerate(zip(names, values, strict=True)):
        marginal = density.sum(axis=1 - i) / density.sum()
        mean = marginal @ value
        std = np.sqrt(marginal @ (value - mean) ** 2)
        ends = np.interp([0.025, 0.975], np.cumsum(marginal) - marginal / 2, value)
        yield below(f"{name}: mean beside the integral, in standard deviations", abs(found.mean[i] - mean) / std, 0.1)
        yield near(f"{name}: standard deviation over that of the integral", found.std[i] / std, 1.0, 0.06, form=".3f")
        off = np.abs(found.ci95[i] - ends).max() / std
        yield below(f"{name}: ends of the 95 % interval beside the integral, in standard deviations", off, 0.2)
        off = np.abs(found.interval[i] - ends).max() / std
        yield Figure(f"{name}: the same, those of the fit", f"{off:.2f}", "", None)


def _bent():
    """Two parameters that one feed hardly tells apart: the posterior is a long bent ridge, and too much for the default."""
    case, trace = _short(sigma=20.0)
    found = ident.sample(ident.fit(case, trace, ["force.hs", "force.r"]), draws=400)
    said = "nothing" if found.reason is None else f"R-hat {found.rhat.max():.2f}, {found.divergences} divergences"
    yield Figure("force.hs and force.r of 0.03 s at one feed: what is said", said, "not to be trusted", bool(found.reason))


def _short(sigma: float) -> tuple[mx.Case, ident.Trace]:
    """0.03 s of forces on a rigid tool, and a case with the truth in it."""
    case = slot(axes=(), duration=0.03)
    sim = mx.simulate(case)
    measured = np.asarray(sim.force[:, :2]) + sigma * np.random.default_rng(0).normal(size=(len(sim.time), 2))
    return case, ident.Trace(np.asarray(sim.time), ("Fx", "Fy"), measured)
