"""The compiled program of a sweep: a batch of members at once on every device."""

import contextlib
import functools
import os
import threading
from collections import defaultdict
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh, PartitionSpec
from jaxtyping import Array, Float, Int

from ._case import Case
from ._gain import RERUNS, reachable
from ._members import SPINDLE_SPEED, member
from ._plan import Group
from ._reductions import OWN, Reduction
from ._runtime import double_precision
from ._simulate import Simulation, simulate, status_of

BATCH = 16
"""Members that a device computes at once: their working set stays in the cache."""


@dataclass(frozen=True, eq=False)
class Work:
    """Everything a process needs to compute members; it can be sent to another one.

    - `case`: with NumPy leaves.
    - `names`: the numbers that vary.
    - `reductions`: by name.
    - `batch`: members per device and call.
    - `x64`: whether in double precision.
    - `key`: tells apart what is computed; programs are kept under it.
    """

    case: Case
    names: tuple[str, ...]
    reductions: dict[str, Reduction]
    batch: int
    x64: bool
    key: str

    def __eq__(self, other):
        return isinstance(other, Work) and self.key == other.key

    def __hash__(self):
        return hash(self.key)


class Computation:
    """The variables of some members of one group, which are being computed: of these values and these tooth periods.

    `devices`: how many to use; 0 for all. `after`: what was begun before; no more than two batches are under way at a time.
    """

    def __init__(
        self,
        work: Work,
        group: Group,
        table: Float[np.ndarray, "members names"],
        periods: Int[np.ndarray, " members"],
        *,
        devices: int = 0,
        after: "Computation | None" = None,
    ):
        self.of = work, group, table, periods
        self.devices = devices
        self.batches: list[dict[str, Array]] = []
        begun = list(after.batches) if after else []
        number = work.batch * (devices or jax.local_device_count())
        with precision(work):
            run = program(work, group, devices)
            for start in range(0, len(table), number):
                # The last call is filled up with copies of its last member, so that one shape is compiled.
                which = np.minimum(np.arange(start, start + number), len(table) - 1)
                jax.block_until_ready(begun[-2:-1])
                begun.append(run(table[which].astype(_float(work)), periods[which].astype(np.int32)))
                self.batches.append(begun[-1])

    def result(self) -> dict[str, np.ndarray]:
        """Each variable, of shape (members, ...).

        Members whose sweeps have not converged are simulated again with more. Where the status of a member is not 0, its
        variables are NaN, all but the status, the residual and the simulated time.
        """
        work, group, table, periods = self.of
        found = self._fetched()
        for rerun in range(1, RERUNS + 1):
            with precision(work):
                allowed = float(reachable(work.case.settings.tolerance, _float(work)))
            again = np.flatnonzero(~(found["residual"] <= allowed))
            if again.size == 0:
                break
            harder = group._replace(sweeps=group.sweeps * 2**rerun)
            more = Computation(work, harder, table[again], periods[again], devices=self.devices)._fetched()
            for name, values in more.items():
                found[name][again] = values
        failed = found["status"] != 0
        for name in found.keys() - set(OWN):
            found[name][failed] = np.nan
        return found

    def _fetched(self) -> dict[str, np.ndarray]:
        members = len(self.of[2])
        return {name: np.concatenate([batch[name] for batch in self.batches])[:members] for name in self.batches[0]}


def precision(work: Work):
    """A context in which JAX computes in the precision of `work`, whatever this process or thread does elsewhere."""
    return contextlib.nullcontext() if double_precision() == work.x64 else jax.enable_x64(work.x64)


def _float(work: Work):
    return np.float64 if work.x64 else np.float32


def program(work: Work, group: Group, devices: int = 0):
    """The compiled function from the values of `batch` members per device to their variables. Made once, also where
    several threads ask for it."""
    with _LOCKS[work, group, devices], precision(work):
        return _compiled(work, group, devices)


_LOCKS: defaultdict[tuple[Work, Group, int], threading.Lock] = defaultdict(threading.Lock)


@functools.lru_cache(maxsize=256)
def _compiled(work: Work, group: Group, devices: int):
    mesh = Mesh(np.array(jax.local_devices()[: devices or None]), ("members",))
    split = PartitionSpec("members")
    case = group.settle(jax.tree.map(jnp.asarray, work.case))

    def one(values, periods):
        c = member(case, work.names, values)
        sim = simulate(c, throw=False)
        if SPINDLE_SPEED in work.names:
            sim = _ended(sim, c, periods)
        found = {
            name + suffix: part.astype(values.dtype)
            for name, reduction in work.reductions.items()
            for suffix, part in reduction(sim, c).items()
        }
        duration = c.cut.tooth_period(c.tool) * periods
        return found | {"status": sim.status, "residual": sim.residual, "simulated_time": duration}

    batch = jax.jit(jax.shard_map(jax.vmap(one), mesh=mesh, in_specs=split, out_specs=split, check_vma=False))
    n = work.batch * mesh.size
    arguments = jax.ShapeDtypeStruct((n, len(work.names)), _float(work)), jax.ShapeDtypeStruct((n,), np.int32)
    return batch.lower(*arguments).compile()


def _ended(sim: Simulation, case: Case, periods: Int[Array, ""]) -> Simulation:
    """`sim` up to the end of a tooth period: NaN behind it, and the status without what happens there."""
    inside = jnp.arange(sim.time.size) < periods * case.settings.steps_per_tooth
    displacement = jnp.where(inside[:, None], sim.displacement, 0.0)
    force = jnp.where(inside[:, None], sim.force, 0.0)
    status = status_of(case, force, displacement, sim.residual)

    def until_the_end(trace):
        return jnp.where(inside.reshape(-1, *[1] * (trace.ndim - 1)), trace, jnp.nan)

    return Simulation(
        time=until_the_end(sim.time),
        force=until_the_end(sim.force),
        displacement=until_the_end(sim.displacement),
        chip_thickness=until_the_end(sim.chip_thickness),
        residual=sim.residual,
        status=status.astype(sim.status.dtype),
        axes=sim.axes,
    )


def use_all_cores(devices: int | None = None) -> None:
    """Make JAX treat every core of the processor as a device of its own, for sweeps.

    **Arguments:**

    - `devices`: how many; None: as many as there are cores, unless XLA_FLAGS says how many.

    Call it before JAX computes anything. Raises `RuntimeError` where that is too late.
    """
    if devices is None and "xla_force_host_platform_device_count" in os.environ.get("XLA_FLAGS", ""):
        return
    jax.config.update("jax_num_cpu_devices", cores() if devices is None else devices)


def cores() -> int:
    """Cores of the processor that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
