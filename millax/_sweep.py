"""Sweeps: the same cut with other numbers, many times over."""

import contextlib
import errno
import os
import time
import warnings
from collections.abc import Callable, Generator, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import jax
import numpy as np

from ._case import Case
from ._cluster import on_cluster, threads
from ._labels import Variable, assemble, bytes_of, variables_of, write
from ._manifest import digest, manifest_of
from ._members import Members, members_of
from ._plan import Group, Plan, plan
from ._program import BATCH, Computation, Work, cores, program
from ._reductions import Reduce, abstract, chosen, fingerprints, shapes
from ._runtime import double_precision
from ._simulate import SINGLE_PRECISION
from ._sweepfile import Chunk, SweepFile, in_words, require_space
from ._values import Given

if TYPE_CHECKING:
    import xarray
    from distributed import Client

LARGEST_CHUNK = 64e6
"""Bytes of results in a chunk, unless one batch has more."""

MOST_BATCHES = 16
"""Batches in a chunk: what is lost at most when a sweep is stopped."""


@dataclass(frozen=True)
class SweepProgress:
    """How far a sweep is.

    - `done`, `total`: members simulated, and all of them. What an earlier run left counts as done.
    - `failed`: members among them whose status is not 0.
    - `seconds`: since the sweep began.
    """

    done: int
    total: int
    failed: int
    seconds: float


def sweep(
    case: Case,
    *,
    grid: Mapping[str, Given] | None = None,
    samples: Mapping[str, Given] | None = None,
    reduce: Reduce = None,
    out: str | os.PathLike | None = None,
    overwrite: bool = False,
    progress: Callable[[SweepProgress], None] | None = None,
    client: "Client | None" = None,
) -> "xarray.Dataset":
    """Simulate `case` with other numbers: every combination of a grid, or a list of samples.

    **Arguments:**

    - `case`: what the members have in common.
    - `grid`: by name, as in a case file ("cut.depth", "structure.stiffness.x"), the values: "4000:16000:49 rpm" (from, to,
      how many), "0.5, 1, 2 mm", an array in SI, or one value. `cut.feed_per_tooth` is a name too: given as one value, it is
      held while the spindle speed varies; otherwise the feed rate is.
    - `samples`: by name, as many values as there are samples, or one for all; see `millax.sample`. Give `grid` or `samples`.
    - `reduce`: what is kept of every simulation: names out of `millax.REDUCTIONS`, or functions of a `Simulation` (or of a
      `Simulation` and its `Case`) by name, written in JAX. None: all of `millax.REDUCTIONS`.
    - `out`: a netCDF file for the result. While the sweep is under way, what is done is kept in a directory beside it,
      `OUT.parts`; a sweep that was stopped, whatever the reason, goes on from there when it is called again. A file that
      holds the result of this same sweep is read, and nothing is simulated.
    - `overwrite`: start anew where `out` holds another sweep, or a part of one.
    - `progress`: called with a `SweepProgress` after every chunk.
    - `client`: of a Dask cluster, to compute there (`pip install "millax[cluster]"`). None: on all devices of this process
      (see `millax.use_all_cores`).

    **Returns:** a dataset. Its dimensions are the varied names, or "sample"; its coordinates are in the unit in which they
    were given. Its variables are what `reduce` keeps, in SI, and for every member `status` (0, or a key of
    `millax.STATUS`), `residual` and `simulated_time` [s]. Where the status is not 0, everything else is NaN.

    Every member is simulated for the duration of the case, in whole tooth periods. Where the spindle speed varies, traces
    differ in length: what a function in `reduce` sees is filled up with NaN behind the end of the member (use `jnp.nanmean`
    and the like), and so are traces in the result. Blocks and sweeps are chosen for every member; one whose sweeps have not
    converged is simulated again with more, twice at most, before it gets the status 1.

    Raises `ValueError` for what cannot be varied or reduced, where a result does not fit into memory and there is no `out`,
    and where `out` holds something else (the message shows the difference); `OSError` where nothing more can be written,
    with everything done so far kept; `RuntimeError` where a cluster cannot compute a chunk.
    """
    run = _Run(case, grid, samples, reduce, cluster=client is not None)
    if out is None:
        if run.size > available_memory() / 2:
            raise ValueError(
                f"the result of this sweep, {in_words(run.size)}, does not fit into the memory that is free "
                f'({in_words(available_memory())}). Give out="sweep.nc": it is then written chunk by chunk; or keep less of '
                "every simulation, with reduce="
            )
        kept: list[Chunk] = []
        todo = np.arange(len(run.members))
        _compute(run, todo, kept.append, _Counter(progress, len(todo)), client)
        return assemble(lambda names: kept, run.members, run.variables, run.manifest)
    return _into_file(run, SweepFile(out, run.manifest), overwrite, progress, client)


