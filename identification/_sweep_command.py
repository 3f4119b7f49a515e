"""`millax sweep`: from a case file and the numbers to vary to labelled results and a picture."""

import contextlib
import os
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from millax import STATUS, CaseError, CaseFile, SweepProgress, sample, sweep, use_all_cores
from millax._members import FEED_PER_TOOTH
from millax._sweepfile import whole

from ._output import complain, console

if TYPE_CHECKING:
    import xarray

EVERY = 2.0
"""Seconds between two lines of progress where nobody looks at a terminal."""

PATIENCE = "10s"
"""How long to wait for a scheduler to answer."""


def run_sweep(
    case_path: str | os.PathLike,
    vary: Sequence[str],
    out: str | os.PathLike,
    *,
    samples: int | None = None,
    seed: int = 0,
    reduce: str | None = None,
    overwrite: bool = False,
    cluster: str | None = None,
) -> int:
    """Sweep a case file; write the results to the netCDF file `out` and a picture beside it.

    `vary` holds texts like "cut.depth=0.2:4:20 mm"; with `samples` they are distributions, "force.k0=4000:6000 N/mm^2" or
    "force.k0=5000 ± 100 N/mm^2". `reduce` holds names of reductions between commas. `cluster` is the address of a Dask
    scheduler. Returns the exit code: 0; 1 where not one member could be simulated; 2 for input that cannot be used. Raises
    `OSError` where nothing can be written and `KeyboardInterrupt`, with what is done kept.
    """
    if cluster is None:
        with contextlib.suppress(RuntimeError):  # a process in which JAX computes already keeps the devices it has
            use_all_cores()
    path = Path(out)
    file = CaseFile.read(case_path)
    start = time.perf_counter()
    try:
        values: dict[str, Any] = by_name(vary)
        if samples is not None:
            values = dict(sample(values, samples, seed=seed))
        hold_feed_per_tooth(file, values)
        kept = None if reduce is None else [name.strip() for name in reduce.split(",")]
        varied = {"samples": values} if samples is not None else {"grid": values}
        with _client(cluster) as client, _progress() as progress:
            result = sweep(file.case, **varied, reduce=kept, out=path, overwrite=overwrite, progress=progress, client=client)
    except CaseError:
        raise
    except ValueError as error:
        complain(f"{case_path}: {error}")
        return 2
    except RuntimeError as error:
        complain(f"{error}. What is done is kept; run the same command again to go on")
        return 1
    return _show(result, path, time.perf_counter() - start)


def by_name(vary: Sequence[str]) -> dict[str, str]:
    """What --vary gives, the values by name. Raises `ValueError` for a text of another form and a name given twice."""
    names = [text.partition("=")[0].strip() for text in vary]
    for name in names:
        if names.count(name) > 1:
            raise ValueError(f"--vary {name}: given twice; give it once, with all its values")
    return dict(_split(text) for text in vary)


def _split(text: str) -> tuple[str, str]:
    name, sign, values = text.partition("=")
    if not sign or not name.strip() or not values.strip():
        raise ValueError(f'--vary "{text}": it must be NAME=VALUES, such as "cut.spindle_speed=4000:16000:49 rpm"')
    return name.strip(), values.strip()


def hold_feed_per_tooth(file: CaseFile, values: dict[str, Any]) -> None:
    """A case file that gives the feed per tooth means it for every spindle speed; the case itself holds a feed rate."""
    given = file.tables["cut"].get("feed_per_tooth")
    if given is None or "cut.spindle_speed" not in values or {FEED_PER_TOOTH, "cut.feed_rate"} & set(values):
        return
    values[FEED_PER_TOOTH] = given
    console.print(f"feed per tooth held at {given}, as the case file gives it", markup=False)


@contextlib.contextmanager
def _client(address: str | None) -> Iterator[Any]:
    if address is None:
        yield None
        return
    try:
        from distributed import Client
    except ImportError:
        raise ValueError('--cluster needs Dask: pip install "millax[cluster]"') from None
    try:
        client = Client(address, timeout=PATIENCE)
    except (OSError, ValueError) as error:
        raise ValueError(f"--cluster {address}: no scheduler answers there ({error})") from None
    with client:
        yield client


@contextlib.contextmanager
def _progress() -> Iterator[Callable[[SweepProgress], None]]:
    """What shows how far the sweep is: a bar on a terminal, else a line every few seconds."""
    if not console.is_terminal:
        last = -EVERY

        def line(p: SweepProgress) -> None:
            nonlocal last
            if p.done < p.total and p.seconds - last < EVERY:
                return
            last = p.seconds
            console.print(f"{p.done} of {p.total} members, {p.failed} failed, {p.seconds:.1f} s")

        yield line
        return
    columns = (TextColumn("simulating"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(), TimeRemainingColumn())
    with Progress(*columns, console=console, transient=True) as bar:
        task = bar.add_task("simulating", total=None)
        yield lambda p: bar.update(task, completed=p.done, total=p.total)


def _show(result: "xarray.Dataset", path: Path, seconds: float) -> int:
    """Say what came of it, and draw the picture; return the exit code."""
    status = np.asarray(result["status"])
    console.print(f"{status.size} members in {seconds:.1f} s", markup=False)
    for code in np.unique(status[status != 0]):
        console.print(f"{np.count_nonzero(status == code)} of {status.size}: {STATUS[int(code)]}", markup=False)
    if not (status == 0).any():
        complain(f"{path}: not one member could be simulated; the file holds the status of each")
        return 1
    from millax.plots import plot_sweep

    picture = path.with_suffix(".png")
    figure = plot_sweep(result)
    with whole(picture) as temporary:
        figure.savefig(temporary, dpi=150, format="png")
    console.print(f"{path}, {picture}", markup=False)
    return 0
