"""The same with the XLA flags that the command line sets: wider vectors, and the march as one compiled loop."""

import jax
import jax.numpy as jnp

from identification._runtime import XLA_FLAGS

from .. import compiled
from ..figures import Figure, below
from ..slot import slot
from ..timing import interleaved
from .child import ask
from .derivatives import GRADIENT, JACOBIAN, SIMULATION, programs
from .run import Run
from .single import SAME

MEMBERS = 64


def figures(run: Run):
    if not compiled.have_compiler():
        return
    found = ask("flags", run.duration, run.rounds, flags=XLA_FLAGS)
    yield below(
        "force and displacement of one simulation, beside C, same model", found[SIMULATION], 3, form=".2f", unit=" ×"
    )
    for name in (JACOBIAN, GRADIENT):
        yield Figure(f"{name}, beside C, same model", f"{found[name]:.1f} ×", "", None)
    batch = ask("batch", MEMBERS, run.duration, max(3, run.rounds // 4), flags=XLA_FLAGS)
    what = f"batch of {MEMBERS}: per simulation and core, beside C, same model"
    yield below(what, batch["ratio"], 1, form=".2f", unit=" ×")


def measure(duration: float, rounds: float) -> dict[str, float]:
    """Times over that of the C loop, each the median over rounds."""
    case, one = slot(duration=duration), jnp.ones(6)
    functions = {name: (lambda f=f: jax.block_until_ready(f(one))) for name, f in programs(case).items()}
    times = interleaved(functions | {SAME: compiled.same_model(case)}, max(3, int(rounds) // 2))
    return {name: times.ratio(name, SAME) for name in functions}