def available_memory() -> float:
    """Bytes of memory that are free."""
    try:
        with open("/proc/meminfo", encoding="ascii") as file:
            return next(1024.0 * float(line.split()[1]) for line in file if line.startswith("MemAvailable"))
    except (OSError, StopIteration):
        pass
    try:
        return os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE") / 2
    except (AttributeError, ValueError, OSError):  # no such thing on this system
        return 4e9


class _Run:
    """Everything about a sweep that is known before it starts."""

    members: Members
    plan: Plan
    variables: dict[str, Variable]
    size: int
    work: Work

    def __init__(self, case: Case, grid, samples, reduce: Reduce, *, cluster: bool):
        x64 = double_precision()
        if not x64:
            warnings.warn(
                SINGLE_PRECISION,
                stacklevel=4,
            )
        reductions = chosen(reduce)
        self.members = members_of(case, grid, samples)
        self.plan = plan(case, self.members)
        longest = max(self.plan.groups).settle(case)
        sim = abstract(longest)
        self.variables = variables_of(shapes(sim, longest, reductions), reductions)
        self.size = sum(bytes_of(v, len(self.members)) for v in self.variables.values())
        # Of the case as it is: a longer simulation for some member is no other reduction.
        own = sim if longest.settings.steps == case.settings.steps else abstract(case)
        self.manifest = manifest_of(case, self.members, fingerprints(own, case, reductions), x64=x64)
        traces = sum(leaf.size * leaf.dtype.itemsize for leaf in jax.tree.leaves(sim))
        batch = _batch(2 * traces + self.size / len(self.members), 1 if cluster else jax.local_device_count())
        constant = {name: value for name, value in self.manifest.items() if not name.startswith("vary.")}
        key = digest(constant | {"names": self.members.names, "batch": batch})
        self.work = Work(jax.tree.map(np.asarray, case), self.members.names, reductions, batch, x64, key)

    def chunks(self, todo: np.ndarray, slots: int, together: int) -> list[tuple[Group, np.ndarray]]:
        """The members `todo` in chunks: of one group, for one of `slots` places to compute, `together` batches at a time."""
        one = self.work.batch * together
        per_member = self.size / len(self.members)
        batches = min(MOST_BATCHES, LARGEST_CHUNK / (per_member * one), len(todo) / (4 * slots * one))
        size = one * max(1, int(batches))
        pending = np.zeros(len(self.members), dtype=bool)
        pending[todo] = True
        found = []
        for group, which in self.plan.groups.items():
            left = which[pending[which]]
            found += [(group, left[start : start + size]) for start in range(0, len(left), size)]
        return found


class _Counter:
    """Counts members, and tells a callback."""

    def __init__(self, progress, total: int, done: int = 0, failed: int = 0):
        self.progress, self.total, self.done, self.failed = progress, total, done, failed
        self.start = time.perf_counter()
        self.tell()

    def add(self, chunk: Chunk) -> None:
        self.done += len(chunk["member"])
        self.failed += int(np.count_nonzero(chunk["status"]))
        self.tell()

    def tell(self) -> None:
        if self.progress is not None:
            self.progress(SweepProgress(self.done, self.total, self.failed, time.perf_counter() - self.start))

    def __str__(self):
        return f"{self.done} of {self.total} members"


