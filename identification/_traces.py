"""Measured traces: reading a CSV file, and every check that can be made before a model is asked.

A file has one header row, each column with its unit: `time [s],Fx [N],Fy [N],x [m]`. Times count from the start of the
simulation, forces act on the tool, displacements are deviations of the tool centre from its commanded path: the format
in which `millax simulate` writes traces.
"""

import csv
import difflib
import io
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from millax._units import UnitError, parse, si_scale

CHANNELS = {"Fx": "N", "Fy": "N", "Fz": "N", "x": "m", "y": "m", "z": "m"}
"""Every channel that can be compared with the model, and its SI unit."""

UNEVEN = 0.05
"""Largest deviation of a time stamp from an even grid, in sampling steps: more than rounding makes of it, less than a
lost sample does."""


class TraceError(ValueError):
    """A trace that cannot be used; the message names file, row and column, and what to do."""


@dataclass(frozen=True)
class Trace:
    """Channels sampled at even times.

    **Arguments:**

    - `time`: t [s] from the start of the simulation, shape (samples,): sorted and even.
    - `channels`: what the columns of `values` are: of Fx, Fy, Fz [N], x, y, z [m].
    - `values`: SI, shape (samples, channels).
    - `noise`: standard deviation of the noise of a channel in SI, where it is known.
    - `units`: in which a channel is shown; SI where it is not named.
    - `name`: for messages and reports.

    Raises `TraceError` for values that are not finite, times that are unsorted or uneven, fewer than 2 samples, unknown
    or repeated channels, a channel that is zero throughout, and noise that is not positive.
    """

    time: np.ndarray
    channels: tuple[str, ...]
    values: np.ndarray
    noise: Mapping[str, float] = field(default_factory=dict)
    units: Mapping[str, str] = field(default_factory=dict)
    name: str = "trace"

    def __post_init__(self):
        time, values = np.asarray(self.time, dtype=float), np.asarray(self.values, dtype=float)
        if time.ndim != 1 or values.shape != (len(time), len(self.channels)) or not self.channels:
            raise TraceError(
                f"{self.name}: time of shape {time.shape} and values of shape {values.shape} given; they must be "
                f"(samples,) and (samples, {len(self.channels)}), with at least one channel"
            )
        for channel in self.channels:
            _known(channel, f"{self.name}: channel")
            if self.channels.count(channel) > 1:
                raise TraceError(f"{self.name}: channel {channel} given twice")
        for channel, sigma in self.noise.items():
            if channel not in self.channels:
                raise TraceError(f"{self.name}: noise of {channel} given, but the channels are {', '.join(self.channels)}")
            if not (np.isfinite(sigma) and sigma > 0):
                raise TraceError(
                    f"{self.name}: noise of {channel}: {sigma:g} given; it must be greater than 0. "
                    "Leave it out to have it estimated"
                )
        _check_finite(self.name, time, values, self.channels, _sample)
        # The rounding of single time stamps is not part of the measurement: the even grid through them is.
        object.__setattr__(self, "time", _even_grid(self.name, time, _sample))
        object.__setattr__(self, "values", values)
        object.__setattr__(self, "channels", tuple(self.channels))
        for channel, column in zip(self.channels, values.T, strict=True):
            if not column.any():
                raise TraceError(
                    f"{self.name}: channel {channel} is zero throughout: nothing was measured, or it is in another "
                    "column. Leave it out of the channels"
                )

    @property
    def step(self) -> float:
        """Sampling step [s]."""
        return float(self.time[-1] - self.time[0]) / (len(self.time) - 1)

    def unit(self, channel: str) -> str:
        """The unit in which a channel is shown."""
        return self.units.get(channel, CHANNELS[channel])

    def shown(self, channel: str, value):
        """SI values of a channel in the unit in which it is shown."""
        return value / si_scale(self.unit(channel))


def read_trace(
    path: str | Path,
    *,
    channels: Sequence[str] | None = None,
    noise: Mapping[str, float | str] | None = None,
    window: Sequence[float | str] | None = None,
) -> Trace:
    """Read a CSV file.

    **Arguments:**

    - `path`: the file. Commas between the columns, points in the numbers.
    - `channels`: the columns to use. None: all, which must then all be channels.
    - `noise`: standard deviation of the noise per channel ("2 N"), where it is known.
    - `window`: (start, end) of the part to use ("0.1 s").

    Raises `TraceError`, which names the file and the row or column.
    """
    path = Path(path)
    rows = _rows(path)
    columns = _header(path, rows[0] if rows else [], channels)
    table, lines = _numbers(path, rows, columns)
    if window is not None:
        inside = _inside(path, table[:, 0], window)
        table, lines = table[inside], lines[inside]
    names = tuple(column.name for column in columns[1:])

    def row(i: int) -> str:
        return f"row {lines[i]}"

    _check_finite(str(path), table[:, 0], table[:, 1:], names, row)
    _even_grid(str(path), table[:, 0], row)
    sigma = {}
    for channel, value in (noise or {}).items():
        unit = CHANNELS[_known(channel, f"{path}: noise")]
        sigma[channel] = float(parse(f"{path}: noise of {channel}", value, unit))
    units = {column.name: column.unit for column in columns[1:]}
    return Trace(table[:, 0], names, table[:, 1:], sigma, units, path.name)


@dataclass(frozen=True)
class _Column:
    index: int
    name: str
    unit: str
    scale: float


