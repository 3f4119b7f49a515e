"""What derivatives cost beside the simulation itself."""

import functools

import jax
import jax.numpy as jnp

import millax as mx

from ..figures import below
from ..slot import scaled, six_parameters, slot
from ..timing import interleaved
from .run import Run

SIMULATION, JACOBIAN, GRADIENT = "simulation", "Jacobian, 6 parameters", "gradient, reverse mode"
LIMITS = {JACOBIAN: 6, GRADIENT: 4}
"""Targets: times over that of one simulation."""


def figures(run: Run):
    case, one = slot(duration=run.duration), jnp.ones(6)
    functions = {name: (lambda f=f: f(one)) for name, f in programs(case).items()}
    times = interleaved(functions, max(3, run.rounds // 2))
    steps = case.settings.steps
    for name, tells in ((JACOBIAN, "forward mode, all traces"), (GRADIENT, "of the sum of squared forces")):
        run.bars[f"millax, {name}"] = 1e9 * times.seconds(name) / steps
        yield below(
            f"{name}, {tells}, beside one simulation", times.ratio(name, SIMULATION), LIMITS[name], form=".2f", unit=" ×"
        )


def programs(case):
    """The simulation and its derivatives as compiled functions of six factors."""

    def cost(factors):
        return jnp.sum(simulate(case, factors).force ** 2)

    of_case = functools.partial(traces, case)
    return {SIMULATION: jax.jit(of_case), JACOBIAN: jax.jit(jax.jacfwd(of_case)), GRADIENT: jax.jit(jax.grad(cost))}


def row_by_row(case):
    """The same Jacobian with one direction at a time, the rows in front: needs little more memory than its result."""

    def jacobian(factors):
        along = functools.partial(jax.jvp, functools.partial(traces, case), (factors,))
        return jax.lax.map(lambda direction: along((direction,))[1], jnp.eye(len(factors)))

    return jax.jit(jacobian)


def traces(case, factors):
    sim = simulate(case, factors)
    return sim.force, sim.displacement


def simulate(case, factors):
    return mx.simulate(scaled(case, six_parameters, list(factors)), throw=False)
