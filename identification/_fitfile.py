"""The part of a case file that asks a question: the table [fit], see `_asked.py`, and what was measured.

[[trace]]
file = "trace.csv"                      # beside the case file
format = "csv"                          # or "dynoware", "mat", "hdf5", "tdms"; default: found from the file
columns = { time = "Time", Fx = "-Fz", x = "laser [um]" }   # what the file calls them; default: by the channels' names
channels = ["Fx", "Fy", "x", "y"]       # default: all columns, or all that columns = ... names
rate = "10 kHz"                         # of sampling, for a file without times
resample = true                         # interpolate uneven times, which are refused otherwise
noise = { Fx = "2 N", x = "1 um" }      # standard deviation where it is known; estimated where it is not
window = ["0 s", "0.3 s"]               # default: the whole trace
case = { cut.spindle_speed = "8000 rpm" }   # where this cut differs from the case above; free numbers are shared
align = true                            # start with the phase and the speed of the spindle that the trace shows

[[load_test]]                           # deflections of the robot; beside traces, or in their place
file = "deflections.csv"
channels = ["x", "z"]                   # default: all columns that are no pose and no load
noise = { x = "10 um", z = "10 um" }
case = { robot.tool.xyz = ["0 mm", "0 mm", "200 mm"] }
"""

import json
import os
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from millax import Case, CaseError, CaseFile
from millax._units import show

from ._align import align
from ._asked import asked_in, check_keys
from ._loadtest import LoadTest, read_load_test
from ._options import Options
from ._parameters import Parameter, Tie, free
from ._question import compared
from ._traces import Trace, read_trace

_MEASURED: dict[str, tuple[Callable[..., Trace | LoadTest], tuple[str, ...]]] = {
    "trace": (read_trace, ("file", "format", "columns", "channels", "noise", "window", "rate", "resample", "case", "align")),
    "load_test": (read_load_test, ("file", "channels", "noise", "case")),
}
"""The tables of what was measured: what reads their files, and their keys."""


@dataclass(frozen=True)
class FitProblem:
    """A question read from a case file, ready for `fit(problem.cases, problem.traces, problem.parameters)`: all that was
    measured has its case.

    `truth` holds the SI values that estimates are to be compared with, where they are known; `options` say how to fit.
    """

    file: CaseFile
    cases: tuple[Case, ...]
    traces: tuple[Trace | LoadTest, ...]
    """Traces, then load tests, in the order of the file."""
    parameters: tuple[Parameter | Tie, ...]
    truth: dict[str, float]
    options: Options

    @property
    def case(self) -> Case:
        """The case of the file, as it is above all that was measured."""
        return self.file.case


def load_fit(path: str | os.PathLike) -> FitProblem:
    """Read a case file with [fit.free] and [[trace]] or [[load_test]], and check everything that can be checked
    before a fit.

    Raises `CaseError` for the case file and `TraceError` for what was measured, both `ValueError`s.
    """
    file = CaseFile.read(path)
    try:
        asked = asked_in(file)
        parameters = asked.parameters
        numbers = free(file.case, parameters)
        sources = _sources(file)
    except CaseError:
        raise
    except ValueError as error:
        raise CaseError(f"{file.source}: {error}") from error
    for parameter in parameters:
        file.leaf(parameter.name)  # an estimate of a number that the file leaves to its default could not be written back
    shared = [leaf for leaf, place in zip(numbers.leaves, numbers.places, strict=True) if place is None]
    cases = _cases(file, [(source.table, source.case) for source in sources], shared)
    measured = tuple(source.read(Path(path).parent) for source in sources)
    cases = tuple(
        replace(case, clock=align(case, one)) if source.aligned and isinstance(one, Trace) else case
        for source, one, case in zip(sources, measured, cases, strict=True)
    )
    for one, case in zip(measured, cases, strict=True):
        compared(one, case, numbers.leaves)
    return FitProblem(file, cases, measured, parameters, asked.truth, asked.options)


def measured_in(tables: Mapping[str, Any]) -> list[tuple[str, Any]]:
    """Every [[trace]], then every [[load_test]] of a case file: kind and table."""
    return [(kind, table) for kind in _MEASURED for table in tables.get(kind, [])]


def _cases(file: CaseFile, changes: list[tuple[str, Mapping[str, Any]]], free_names: Collection[str]) -> tuple[Case, ...]:
    """The case of every table, from its name and its changes: the same object where nothing differs. Raises `CaseError`."""
    known: dict[str, Case] = {"{}": file.case}
    keys_of = [json.dumps(change, sort_keys=True, default=str) for _, change in changes]
    for (table, change), key in zip(changes, keys_of, strict=True):
        if key in known:
            continue
        where = f"{file.source}, {table}, case"
        for section, keys in change.items():
            for name in keys if isinstance(keys, Mapping) else ():
                ours = [free for free in free_names if free == f"{section}.{name}" or free.startswith(f"{section}.{name}.")]
                if ours:
                    raise CaseError(
                        f"{where}: {section}.{name} given, but {ours[0]} is free; it has one value in all that was measured"
                    )
        known[key] = file.changed(change, where).case
    return tuple(known[key] for key in keys_of)


@dataclass(frozen=True)
class _Source:
    """A table of what was measured: its name and number, what reads its file, and what is said there."""

    table: str
    reader: Callable[..., Trace | LoadTest]
    given: Mapping[str, Any]

    @property
    def case(self) -> Mapping[str, Any]:
        return self.given.get("case", {})

    @property
    def aligned(self) -> bool:
        return self.given.get("align", False)

    def read(self, folder: Path) -> Trace | LoadTest:
        others = {key: value for key, value in self.given.items() if key not in ("file", "case", "align")}
        return self.reader(folder / self.given["file"], **others)


def _sources(file: CaseFile) -> list[_Source]:
    """Every [[trace]], then every [[load_test]]."""
    sources = []
    for kind, (reader, keys) in _MEASURED.items():
        given = file.tables.get(kind, [])
        if not isinstance(given, list) or not all(isinstance(table, Mapping) for table in given):
            raise ValueError(f"there is no [[{kind}]], only {kind}; write [[{kind}]], as there may be several")
        for i, table in enumerate(given, 1):
            check_keys(f"[{kind}]", table, keys)
            if not isinstance(table.get("file"), str):
                raise ValueError(f'[[{kind}]]: file is missing; it names the file: file = "{kind}.csv"')
            for key, form, words in (
                ("format", str, 'a word, such as "dynoware"'),
                ("columns", Mapping, 'a table, such as { time = "Time", Fx = "-Fz", x = "laser [um]" }'),
                ("channels", list, 'a list, such as ["Fx", "x"]'),
                ("noise", Mapping, 'a table, such as { x = "10 um" }'),
                ("window", list, 'two times, such as ["0 s", "0.3 s"]'),
                ("resample", bool, "true or false"),
                ("align", bool, "true or false"),
                ("case", Mapping, 'a table, such as { cut.spindle_speed = "8000 rpm" }'),
            ):
                if key in table and not isinstance(table[key], form):
                    raise ValueError(f"[[{kind}]]: {key} = {show(table[key])} given; it must be {words}")
            sources.append(_Source(f"[[{kind}]] {i}", reader, table))
    if not sources:
        raise ValueError(
            'there is no [[trace]] in the file, and no [[load_test]]; they name what was measured: file = "trace.csv"'
        )
    return sources