def _rows(path: Path) -> list[list[str]]:
    try:
        text = path.read_text(encoding="utf-8-sig")
    except OSError as error:
        raise TraceError(f"{path}: the trace cannot be read: {error.strerror}") from None
    except UnicodeDecodeError:
        raise TraceError(f"{path}: not a text file in UTF-8; a trace is a CSV file") from None
    try:
        return list(csv.reader(io.StringIO(text)))
    except csv.Error as error:
        raise TraceError(f"{path}: not a CSV file: {error}") from None


def _header(path: Path, header: list[str], channels: Sequence[str] | None) -> list[_Column]:
    """Time and the channels asked for, with their units checked."""
    example = "such as time [s],Fx [N],Fy [N],x [mm]"
    if not header:
        raise TraceError(f"{path}: the file is empty; its first row names the columns, {example}")
    if len(header) == 1 and ";" in header[0]:
        raise TraceError(f"{path}: semicolons between the columns; use commas, and points in the numbers")
    if channels is not None:
        for channel in channels:
            _known(channel, f"{path}: channels")
    found: dict[str, _Column] = {}
    for index, cell in enumerate(header):
        match = re.fullmatch(r"\s*([^\[\]]*?)\s*(?:\[\s*([^\[\]]*?)\s*\])?\s*", cell)
        name, unit = (match[1], match[2]) if match else (cell, None)
        if channels is not None and name not in ("time", *channels):
            continue
        where = f'{path}: column {index + 1} "{cell}"'
        if name != "time" and name not in CHANNELS:
            near = difflib.get_close_matches(name, ["time", *CHANNELS], n=1)
            hint = f" Did you mean {near[0]}?" if near else ""
            raise TraceError(
                f"{where} is not a channel.{hint} The first row names the columns, {example}; known are time, "
                f"{', '.join(CHANNELS)}. To leave out others, say which to use: channels = [...]"
            )
        si = CHANNELS.get(name, "s")
        if not unit:
            raise TraceError(f"{where} has no unit; write {name} [{si}]")
        try:
            scale = parse(where, f"1 {unit}", si)
        except UnitError:
            raise TraceError(f"{where}: the unit {unit} is not one of {name}; use [{si}] or a multiple of it") from None
        if name in found:
            raise TraceError(f"{where} is there twice, first as column {found[name].index + 1}; keep one")
        found[name] = _Column(index, name, unit, scale)
    missing = [name for name in ("time", *(channels or ())) if name not in found]
    if missing:
        raise TraceError(f"{path}: no column {missing[0]}; the columns are {', '.join(header)}")
    columns = [found.pop("time"), *found.values()]
    if len(columns) == 1:
        raise TraceError(f"{path}: there is no channel beside the time; known are {', '.join(CHANNELS)}")
    return columns


def _numbers(path: Path, rows: list[list[str]], columns: list[_Column]) -> tuple[np.ndarray, np.ndarray]:
    """The columns in SI, shape (samples, columns), NaN where a cell is no number; and each sample's row in the file."""
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


def _inside(path: Path, time: np.ndarray, window: Sequence[float | str]) -> np.ndarray:
    """Which samples lie within the window."""
    ends = parse(f"{path}: window", list(window), "s")
    if len(ends) != 2 or not ends[0] < ends[1]:
        raise TraceError(f"{path}: window {list(window)} given; it must be two times, the first the smaller")
    inside = (time >= ends[0]) & (time <= ends[1])
    if not inside.any():
        reach = f"{np.nanmin(time):g} s to {np.nanmax(time):g} s" if np.isfinite(time).any() else "nowhere"
        raise TraceError(f"{path}: no sample lies in the window {list(window)}; the trace reaches from {reach}")
    return inside


def _known(channel: str, where: str) -> str:
    if channel not in CHANNELS:
        raise TraceError(f"{where} {channel!r} is unknown; known are {', '.join(CHANNELS)}")
    return channel


def _sample(i: int) -> str:
    return f"sample {i}"


def _check_finite(name: str, time, values, channels: tuple[str, ...], place: Callable[[int], str]) -> None:
    table = np.column_stack([time, values])
    if not np.isfinite(table).all():
        i, column = np.argwhere(~np.isfinite(table))[0]
        raise TraceError(
            f"{name}: {place(i)}, column {('time', *channels)[column]}: not a finite number. Repair the samples, or "
            "choose a window without them"
        )


def _even_grid(name: str, time: np.ndarray, place: Callable[[int], str]) -> np.ndarray:
    """The even grid through the time stamps."""
    if len(time) < 2:
        raise TraceError(f"{name}: {len(time)} samples; a trace needs many more")
    steps = np.diff(time)
    if not (steps > 0).all():
        i = int(np.argmax(steps <= 0)) + 1
        raise TraceError(
            f"{name}: {place(i)}, column time: {time[i]:.9g} s follows {time[i - 1]:.9g} s; sort the samples, and "
            "remove repeated ones"
        )
    index = np.arange(len(time))
    slope, start = np.polyfit(index, time, 1)
    grid = start + slope * index
    if (np.abs(time - grid) > UNEVEN * slope).any():
        usual = np.median(steps)
        i = int(np.argmax(np.abs(steps - usual))) + 1
        raise TraceError(
            f"{name}: {place(i)}, column time: a step of {steps[i - 1]:.6g} s where {usual:.6g} s is usual. The time "
            "must be even: resample the trace, or choose a window without the gap"
        )
    return grid
