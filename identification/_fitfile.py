"""The part of a case file that asks a question: which numbers are free, and what was measured.

[fit.free]                              # the numbers to find
force.k0 = { guess = "10000 N/mm^2", bounds = ["1000 N/mm^2", "none"] }
force.kr = {}                           # start from the case's own value, without bounds
structure.damping_ratio.x = 0.1         # short for { guess = 0.1 }

[fit.truth]                             # for synthetic data: what the estimates are compared with
force.k0 = "5000 N/mm^2"

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

[[load_test]]                           # deflections of the robot; beside traces, or in their place
file = "deflections.csv"
channels = ["x", "z"]                   # default: all columns that are no pose and no load
noise = { x = "10 um", z = "10 um" }
case = { robot.tool.xyz = ["0 mm", "0 mm", "200 mm"] }
"""

import difflib
import json
import os
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from millax import Case, CaseError, CaseFile
from millax._names import Number, read_value, valid_names
from millax._units import show

from ._loadtest import LoadTest, read_load_test
from ._parameters import Parameter, free
from ._question import compared
from ._traces import Trace, read_trace

_FREE_KEYS = ("guess", "bounds")

_MEASURED: dict[str, tuple[Callable[..., Trace | LoadTest], tuple[str, ...]]] = {
    "trace": (read_trace, ("file", "format", "columns", "channels", "noise", "window", "rate", "resample", "case")),
    "load_test": (read_load_test, ("file", "channels", "noise", "case")),
}
"""The tables of what was measured: what reads their files, and their keys."""


@dataclass(frozen=True)
class FitProblem:
    """A question read from a case file, ready for `fit(problem.cases, problem.traces, problem.parameters)`: all that was
    measured has its case.

    `truth` holds the SI values that estimates are to be compared with, where they are known.
    """

    file: CaseFile
    cases: tuple[Case, ...]
    traces: tuple[Trace | LoadTest, ...]
    """Traces, then load tests, in the order of the file."""
    parameters: tuple[Parameter, ...]
    truth: dict[str, float]

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
        parameters, truth = _question(file)
        numbers = free(file.case, parameters)
        sources = _sources(file)
    except CaseError:
        raise
    except ValueError as error:
        raise CaseError(f"{file.source}: {error}") from error
    for name in numbers.names:
        file.leaf(name)  # an estimate of a number that the file leaves to its default could not be written back
    cases = _cases(file, [(source.table, source.case) for source in sources], numbers.names)
    measured = tuple(source.read(Path(path).parent) for source in sources)
    for one, case in zip(measured, cases, strict=True):
        compared(one, case, numbers.names)
    return FitProblem(file, cases, measured, parameters, truth)


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


@dataclass(frozen=True)
class _Source:
    """A table of what was measured: its name and number, what reads its file, and what is said there."""

    table: str
    reader: Callable[..., Trace | LoadTest]
    given: Mapping[str, Any]

    @property
    def case(self) -> Mapping[str, Any]:
        return self.given.get("case", {})

    def read(self, folder: Path) -> Trace | LoadTest:
        others = {key: value for key, value in self.given.items() if key not in ("file", "case")}
        return self.reader(folder / self.given["file"], **others)


def _sources(file: CaseFile) -> list[_Source]:
    """Every [[trace]], then every [[load_test]]."""
    sources = []
    for kind, (reader, keys) in _MEASURED.items():
        given = file.tables.get(kind, [])
        if not isinstance(given, list) or not all(isinstance(table, Mapping) for table in given):
            raise ValueError(f"there is no [[{kind}]], only {kind}; write [[{kind}]], as there may be several")
        for i, table in enumerate(given, 1):
            _check_keys(f"[{kind}]", table, keys)
            if not isinstance(table.get("file"), str):
                raise ValueError(f'[[{kind}]]: file is missing; it names the file: file = "{kind}.csv"')
            for key, form, words in (
                ("format", str, 'a word, such as "dynoware"'),
                ("columns", Mapping, 'a table, such as { time = "Time", Fx = "-Fz", x = "laser [um]" }'),
                ("channels", list, 'a list, such as ["Fx", "x"]'),
                ("noise", Mapping, 'a table, such as { x = "10 um" }'),
                ("window", list, 'two times, such as ["0 s", "0.3 s"]'),
                ("resample", bool, "true or false"),
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


def _check_keys(table: str, given: Mapping[str, Number], known: Collection[str]) -> None:
    for key in given:
        if key not in known:
            near = difflib.get_close_matches(key, known, n=1)
            hint = f" Did you mean {near[0]}?" if near else ""
            raise ValueError(f"[{table}]: unknown key {key}.{hint} It takes: {', '.join(known)}")
