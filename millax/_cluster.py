"""A sweep on the workers of a Dask cluster. Scheduling, and what happens when a worker is lost, is Dask's."""

import os
from collections.abc import Generator, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from ._plan import Group
from ._program import Computation, Work
from ._sweepfile import Chunk

if TYPE_CHECKING:
    from distributed import Client

RETRIES = 2
"""How often a chunk that raised an error is tried again, on whichever worker is free."""


def on_cluster(
    client: "Client",
    work: Work,
    chunks: Sequence[tuple[Group, np.ndarray]],
    table: np.ndarray,
    periods: np.ndarray,
) -> Generator[Chunk]:
    """Compute chunks of members on the workers of `client`, and yield each as it finishes.

    A chunk that was on a worker which is lost is computed on another one. Raises `RuntimeError` where no worker can
    compute a chunk.
    """
    from distributed import KilledWorker, as_completed

    futures = {
        client.submit(_task, work, group, table[which], periods[which], pure=False, retries=RETRIES): which
        for group, which in chunks
    }
    try:
        for future in as_completed(list(futures)):
            try:
                found = future.result()
            except KilledWorker as error:
                raise RuntimeError(
                    f"several workers of the cluster were lost on the same chunk, out of memory? {error}"
                ) from error
            except Exception as error:  # whatever was raised over there
                raise RuntimeError(f"the cluster cannot compute a chunk: {type(error).__name__}: {error}") from error
            yield {"member": futures.pop(future), **found}
    finally:
        client.cancel(list(futures))


def threads(client: "Client") -> int:
    """How many chunks the cluster computes at once."""
    workers: Any = client.nthreads()  # a coroutine only for asynchronous clients
    return max(1, sum(workers.values()))


def _task(work: Work, group: Group, table: np.ndarray, periods: np.ndarray) -> dict[str, np.ndarray]:
    from distributed import get_worker

    # JAX would take all cores of the machine for itself, in every worker. It reads this when it first computes.
    os.environ.setdefault("PJRT_NPROC", str(get_worker().state.nthreads))
    return Computation(work, group, table, periods).result()
