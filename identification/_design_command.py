"""`millax design`: from a case file, what was measured, and what can be chosen, to the next cut."""

import os
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from rich.table import Table

from millax import CaseError, CaseFile

from ._asked import asked_in
from ._design import Design, Forecast, design
from ._fitfile import load_fit, measured_in
from ._measured import TraceError
from ._output import complain, console, staged
from ._recording import Recording
from ._sweep_command import by_name, hold_feed_per_tooth
from ._words import plain, unit_words

SHOWN = 5
"""Candidates that are printed."""


def run_design(
    case_path: str | os.PathLike,
    out: str | os.PathLike,
    vary: Sequence[str],
    *,
    criterion: str = "D",
    count: int = 1,
    channels: str | None = None,
    duration: str | None = None,
    rate: str | None = None,
    noise: Sequence[str] = (),
) -> int:
    """Find the next cut for the question of a case file; write design.nc and design.png into `out`.

    `vary` and `noise` hold texts like "cut.depth=0.5:3:6 mm" and "Fx=2 N", `channels` names between commas. A case file with
    [fit.free] but nothing measured is a question too. Returns the exit code: 0; 1 where no candidate can be ranked, and
    there is no picture then. Raises `CaseError` and `TraceError` for input that cannot be used, `SimulationError` where the
    simulation of what was measured fails, `OSError` where nothing can be written.
    """
    file, begin = CaseFile.read(case_path), time.perf_counter()
    with staged(out) as folder:
        try:
            cases, measured, parameters = _question(file, case_path)
            values: dict[str, Any] = dict(by_name(vary))
            hold_feed_per_tooth(file, values)
            recording = Recording(
                channels=None if channels is None else [name.strip() for name in channels.split(",")],
                duration=duration,
                rate=rate,
                noise=dict(_noise(text) for text in noise),
            )
            asking = "asking what each cut would tell"
            with console.status(asking) as status:
                result = design(
                    file.case,
                    measured,
                    parameters,
                    values,
                    cases=cases,
                    recording=recording,
                    criterion=criterion,
                    count=count,
                    progress=lambda done, of: status.update(f"{asking}: {done} of {of}"),
                )
        except (CaseError, TraceError):
            raise
        except ValueError as error:
            raise CaseError(f"{case_path}: {error}") from None
        result.table.attrs["case"] = os.fspath(case_path)
        result.table.to_netcdf(folder / "design.nc", engine="h5netcdf")
        if result.next:
            from ._design_figure import plot_design

            plot_design(result).savefig(folder / "design.png", dpi=150)
        else:
            # One from an earlier run would not belong to this result.
            (Path(out) / "design.png").unlink(missing_ok=True)
        names = ", ".join(sorted(one.name for one in folder.iterdir()))
    console.print(f"{result.table['status'].size} candidates in {time.perf_counter() - begin:.1f} s", markup=False)
    _not_ranked(result)
    if not result.next:
        complain(f"{case_path}: no candidate can be ranked; design.nc holds the reason of each")
        return 1
    _show(result)
    console.print(f"{out}: {names}", markup=False)
    return 0


def _question(file: CaseFile, path: str | os.PathLike):
    """The cases of what was measured, what was measured, and the parameters."""
    if measured_in(file.tables):
        problem = load_fit(path)
        return problem.cases, problem.traces, problem.parameters
    return None, (), asked_in(file).parameters


def _noise(text: str) -> tuple[str, str]:
    channel, sign, value = text.partition("=")
    if not sign or not channel.strip() or not value.strip():
        raise ValueError(f'--noise "{text}": it must be NAME=VALUE, such as "Fx=2 N"')
    return channel.strip(), value.strip()


def _not_ranked(result: Design) -> None:
    """How many are not, and why."""
    reasons, counts = np.unique(result.table["reason"].to_numpy().astype(str), return_counts=True)
    why = [(int(n), reason) for reason, n in zip(reasons, counts, strict=True) if reason]
    for n, reason in sorted(why, reverse=True)[:SHOWN]:
        console.print(f"not ranked, {n} of {counts.sum()}: {reason}", markup=False)
    if len(why) > SHOWN:
        console.print(f"not ranked for other reasons: {sum(n for n, _ in sorted(why, reverse=True)[SHOWN:])}", markup=False)


def _show(result: Design) -> None:
    """What to cut next, in words, and the standard errors today and after the best candidates."""
    earlier = result.today
    for i, one in enumerate(result.next):
        console.print(f"{'cut next' if i == 0 else 'and then'}: {one.words}. {_gain(result, earlier, one)}", markup=False)
        earlier = one
    _ends(result)
    best = result.best(SHOWN)
    for i, one in enumerate(best, 1):
        console.print(f"  {i}: {one.words}", markup=False)
    console.print("standard errors today, and expected after each of these cuts:", markup=False)
    table = Table("parameter", "value", "today", *(str(i + 1) for i in range(len(best))), box=None, pad_edge=False)
    for name, value, unit in zip(result.parameters, result.values, result.units, strict=True):
        errors = [_error(one.std[name]) for one in (result.today, *best)]
        table.add_row(name, f"{plain(value)} {unit_words(unit)}".strip(), *errors)
        if not console.is_terminal:
            shown = ", ".join(f"{i}: {error}" for i, error in enumerate(errors[1:], 1))
            console.print(
                f"{name}: {plain(value)} {unit_words(unit)}".strip() + f", today {errors[0]}, {shown}", markup=False
            )
    if console.is_terminal:
        console.print(table)
    console.print("Derivatives are those at the values above: with better ones, ask again.", markup=False)


def _gain(result: Design, earlier: Forecast, after: Forecast) -> str:
    """What a cut brings, in words."""
    found = after.known_since(earlier)
    words = [f"It makes known: {', '.join(found)}."] if found else []
    factor = after.shrinks(earlier)
    if not np.isfinite(factor):
        pass
    elif result.criterion == "D":
        volume = factor ** len(result.parameters)
        words.append(f"Standard errors shrink {factor:.3g} times on average, the volume of confidence {volume:.3g} times.")
    elif result.criterion == "A":
        words.append(f"Standard errors over values shrink {factor:.3g} times on average.")
    else:
        words.append(f"The standard error of {result.criterion} shrinks {factor:.3g} times.")
    open_ = [name for name, std in after.std.items() if std is None]
    if open_:
        words.append(f"Still not known then: {', '.join(open_)}.")
    return " ".join(words)


def _ends(result: Design) -> None:
    """Say where the best cut is at an end of what can be chosen."""
    for name, (value, _) in result.next[0].cut.items():
        values = np.atleast_1d(result.table[name].to_numpy())
        if len(values) > 1 and value in (values.min(), values.max()):
            end = "largest" if value == values.max() else "smallest"
            console.print(f"{name} is the {end} of those given: beyond it may be a better one.", markup=False)


def _error(std: float | None) -> str:
    return "not known" if std is None else plain(std, 2)
