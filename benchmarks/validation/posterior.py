"""Posteriors of fits by sampling: where they are normal beside the fit itself, where they are not beside an integral."""

import time

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

import identification as ident
import millax as mx

from ..figures import Figure, below, near
from ..slot import slot
from .recovery import GUESS, SIGMA_DISPLACEMENT, SIGMA_FORCE, _value


def figures():
    yield from _normal()
    yield from _skewed()


def _normal():
    """Six parameters of 0.3 s of force and displacement, their noise estimated."""
    truth = slot(stiffness=[3e5, 3e5], damping_ratio=[0.05, 0.05], duration=0.3)
    sim = mx.simulate(truth)
    exact = np.column_stack([sim.force[:, :2], sim.displacement])
    sigma = [SIGMA_FORCE, SIGMA_FORCE, SIGMA_DISPLACEMENT, SIGMA_DISPLACEMENT]
    measured = exact + sigma * np.random.default_rng(0).normal(size=exact.shape)
    trace = ident.Trace(np.asarray(sim.time), ("Fx", "Fy", "x", "y"), measured)
    names = list(GUESS)[:6]
    result = ident.fit(truth, trace, [ident.Parameter(name, guess=_value(truth, name) * GUESS[name]) for name in names])
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
    """Two parameters that a short and noisy trace hardly tells apart: the posterior is a bent ridge."""
    case, sigma = slot(axes=(), duration=0.03), 40.0
    sim = mx.simulate(case)
    measured = np.asarray(sim.force[:, :2]) + sigma * np.random.default_rng(0).normal(size=(len(sim.time), 2))
    trace = ident.Trace(np.asarray(sim.time), ("Fx", "Fy"), measured, {"Fx": sigma, "Fy": sigma})
    names = ("force.k0", "force.hs")
    result = ident.fit(
        case, trace, [ident.Parameter("force.k0", bounds=LIMITS[0]), ident.Parameter("force.hs", bounds=LIMITS[1])]
    )
    found = ident.sample(result)

    @jax.jit
    def squares(k0, hs):
        changed = eqx.tree_at(lambda c: (c.force.k0, c.force.hs), case, (k0, hs))
        return jnp.sum((mx.simulate(changed, throw=False).force[:, :2] - measured) ** 2)

    ends = [(found.draws[..., i].min(), found.draws[..., i].max()) for i in range(2)]
