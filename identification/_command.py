"""`millax fit`: from a case file and its measurements to estimates, a fitted case and a report."""

import contextlib
import importlib.util
import json
import math
import os
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

from rich.table import Table

from ._check_command import show_findings
from ._checkpoint import CheckpointError
from ._fit import fit
from ._fitfile import FitProblem, load_fit
from ._fitted import fitted_text
from ._options import Options
from ._output import complain, console, staged
from ._posterior import sample
from ._profile import profile as profile_of
from ._report import write_report
from ._result import FitResult
from ._running import Progress
from ._words import interval, with_error

_EXIT = {"converged": 0, "interrupted": 130}


def run_fit(
    case_path: str | os.PathLike,
    out_dir: str | os.PathLike,
    *,
    check: bool = True,
    restart: bool = False,
    starts: int | None = None,
    profile: bool | None = None,
    posterior: int | None = None,
) -> int:
    """Fit what a case file asks; write result.h5 (everything), result.json, fitted.toml and report.html into the directory
    `out_dir`. With `check`, a question to which the measurements have no answer is not begun.

    While it runs, checkpoint.h5 in `out_dir` holds where it is, and a fit that was ended goes on from there; with `restart`
    it begins anew. `starts`, `profile` and `posterior` stand in place of what [fit] says.

    Returns the exit code: 0 where every parameter was found; 1 where the answer is no (the result says why, and is written
    all the same); 2 for input that cannot be used, with nothing written, a checkpoint of another question among it; 130
    after Ctrl-C, with the best so far written. fitted.toml is left out where the fit was not begun. Raises `OSError` where
    nothing can be written.
    """
    try:
        problem = load_fit(case_path)
        told = {"starts": starts, "profile": profile, "posterior": posterior}
        options = replace(problem.options, **{name: value for name, value in told.items() if value is not None})
        if options.posterior and importlib.util.find_spec("blackjax") is None:
            raise ValueError('posterior: sampling needs blackjax: pip install "millax[posterior]"')
    except ValueError as error:
        complain(str(error))
        return 2
    show_findings(problem)
    with staged(out_dir):
        pass  # whatever is wrong with the directory is said before the fit
    out = Path(out_dir)
    checkpoint = out / "checkpoint.h5"
    if restart:
        checkpoint.unlink(missing_ok=True)
    elif checkpoint.exists():
        console.print(f"going on from {checkpoint}; --restart begins anew", markup=False)
    try:
        result = _fit(problem, options, check, checkpoint)
    except CheckpointError as error:
        complain(str(error))
        return 2
    # First of all, and by itself: nothing that goes wrong with the other files may lose it.
    result.save(out / "result.h5")
    for stage in (_profiled, _sampled):
        more = stage(result, options)
        if more is not result:
            result = more
            result.save(out / "result.h5")
    with staged(out_dir) as folder:
        text = json.dumps(result.to_json(), indent=2, ensure_ascii=False, allow_nan=False)
        (folder / "result.json").write_text(text + "\n", encoding="utf-8")
        write_report(folder / "report.html", result, title=Path(case_path).name, truth=problem.truth)
        if not result.begun:
            # One from an earlier run would not belong to this result.
            (out / "fitted.toml").unlink(missing_ok=True)
        else:
            (folder / "fitted.toml").write_text(fitted_text(problem, result), encoding="utf-8")
        names = ", ".join(sorted(["result.h5", *(file.name for file in folder.iterdir())]))
    _show(result)
    console.print(f"{out_dir}: {names}", markup=False)
    return _EXIT.get(result.status, 1)


def _fit(problem: FitProblem, options: Options, check: bool, checkpoint: Path) -> FitResult:
    with _showing() as show:
        return fit(
            problem.cases,
            problem.traces,
            problem.parameters,
            noise=options.noise,
            solver=options.solver,
            starts=options.starts,
            spread=options.spread,
            seed=options.seed,
            check=check,
            progress=lambda p: show(_line(p)),
            checkpoint=checkpoint,
        )


def _profiled(result: FitResult, options: Options) -> FitResult:
    """With profiles, where they are wanted and there is an optimum."""
    if not options.profile or not result.has_optimum:
        return result
    try:
        with _showing() as show:
            return replace(result, profiles=profile_of(result, progress=show))
    except KeyboardInterrupt:
        return replace(result, message=f"{result.message} The profiles were stopped by the user.")


def _sampled(result: FitResult, options: Options) -> FitResult:
    """With a posterior, where it is wanted and there is an optimum; why there is none is said in the message."""
    if not options.posterior or not result.has_optimum:
        return result
    try:
        with _showing() as show:
            drawn = sample(result, draws=options.posterior, seed=options.seed, progress=lambda p: show(_line(p)))
    except KeyboardInterrupt:
        return replace(result, message=f"{result.message} The posterior was stopped by the user.")
    except (ValueError, ImportError) as error:
        return replace(result, message=f"{result.message} No posterior: {error}.")
    return replace(result, posterior=drawn, seed=options.seed)


@contextlib.contextmanager
def _showing() -> Iterator[Callable[[str], None]]:
    """Shows what is told: in one line on a terminal, line by line elsewhere."""
    if not console.is_terminal:
        yield lambda words: console.print(words, markup=False)
        return
    with console.status("reading") as status:
        yield status.update


def _line(progress: Progress) -> str:
    words = f"{progress.stage}: iteration {progress.iteration}, "
    if math.isfinite(progress.cost):
        words += f"cost {progress.cost:.5g}, "
    return f"{words}{progress.seconds:.1f} s"


def _show(result: FitResult) -> None:
    """Print status, message and estimates: a table on a terminal, else one line per parameter."""
    console.print(f"{result.status}: {result.message}", markup=False)
    table = Table("parameter", "estimate", "unit", "95 % interval", box=None, pad_edge=False)
    for e in result.parameters:
        known = interval(e.ci95) if e.ci95 else "not known"
        table.add_row(e.name, with_error(e.value, e.std), e.unit, known)
        if not console.is_terminal:
            unit = f" {e.unit}" if e.unit else ""
            console.print(f"{e.name}: {with_error(e.value, e.std)}{unit}, 95 % interval {known}", markup=False)
    if console.is_terminal:
        console.print(table)
    if result.waterfall is not None:
        console.print(result.waterfall.words, markup=False)
    for one in result.profiles:
        found = interval(one.ci95) if one.ci95 else f"not known: {one.reason}"
        console.print(f"{one.name}: 95 % interval by profile {found}", markup=False)
    if result.posterior is not None:
        found = result.posterior
        console.print(
            f"posterior: {found.draws[..., 0].size} draws, R-hat at most {found.rhat.max():.3f}, effective draws at least "
            f"{found.ess.min():.0f}. {found.reason or 'Nothing speaks against it.'}",
            markup=False,
        )
    console.print(f"{result.iterations} iterations in {result.seconds:.1f} s")
