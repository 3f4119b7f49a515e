"""Many simulations at once, `millax.sweep` on all cores: per simulation and core, beside the C loop on one core."""

import time
from collections.abc import Callable

import numpy as np

import millax as mx

from .. import compiled
from ..figures import Figure, below
from ..slot import slot
from .child import ask
from .run import Run

SPREAD = 0.05
"""Every member has its own force law, damping and stiffness, by so much above or below those of the case."""

KEPT = ("mean_force", "std_displacement")


def figures(run: Run):
    for members in run.members:
        result = ask("batch", members, run.duration, max(3, run.rounds // 4))
        steps, wall, cores = int(result["steps"]), result["wall"], int(result["cores"])
        per_step = 1e9 * wall * cores / members / steps
        what = f"batch of {members}, {steps} steps each"
        run.bars[f"millax, batch of {members}, per core"] = per_step
        yield Figure(f"{what}: wall time on {cores} cores", f"{wall:.2f} s", "", None)
        yield Figure(f"{what}: per step, simulation and core", f"{per_step:.0f} ns", "", None)
        if "ratio" in result:
            yield below(f"{what}: per simulation and core, beside C, same model", result["ratio"], 1, form=".2f", unit=" ×")


def batch(case: mx.Case, members: int) -> Callable:
    """A sweep of samples of `case`, ready to run."""
    names = ["force.k0", "force.hs", "force.r", "force.kr", "structure.stiffness", "structure.damping_ratio"]
    factors = np.random.default_rng(1).uniform(1 - SPREAD, 1 + SPREAD, (members, len(names)))
    values = [getattr(getattr(case, part), key) for part, key in (name.split(".") for name in names)]
    samples = {name: float(v) * f for name, v, f in zip(names, values, factors.T, strict=True)}
    return lambda: mx.sweep(case, samples=samples, reduce=KEPT)


def measure(members: float, duration: float, rounds: float) -> dict[str, float]:
    """Of a batch: its wall time [s], the cores it runs on, the steps of a member, and wall time times cores per member
    over the time of the C loop, as the median over rounds."""
    import jax

    members, case = int(members), slot(duration=duration)
    function, cores = batch(case, members), jax.local_device_count()
    loop = compiled.same_model(case) if compiled.have_compiler() else None
    failed = np.count_nonzero(function().status)
    if failed:
        raise RuntimeError(f"{failed} of {members} simulations failed")
    walls, ratios = [], []
    for _ in range(int(rounds)):
        begin = time.perf_counter()
        function()
        walls.append(time.perf_counter() - begin)
        if loop:
            # A quarter as long as the batch: one loop alone is too short to be a fair sample of a busy machine.
            begin, loops = time.perf_counter(), 0
            while loops < 3 or time.perf_counter() - begin < walls[-1] / 4:
                loop()
                loops += 1
            ratios.append(walls[-1] * cores / members / ((time.perf_counter() - begin) / loops))
    result = {"wall": float(np.median(walls)), "cores": cores, "steps": case.settings.steps}
    return result | ({"ratio": float(np.median(ratios))} if loop else {})
