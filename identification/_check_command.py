"""`millax check`: before any fit, are the data good enough, and can they say what is asked?"""

import os

from rich.table import Table

from millax import CaseError

from ._fitfile import FitProblem, load_fit
from ._identifiability import Check, check
from ._output import console
from ._quality import Finding, quality
from ._traces import Trace
from ._words import plain

CORRELATED = 0.95
"""Correlation of two estimates from which on it is worth a word: each is then known three times worse than alone."""

UNKNOWN_NOISE = "Where the noise of a channel is not given, it is taken as 1 % of its root mean square."


def run_check(case_path: str | os.PathLike) -> int:
    """Print what the measurements of a case file can say about its free numbers, and what may be wrong with them.

    Returns the exit code: 0 where every number can be known and nothing is wrong with any trace, 1 otherwise. Raises
    `CaseError` and `TraceError` for input that cannot be used, `SimulationError` where the simulation fails.
    """
    problem = load_fit(case_path)
    findings = show_findings(problem)
    try:
        found = check(problem.cases, problem.traces, problem.parameters)
    except ValueError as error:
        raise CaseError(f"{case_path}: {error}") from None
    _show(found)
    return 0 if found.identifiable and not findings else 1


def show_findings(problem: FitProblem) -> list[Finding]:
    """Print what may be wrong with the traces; returns it."""
    findings = [finding for one in problem.traces if isinstance(one, Trace) for finding in quality(one)]
    for finding in findings:
        console.print(f"warning: {finding.words}", markup=False)
    return findings


def _show(found: Check) -> None:
    """A table on a terminal, else one line per parameter; then what else a person should know."""
    console.print(found.message, markup=False)
    table = Table("parameter", "guess", "expected standard error", "of the guess", box=None, pad_edge=False)
    for p in found.parameters:
        unit = f" {p.unit}" if p.unit else ""
        expected = "not known" if p.std is None else f"{plain(p.std, 2)}{unit}"
        part = "" if p.std is None or p.guess == 0 else f"{100 * p.std / abs(p.guess):.2g} %"
        table.add_row(p.name, f"{plain(p.guess)}{unit}", expected, part)
        if not console.is_terminal:
            beside = f", {part} of it" if part else ""
            console.print(
                f"{p.name}: guess {plain(p.guess)}{unit}, expected standard error {expected}{beside}", markup=False
            )
    if console.is_terminal:
        console.print(table)
    for first, second, correlation in found.pairs(CORRELATED):
        console.print(f"{first} and {second} are hard to tell apart: correlation {correlation:+.3f}", markup=False)
    console.print(f"condition number {found.condition:.3g}. {UNKNOWN_NOISE}", markup=False)
