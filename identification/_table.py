"""Which columns of a file are what, in SI units: the same for every format of file and every kind of measurement."""

import difflib
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from millax._units import UnitError, parse

from ._formats import read_raw
from ._formats._raw import EvenTimes, Raw, RawColumn, listed, shown, split_label
from ._measured import TraceError, check_finite, known_channel


@dataclass(frozen=True)
class Layout:
    """What the columns of a kind of file may be.

    - `kind`: of file, for messages.
    - `example`: of its first row.
    - `channels`: what is measured, with SI units. Only these may be left out by saying which channels to use.
    - `others`: what else a file may hold, with SI units.
    - `numbered`: columns that come as name1, name2 and so on, by the name without the number, with SI units.
    - `any_case`: those of the others that may be written with capitals.
    """

    kind: str
    example: str
    channels: Mapping[str, str]
    others: Mapping[str, str]
    numbered: Mapping[str, str] = field(default_factory=dict)
    any_case: tuple[str, ...] = ()

    def unit(self, name: str) -> str | None:
        """The SI unit of a column; None for one that is unknown."""
        series = re.fullmatch(r"(\D+)[1-9]\d*", name)
        if series and series[1] in self.numbered:
            return self.numbered[series[1]]
        return self.others.get(name) or self.channels.get(name)

    def known(self, written: str) -> str:
        """The name of a column that a file calls `written`."""
        return written.lower() if written.lower() in self.any_case else written

    def hint(self, name: str) -> str:
        """The name that an unknown one may be meant to be, as a sentence."""
        return _hint(name, [*self.others, *self.channels])

    @property
    def words(self) -> str:
        """Every column, in words."""
        return ", ".join([*(f"{name}1, {name}2 and so on" for name in self.numbered), *self.others, *self.channels])


@dataclass(frozen=True)
class Column:
    """Where a column stands in its file, its unit as it is written, and what its numbers are multiplied by: their unit in SI
    and their sign."""

    index: int
    name: str
    unit: str
    factor: float


@dataclass(frozen=True)
class Table:
    """The columns of a file that are used.

    - `columns`: in the order of the file, or in that in which they were asked for.
    - `numbers`: SI, shape (rows, columns), NaN where a cell is no number.
    - `lines`: where the rows stand in the file, and `row`, what that is called.
    - `clocks`: the times that the file states for each column; None where it states none.
    """

    path: Path
    layout: Layout
    columns: tuple[Column, ...]
    numbers: np.ndarray
    lines: np.ndarray
    row: str
    clocks: Mapping[str, EvenTimes | None]

    @property
    def names(self) -> tuple[str, ...]:
        """Of all columns."""
        return tuple(column.name for column in self.columns)

    @property
    def channels(self) -> tuple[str, ...]:
        """The columns that are channels."""
        return tuple(name for name in self.names if name in self.layout.channels)

    @property
    def units(self) -> dict[str, str]:
        """Of the channels, as they are written."""
        return {column.name: column.unit for column in self.columns if column.name in self.layout.channels}

    def of(self, *names: str) -> np.ndarray:
        """The columns of these names, shape (rows, names); zero where there is none."""
        nothing = np.zeros(len(self.lines))
        columns = [self.numbers[:, self.names.index(name)] if name in self.names else nothing for name in names]
        return np.stack(columns, axis=1)

    def part(self, rows: np.ndarray) -> "Table":
        """Some of the rows."""
        return replace(self, numbers=self.numbers[rows], lines=self.lines[rows])

    def place(self, row: int) -> str:
        """Where a row stands in the file."""
        return f"{self.row} {self.lines[row]}"

    def check_finite(self, cure: str) -> None:
        """Raise `TraceError` for a cell that is not a finite number, with `cure`, what to do."""
        check_finite(str(self.path), self.numbers, self.names, self.place, cure)

    def noise(self, given: Mapping[str, float | str] | None) -> dict[str, float]:
        """Standard deviations in SI by channel. Raises `ValueError` for an unknown channel or unit."""
        channels = self.layout.channels
        return {
            known_channel(channel, channels, f"{self.path}: noise"): float(
                parse(f"{self.path}: noise of {channel}", value, channels[channel])
            )
            for channel, value in (given or {}).items()
        }


def read_table(
    path: Path,
    layout: Layout,
    channels: Sequence[str] | None,
    *,
    columns: Mapping[str, str] | None = None,
    format: str | None = None,
) -> Table:
    """Read a file; of the channels those named, None: all. `columns` says what the file calls them, where it uses other
    names; `read_trace` says how.

    Raises `TraceError`, which names the file and the row or column.
    """
    for channel in channels or ():
        known_channel(channel, layout.channels, f"{path}: channels")
    raw = read_raw(path, layout.kind, format)
    if not raw.columns:
        begin = f"its first row names the columns, such as {layout.example}" if raw.text else "there is no array of samples"
        raise TraceError(f"{path}: the file is empty; {begin}")
    used = _by_name(path, raw, layout, channels) if columns is None else _as_told(path, raw, layout, channels, columns)
    missing = [channel for channel in channels or () if channel not in {column.name for column in used}]
    if missing:
        where = "the columns are " + raw.names if columns is None else "columns = ... names " + listed(list(columns))
        raise TraceError(f"{path}: no column {missing[0]}; {where}")
    if not any(column.name in layout.channels for column in used):
        beside = f" beside {listed([column.name for column in used])}" if used else ""
        raise TraceError(f"{path}: there is no channel{beside}; known are {', '.join(layout.channels)}")
    numbers, lines = raw.numbers([column.index for column in used])
    clocks = {column.name: raw.columns[column.index].clock for column in used}
    return Table(path, layout, used, numbers * [column.factor for column in used], lines, raw.row, clocks)


