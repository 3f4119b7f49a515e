"""Many simulations at once, per simulation and core, beside the C loop on one core."""

import time

import jax
import jax.numpy as jnp
import numpy as np

import millax as mx

from .. import compiled
from ..figures import Figure, below
from ..slot import scaled, six_parameters, slot
from .run import Run

CHUNK = 16
"""Simulations computed together; more at once no longer fit the cache."""

LENGTHS = {64: 1.0, 1024: 0.1}
"""Durations as parts of a single simulation's, so that one batch takes seconds."""


def figures(run: Run):
    for members in run.members:
        case = slot(duration=run.duration * LENGTHS.get(members, 1.0))
        wall, cores, ratio = beside_c(case, members, max(3, run.rounds // 4))
        per_step = 1e9 * wall * cores / members / case.settings.steps
        what = f"batch of {members}, {case.settings.steps} steps each"
        run.bars[f"millax, batch of {members}, per core"] = per_step
        yield Figure(f"{what}: wall time, cores used", f"{wall:.2f} s, {cores:.2f}", "", None)
        yield Figure(f"{what}: per step, simulation and core", f"{per_step:.0f} ns", "", None)
        if ratio is not None:
            yield below(f"{what}: per simulation and core, beside C, same model", ratio, 1, form=".2f", unit=" ×")


def batch(case: mx.Case, members: int):
    """A batch ready to run: `case` with six parameters varied by up to 5 % in each; mean force and motion of each."""
    factors = jnp.asarray(np.random.default_rng(1).uniform(0.95, 1.05, (members, 6)))

    def member(factors):
        sim = mx.simulate(scaled(case, six_parameters, list(factors)), throw=False)
        return sim.force.mean(axis=0), jnp.sqrt((sim.displacement**2).mean(axis=0)), sim.status

    run = jax.jit(lambda factors: jax.lax.map(member, factors, batch_size=min(CHUNK, members)))
    return lambda: run(factors)


def beside_c(case: mx.Case, members: int, rounds: int) -> tuple[float, float, float | None]:
    """Wall time of a batch [s], cores it keeps busy, and their product per member over the time of one C loop."""
    function = batch(case, members)
    loop = compiled.same_model(case) if compiled.have_compiler() else None
    status = jax.block_until_ready(function())[2]
    if np.any(status != 0):
        raise RuntimeError(f"{np.count_nonzero(status)} of {members} simulations failed")
    walls, cores, ratios = [], [], []
    for _ in range(rounds):
        wall, cpu = time.perf_counter(), time.process_time()
        jax.block_until_ready(function())
        wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
        walls.append(wall)
        cores.append(max(cpu / wall, 1.0))
        if loop:
            # As often as takes about as long: one run is too short to be a fair sample of a noisy machine.
            begin, runs = time.perf_counter(), 0
            while time.perf_counter() - begin < wall / 4 or runs < 3:
                loop()
                runs += 1
            ratios.append(wall * cores[-1] / members / ((time.perf_counter() - begin) / runs))
    return float(np.median(walls)), float(np.median(cores)), float(np.median(ratios)) if loop else None
