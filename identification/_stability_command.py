"""`millax stability`: from a case file to the lobe diagram."""

import contextlib
import os
import time
from collections.abc import Callable, Iterator

import numpy as np
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

from millax import STABILITY_METHODS, CaseError, CaseFile, StabilityProgress, stability

from ._output import complain, console, staged

AROUND, MANY = (0.5, 1.5), 61
"""Speeds by default: from and to, over that of the case, and how many."""

EVERY = 2.0
"""Seconds between two lines of progress where nobody looks at a terminal."""

AGREEMENT = 0.02
"""Difference of two methods, over the limit depth, that is worth a word."""


def run_stability(
    case_path: str | os.PathLike,
    out: str | os.PathLike,
    *,
    speeds: str | None = None,
    depths: str | None = None,
    methods: str = "semi,floquet,time",
) -> int:
    """Draw the stability lobe diagram of a case file; write stability.nc and stability.png into `out`.

    `speeds` and `depths` are texts like "5000:25000:101 rpm", `methods` names between commas. Returns the exit code: 0; 1
    where no limit was found at any speed. Raises `CaseError` for input that cannot be used, `OSError` where nothing can be
    written.
    """
    file = CaseFile.read(case_path)
    begin = time.perf_counter()
    given = speeds
    if given is None:
        own = float(file.case.cut.spindle_speed) * 60 / (2 * np.pi)
        given = f"{AROUND[0] * own:.6g}:{AROUND[1] * own:.6g}:{MANY} rpm"
    names = [name.strip() for name in methods.split(",")]
    with staged(out) as folder:
        try:
            with _progress() as progress:
                result = stability(file.case, given, depths=depths, methods=names, progress=progress)  # type: ignore[arg-type]
        except CaseError:
            raise
        except ValueError as error:
            raise CaseError(f"{case_path}: {error}") from None
        result.attrs["case"] = os.fspath(case_path)
        result.to_netcdf(folder / "stability.nc", engine="h5netcdf")
        from millax.plots import plot_stability

        plot_stability(result).savefig(folder / "stability.png", dpi=150)
    limits = result["limit_depth"].to_numpy()
    console.print(f"{limits.shape[1]} speeds, {len(names)} methods in {time.perf_counter() - begin:.1f} s", markup=False)
    _differences(names, limits)
    console.print(f"{os.path.join(out, 'stability.nc')}, {os.path.join(out, 'stability.png')}", markup=False)
    missing = np.count_nonzero(~np.isfinite(limits).any(axis=0))
    if missing == limits.shape[1]:
        complain(f"{case_path}: no limit of stability was found at any speed; the cut is stable at every depth looked at")
        return 1
    if missing:
        console.print(
            f"{missing} of {limits.shape[1]} speeds: no limit found, stable at every depth looked at", markup=False
        )
    return 0


def _differences(names, limits) -> None:
    """Say by how much the methods differ."""
    for name, limit in zip(names[1:], limits[1:], strict=True):
        both = np.isfinite(limit) & np.isfinite(limits[0])
        if not both.any():
            console.print(f"{name}: no limit beside one of {names[0]}", markup=False)
            continue
        apart = np.abs(limit[both] / limits[0][both] - 1)
        beyond = np.count_nonzero(apart > AGREEMENT)
        words = f"; more than {100 * AGREEMENT:g} % at {beyond} of {both.sum()} speeds" if beyond else ""
        console.print(
            f"{name} beside {names[0]}: limit depths differ by {100 * np.median(apart):.2g} % (median), "
            f"{100 * apart.max():.2g} % at most{words}",
            markup=False,
        )


@contextlib.contextmanager
def _progress() -> Iterator[Callable[[StabilityProgress], None]]:
    """What shows how far the diagram is: a bar on a terminal, else a line every few seconds."""
    begin, words = time.perf_counter(), {"map": "spectral radius", **STABILITY_METHODS}
    if not console.is_terminal:
        last = -EVERY

        def line(p: StabilityProgress) -> None:
            nonlocal last
            now = time.perf_counter() - begin
            if p.done < p.total and now - last < EVERY:
                return
            last = now
            console.print(f"{words[p.method]}: {p.done} of {p.total} speeds, {now:.1f} s", markup=False)

        yield line
        return
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    with Progress(*columns, console=console, transient=True) as bar:
        tasks = {}

        def update(p: StabilityProgress) -> None:
            if p.method not in tasks:
                tasks[p.method] = bar.add_task(words[p.method], total=p.total)
            bar.update(tasks[p.method], completed=p.done, total=p.total)

        yield update
