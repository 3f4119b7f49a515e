"""The same with JAX as it comes, but for double precision: without the XLA flags of `millax.set_up`."""

import jax
import jax.numpy as jnp

from .. import compiled
from ..figures import Figure, below
from ..slot import slot
from ..timing import interleaved
from .child import ask
from .derivatives import GRADIENT, JACOBIAN, LIMITS, SIMULATION, programs
from .run import Run
from .single import SAME

MEMBERS = 64


def figures(run: Run):
    found = ask("plain", run.duration, run.rounds, plain=True)
    for name, limit in LIMITS.items():
        yield below(f"{name}, beside one simulation", found[name], limit, form=".2f", unit=" ×")
    if SAME in found:
        yield Figure(f"one simulation, beside {SAME}", f"{found[SAME]:.2f} ×", "", None)
        batch = ask("batch", MEMBERS, run.duration, max(3, run.rounds // 4), plain=True)
        what = f"batch of {MEMBERS}: per simulation and core, beside {SAME}"
        yield Figure(what, f"{batch['ratio']:.2f} ×", "", None)


def measure(duration: float, rounds: float) -> dict[str, float]:
    """Times of derivatives over that of a simulation, and its own over that of the C loop, each the median over rounds."""
    case, one = slot(duration=duration), jnp.ones(6)
    functions = {name: (lambda f=f: jax.block_until_ready(f(one))) for name, f in programs(case).items()}
    if compiled.have_compiler():
        functions[SAME] = compiled.same_model(case)
    times = interleaved(functions, max(3, int(rounds) // 2))
    found = {name: times.ratio(name, SIMULATION) for name in (JACOBIAN, GRADIENT)}
    return found | ({SAME: times.ratio(SIMULATION, SAME)} if SAME in functions else {})
