"""Measurements in CSV files: one header row, each column with its unit, as `time [s],Fx [N],x [um]`."""

import csv
import difflib
import io
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from millax._units import UnitError, parse

from ._measured import TraceError, check_finite, known_channel


@dataclass(frozen=True)
class Layout:
    """What the columns of a kind of file may be.

    - `kind`: of file, for messages.
    - `example`: of its first row.
    - `channels`: what is measured, with SI units. Only these may be left out by saying which channels to use.
    - `others`: what else a file may hold, with SI units.
    - `numbered`: columns that come as name1, name2 and so on, by the name without the number, with SI units.
    - `required`: those of the others that must be there.
    """

    kind: str
    example: str
    channels: Mapping[str, str]
    others: Mapping[str, str]
    numbered: Mapping[str, str] = field(default_factory=dict)
    required: tuple[str, ...] = ()

    def unit(self, name: str) -> str | None:
        """The SI unit of a column; None for one that is unknown."""
        series = re.fullmatch(r"(\D+)[1-9]\d*", name)
        if series and series[1] in self.numbered:
            return self.numbered[series[1]]
        return self.others.get(name) or self.channels.get(name)

    @property
    def words(self) -> str:
        """Every column, in words."""
        return ", ".join([*(f"{name}1, {name}2 and so on" for name in self.numbered), *self.others, *self.channels])


@dataclass(frozen=True)
class Column:
    """Where a column stands in its file, and its unit as it is written, in SI `scale`."""

    index: int
    name: str
    unit: str
    scale: float


@dataclass(frozen=True)
class Table:
    """The columns of a file that are used.

    - `columns`: in the order of the file.
    - `numbers`: SI, shape (rows, columns), NaN where a cell is no number.
    - `lines`: of the file, in which the rows stand, from 1.
    """

    path: Path
    layout: Layout
    columns: tuple[Column, ...]
    numbers: np.ndarray
    lines: np.ndarray

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
        return Table(self.path, self.layout, self.columns, self.numbers[rows], self.lines[rows])

    def place(self, row: int) -> str:
        """Where a row stands in the file."""
        return f"row {self.lines[row]}"

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


def read_table(path: Path, layout: Layout, channels: Sequence[str] | None) -> Table:
    """Read a CSV file: commas between the columns, points in the numbers; of the channels those named, None: all.

    Raises `TraceError`, which names the file and the row or column.
    """
    rows = _rows(path, layout)
    columns = _header(path, layout, rows[0] if rows else [], channels)
    return Table(path, layout, columns, *_numbers(path, rows, columns))


def _rows(path: Path, layout: Layout) -> list[list[str]]:
    try:
        text = path.read_text(encoding="utf-8-sig")
    except OSError as error:
        raise TraceError(f"{path}: the {layout.kind} cannot be read: {error.strerror}") from None
    except UnicodeDecodeError:
        raise TraceError(f"{path}: not a text file in UTF-8; a {layout.kind} is a CSV file") from None
    try:
        return list(csv.reader(io.StringIO(text)))
    except csv.Error as error:
        raise TraceError(f"{path}: not a CSV file: {error}") from None


def _header(path: Path, layout: Layout, header: list[str], channels: Sequence[str] | None) -> tuple[Column, ...]:
    """The channels asked for and what else is known, with their units checked."""
    example = f"such as {layout.example}"
    if not header:
        raise TraceError(f"{path}: the file is empty; its first row names the columns, {example}")
    if len(header) == 1 and ";" in header[0]:
        raise TraceError(f"{path}: semicolons between the columns; use commas, and points in the numbers")
    for channel in channels or ():
        known_channel(channel, layout.channels, f"{path}: channels")
    found: dict[str, Column] = {}
    for index, cell in enumerate(header):
        match = re.fullmatch(r"\s*([^\[\]]*?)\s*(?:\[\s*([^\[\]]*?)\s*\])?\s*", cell)
        name, unit = (match[1], match[2]) if match else (cell, None)
        si = layout.unit(name)
        if channels is not None and name not in channels and (si is None or name in layout.channels):
            continue
        where = f'{path}: column {index + 1} "{cell}"'
        if si is None:
            near = difflib.get_close_matches(name, [*layout.others, *layout.channels], n=1)
            hint = f" Did you mean {near[0]}?" if near else ""
            raise TraceError(
                f"{where} is not a channel.{hint} The first row names the columns, {example}; known are {layout.words}. "
                "To leave out others, say which to use: channels = [...]"
            )
        if not unit:
            raise TraceError(f"{where} has no unit; write {name} [{si}]")
        try:
            scale = parse(where, f"1 {unit}", si)
        except UnitError:
            raise TraceError(f"{where}: the unit {unit} is not one of {name}; use [{si}] or a multiple of it") from None
        if name in found:
            raise TraceError(f"{where} is there twice, first as column {found[name].index + 1}; keep one")
        found[name] = Column(index, name, unit, scale)
    missing = [name for name in (*layout.required, *(channels or ())) if name not in found]
    if missing:
        raise TraceError(f"{path}: no column {missing[0]}; the columns are {', '.join(header)}")
    if not found.keys() & layout.channels.keys():
        beside = f" beside {', '.join(found)}" if found else ""
        raise TraceError(f"{path}: there is no channel{beside}; known are {', '.join(layout.channels)}")
    return tuple(found.values())


def _numbers(path: Path, rows: list[list[str]], columns: Sequence[Column]) -> tuple[np.ndarray, np.ndarray]:
    """The columns in SI, shape (rows, columns), NaN where a cell is no number; and the line of each row in the file."""
    width = len(rows[0])
    lines = [number for number, row in enumerate(rows, start=1) if number > 1 and any(cell.strip() for cell in row)]
    for number in lines:
        if len(rows[number - 1]) != width:
            found = len(rows[number - 1])
            raise TraceError(f"{path}: row {number} has {found} cells, the header has {width}; is the file cut short?")
    table = np.array([[_number(rows[number - 1][column.index]) for column in columns] for number in lines])
    return table.reshape(-1, len(columns)) * [column.scale for column in columns], np.array(lines, dtype=int)


def _number(cell: str) -> float:
    try:
        return float(cell)
    except ValueError:
        return np.nan