def _batch(per_member: float, devices: int) -> int:
    """Members per device and call: the usual number, or fewer where their traces would not fit into memory."""
    memory = available_memory() / 2
    batch = BATCH
    while batch > 1 and batch * devices * per_member > memory:
        batch //= 2
    if batch * devices * per_member > memory:
        raise ValueError(
            f"one simulation for each of {devices} devices needs {in_words(devices * per_member)} of memory, and "
            f"{in_words(2 * memory)} are free. Simulate a shorter cut, or with fewer devices"
        )
    return batch


def _into_file(run: _Run, file: SweepFile, overwrite: bool, progress, client) -> "xarray.Dataset":
    memory = available_memory()
    if overwrite:
        file.remove()
    if not file.finished():
        if run.size > memory / 2:
            warnings.warn(
                f"the result of this sweep, {in_words(run.size)}, is larger than the memory that is free allows "
                f"({in_words(memory)}): it is computed and written in chunks, and read from the file as it is needed",
                stacklevel=3,
            )
        file.start()
        status = file.done(len(run.members))
        done = status >= 0
        require_space(file.path.parent, 2 * run.size - int(done.mean() * run.size))
        counter = _Counter(progress, len(done), int(done.sum()), int(np.count_nonzero(status[done])))
        try:
            _compute(run, np.flatnonzero(~done), file.write, counter, client)
            write(file.path, file.chunks, run.members, run.variables, run.manifest, memory=memory / 4)
        except KeyboardInterrupt:
            raise KeyboardInterrupt(f"{counter} are done and kept in {file.parts}; run the same again to go on") from None
        except OSError as error:
            if error.errno is None and "No space left" not in str(error):
                raise
            words = os.strerror(error.errno or errno.ENOSPC)
            raise OSError(
                error.errno or errno.ENOSPC,
                f"{words}. {counter} are done and kept in {file.parts}; make room and run the same again to go on",
                os.fspath(file.path),
            ) from error
        file.finish()
    return _open(file.path, load=run.size <= memory / 2)


def _open(path: Path, *, load: bool) -> "xarray.Dataset":
    import xarray

    dataset = xarray.open_dataset(path, engine="h5netcdf")
    if load:
        with dataset:
            return dataset.load()
    return dataset


def _compute(run: _Run, todo: np.ndarray, keep: Callable[[Chunk], None], counter: _Counter, client) -> None:
    if client is None:
        devices = jax.local_device_count()
        results = _here(run, run.chunks(todo, slots=1, together=devices))
    else:
        results = on_cluster(
            client, run.work, run.chunks(todo, slots=threads(client), together=1), run.members.table, run.plan.periods
        )
    with contextlib.closing(results):  # whatever ends the loop, what is under way is called off
        for chunk in results:
            keep(chunk)
            counter.add(chunk)


def _here(run: _Run, chunks: list[tuple[Group, np.ndarray]]) -> Generator[Chunk]:
    """Compute chunks in this process, each begun before the one before is fetched, while the programs of later ones are
    compiled."""
    pool = ThreadPoolExecutor(min(4, cores()), thread_name_prefix="compile")
    programs = {group: pool.submit(program, run.work, group) for group in dict.fromkeys(group for group, _ in chunks)}
    before: tuple[np.ndarray, Computation] | None = None
    try:
        for group, which in chunks:
            programs[group].result()
            members, periods = run.members.table[which], run.plan.periods[which]
            now = which, Computation(run.work, group, members, periods, after=before and before[1])
            if before:
                yield {"member": before[0], **before[1].result()}
            before = now
        if before:
            yield {"member": before[0], **before[1].result()}
    finally:
        pool.shutdown(wait=False, cancel_futures=True)
