"""The part of a case file that asks a question: which numbers are free, and which traces were measured.

[fit.free]                              # the numbers to find
force.k0 = { guess = "10000 N/mm^2", bounds = ["1000 N/mm^2", "none"] }
force.kr = {}                           # start from the case's own value, without bounds
structure.damping_ratio.x = 0.1         # short for { guess = 0.1 }

[fit.truth]                             # for synthetic data: what the estimates are compared with
force.k0 = "5000 N/mm^2"

[[trace]]
file = "trace.csv"                      # beside the case file
channels = ["Fx", "Fy", "x", "y"]       # default: all columns
noise = { Fx = "2 N", x = "1 um" }      # standard deviation where it is known; estimated where it is not
window = ["0 s", "0.3 s"]               # default: the whole trace
"""

import difflib
import os
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from millax import Case, CaseError, CaseFile
from millax._names import Number, read_value, valid_names
from millax._units import show

from ._compare import compare
from ._parameters import Parameter, free
from ._traces import Trace, read_trace

_FREE_KEYS = ("guess", "bounds")
_TRACE_KEYS = ("file", "channels", "noise", "window")


@dataclass(frozen=True)
class FitProblem:
    """A question read from a case file, ready for `fit(problem.case, problem.traces, problem.parameters)`.

    `truth` holds the SI values that estimates are to be compared with, where they are known.
    """

    file: CaseFile
    traces: tuple[Trace, ...]
    parameters: tuple[Parameter, ...]
    truth: dict[str, float]

    @property
    def case(self) -> Case:
        """The case, with its own values in it."""
        return self.file.case


def load_fit(path: str | os.PathLike) -> FitProblem:
    """Read a case file with [fit.free] and [[trace]], and check everything that can be checked before a fit.

    Raises `CaseError` for the case file and `TraceError` for the traces, both `ValueError`s.
    """
    file = CaseFile.read(path)
    try:
        parameters, truth = _question(file)
        numbers = free(file.case, parameters)
        sources = _sources(file)
    except CaseError:
        raise
    except ValueError as error:
        raise CaseError(f"{file.source}: {error}") from error
    for name in numbers.names:
        file.leaf(name)  # an estimate of a number that the file leaves to its default could not be written back
    traces = tuple(read_trace(Path(path).parent / source.pop("file"), **source) for source in sources)
    for trace in traces:
        compare(trace, file.case, numbers.names)
    return FitProblem(file, traces, parameters, truth)


def _question(file: CaseFile) -> tuple[tuple[Parameter, ...], dict[str, float]]:
    tables = file.tables.get("fit")
    if not isinstance(tables, Mapping):
        raise ValueError('the table [fit.free] is missing; it names the numbers to find: force.k0 = { guess = "..." }')
    _check_keys("fit", tables, ("free", "truth"))
    known = valid_names(file.case)
    asked = dict(_flat("fit.free", tables.get("free", {}), known))
    truth = {name: read_value(file.case, name, value) for name, value in _flat("fit.truth", tables.get("truth", {}), known)}
    return tuple(_parameter(file, name, given) for name, given in asked.items()), truth


def _flat(table: str, given: Any, known: Collection[str], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Names and values of a table whose keys are dotted names, quoted or not."""
    if not isinstance(given, Mapping):
        raise ValueError(f"{table}: {show(given)} given; it must be a table, [{table}]")
    for key, value in given.items():
        name = f"{prefix}{key}"
        if isinstance(value, Mapping) and name not in known and not set(value) & set(_FREE_KEYS):
            yield from _flat(table, value, known, f"{name}.")
        else:
            yield name, value


def _parameter(file: CaseFile, name: str, given: Any) -> Parameter:
    if not isinstance(given, Mapping):
        return Parameter(name, guess=given)
    _check_keys(f"fit.free.{name}", given, _FREE_KEYS)
    bounds = given.get("bounds", ["none", "none"])
    if not isinstance(bounds, list) or len(bounds) != 2:
        raise ValueError(f'bounds of {name}: {show(bounds)} given; they are two, "none" where there is none')
    low, high = (None if bound == "none" else bound for bound in bounds)
    # Without a guess the number is the file's own, and so is its unit.
    unit = file.leaves[name].unit if "guess" not in given and name in file.leaves else None
    return Parameter(name, guess=given.get("guess"), bounds=(low, high), unit=unit)


def _sources(file: CaseFile) -> list[dict[str, Any]]:
    """The arguments of `read_trace` for every trace."""
    given = file.tables.get("trace")
    if not isinstance(given, list) or not given:
        raise ValueError('there is no [[trace]] in the file; it names what was measured: file = "trace.csv"')
    for table in given:
        _check_keys("[trace]", table, _TRACE_KEYS)
        if not isinstance(table.get("file"), str):
            raise ValueError('[[trace]]: file is missing; it names the CSV file: file = "trace.csv"')
        for key, kind, words in (
            ("channels", list, 'a list, such as ["Fx", "x"]'),
            ("noise", Mapping, 'a table, such as { Fx = "2 N" }'),
            ("window", list, 'two times, such as ["0 s", "0.3 s"]'),
        ):
            if key in table and not isinstance(table[key], kind):
                raise ValueError(f"[[trace]]: {key} = {show(table[key])} given; it must be {words}")
    return [dict(table) for table in given]


def _check_keys(table: str, given: Mapping[str, Number], known: Collection[str]) -> None:
    for key in given:
        if key not in known:
            near = difflib.get_close_matches(key, known, n=1)
            hint = f" Did you mean {near[0]}?" if near else ""
            raise ValueError(f"[{table}]: unknown key {key}.{hint} It takes: {', '.join(known)}")
