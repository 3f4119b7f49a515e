"""How fast millax is: `make bench`. Every figure is a ratio inside one run, since machines are noisy.

The case: 2-DOF slot, 4 teeth, 3 passes, 40 steps per tooth period, 1 s of cutting at 10 000 rpm (26 680 steps), float64.
"""

import os
import platform
import time

import jax
import jax.numpy as jnp
import numpy as np
from rich.console import Console
from rich.table import Table

jax.config.update("jax_enable_x64", True)

import millax as mx  # noqa: E402

from .slot import scaled, slot  # noqa: E402
from .yardsticks import c_loop, step_by_step  # noqa: E402

ROUNDS = 15


def interleaved(functions: dict) -> dict[str, float]:
    """Median time of each function [s], all of them in turn, so that a slow spell of the machine slows them alike."""
    times = {name: [] for name in functions}
    for function in functions.values():
        jax.block_until_ready(function())
    for _ in range(ROUNDS):
        for name, function in functions.items():
            begin = time.perf_counter()
            jax.block_until_ready(function())
            times[name].append(time.perf_counter() - begin)
    return {name: float(np.median(t)) for name, t in times.items()}


def parameters(case: mx.Case):
    return [
        case.force.k0,
        case.force.hs,
        case.force.r,
        case.force.kr,
        case.structure.damping_ratio,
        case.structure.stiffness,
    ]


def main() -> int:
    console = Console(width=110)
    case = slot(duration=1.0)
    one = jnp.ones(6)
    sim = mx.simulate(case)

    def force(factors):
        return mx.simulate(scaled(case, parameters, list(factors)), throw=False).force

    simulate = jax.jit(force)
    jacobian = jax.jit(jax.jacfwd(force))
    gradient = jax.jit(jax.grad(lambda factors: jnp.sum(force(factors) ** 2)))
    batch = jax.jit(jax.vmap(force))
    many = 1 + 0.01 * jnp.arange(8)[:, None] * one

    functions = {
        "one simulation": lambda: simulate(one),
        "step-by-step lax.scan": step_by_step(case),
        "Jacobian, 6 parameters, forward mode": lambda: jacobian(one),
        "gradient, reverse mode": lambda: gradient(one),
        "batch of 8 by vmap": lambda: batch(many),
    }
    loop = c_loop(case)
    if loop is None:
        console.print("No gcc here: the figures against the C loop are left out.")
    else:
        functions["plain C loop, gcc -O3 -march=native -ffast-math"] = loop
        difference = np.abs(loop()[1] - np.asarray(sim.displacement)).max() / np.abs(np.asarray(sim.displacement)).max()
        console.print(f"C loop and millax agree to {100 * difference:.2g} % of the largest displacement.")
    times = interleaved(functions)

    times["batch of 8, per simulation"] = times["batch of 8 by vmap"] / len(many)
    steps, base = case.settings.steps, times["one simulation"]
    machine = f"{platform.machine()}, {os.cpu_count()} cores, JAX {jax.__version__}"
    table = Table(title=f"{steps} steps; {machine}", show_edge=False)
    for column, justify in (("", "left"), ("ns per step", "right"), ("× one simulation", "right")):
        table.add_column(column, justify=justify)
    for name, seconds in sorted(times.items(), key=lambda item: item[1]):
        table.add_row(name, f"{1e9 * seconds / steps:.0f}", f"{seconds / base:.2f}")
    console.print(table)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