def _by_name(path: Path, raw: Raw, layout: Layout, channels: Sequence[str] | None) -> tuple[Column, ...]:
    """The channels asked for and what else is known, by the names they have in the file."""
    found: dict[str, Column] = {}
    for index, column in enumerate(raw.columns):
        name = layout.known(column.last)
        known = layout.unit(name) is not None
        if channels is not None and name not in channels and (not known or name in layout.channels):
            continue
        if not known:
            begin = f"The first row names the columns, such as {layout.example}; known" if raw.text else "Known"
            raise TraceError(
                f"{path}: {column.label} is not a channel.{layout.hint(column.last)} {begin} are {layout.words}. "
                "To leave out others, say which to use: channels = [...]"
            )
        if name in found:
            first = raw.columns[found[name].index].label
            raise TraceError(
                f"{path}: {column.label} is there twice, first as {first}; keep one{_instead(raw, name, column)}"
            )
        found[name] = _column(path, raw, layout, index, name)
    return tuple(found.values())


def _as_told(
    path: Path, raw: Raw, layout: Layout, channels: Sequence[str] | None, columns: Mapping[str, str]
) -> tuple[Column, ...]:
    """The columns told, and those that may be written in any case by their own name."""
    found = []
    for name, told in columns.items():
        if layout.unit(name) is None:
            raise TraceError(f"{path}: columns: {name!r} is unknown.{layout.hint(name)} Known are {layout.words}")
        if not isinstance(told, str) or not told.strip(" -"):
            raise TraceError(f'{path}: columns: {name} = {told!r} given; it must be the name of a column, such as "-Fz [N]"')
        if channels is not None and name in layout.channels and name not in channels:
            continue
        wanted, unit = split_label(told.strip().removeprefix("-"))
        index = _position(path, raw, name, wanted)
        found.append(_column(path, raw, layout, index, name, unit, -1 if told.strip().startswith("-") else 1))
    for name in layout.any_case:
        if name not in columns and any(layout.known(column.last) == name for column in raw.columns):
            written = next(column.last for column in raw.columns if layout.known(column.last) == name)
            found.insert(0, _column(path, raw, layout, _position(path, raw, name, written), name))
    return tuple(found)


def _position(path: Path, raw: Raw, name: str, wanted: str) -> int:
    """Of the column that the file calls `wanted`, with or without the levels above it."""
    for names in ([column.name for column in raw.columns], [column.last for column in raw.columns]):
        if names.count(wanted) == 1:
            return names.index(wanted)
        if wanted in names:
            same = [column.label for column in raw.columns if wanted in (column.name, column.last)]
            what = "keep one" if raw.text else f'say which: columns = {{ {name} = "..." }}, with the levels above it'
            raise TraceError(f'{path}: "{shown(wanted)}" is there more than once, as {listed(same)}; {what}')
    near = _hint(wanted, [column.name for column in raw.columns])
    raise TraceError(f'{path}: columns: no column "{shown(wanted)}" for {name}.{near} The columns are {raw.names}')


def _column(path: Path, raw: Raw, layout: Layout, index: int, name: str, told: str | None = None, sign: int = 1) -> Column:
    """A column, with its unit and the one told checked against what is measured."""
    column, si = raw.columns[index], layout.unit(name)
    assert si
    where = f"{path}: {column.label}"
    unit = column.unit or told
    if unit is None:
        raise TraceError(f"{where} has no unit; write {name} [{si}]{_instead(raw, name, column, f' [{si}]')}")
    scale = _scale(where, unit, name, si)
    if told is not None and not np.isclose(_scale(f"{path}: columns", told, name, si), scale, rtol=1e-12, atol=0):
        raise TraceError(f"{where}: columns says {name} is in {told}, the file {shown(unit)}; leave the unit out")
    return Column(index, name, unit, sign * scale)


def _scale(where: str, unit: str, name: str, si: str) -> float:
    try:
        return parse(where, f"1 {unit}", si)
    except UnitError:
        raise TraceError(f"{where}: the unit {shown(unit)} is not one of {name}; use [{si}] or a multiple of it") from None


def _instead(raw: Raw, name: str, column: RawColumn, unit: str = "") -> str:
    """What to do about a column in a file that cannot be edited."""
    return "" if raw.text else f', or say it: columns = {{ {name} = "{shown(column.name)}{unit}" }}'


def _hint(name: str, known: Iterable[str]) -> str:
    near = difflib.get_close_matches(name, list(known), n=1)
    return f" Did you mean {near[0]}?" if near else ""
