"""Measured traces: reading a CSV file, and every check that can be made before a model is asked.

A file has one header row, each column with its unit: `time [s],Fx [N],Fy [N],x [m]`. Times count from the start of the
simulation, forces act on the tool, displacements are deviations of the tool centre from its commanded path: the format
in which `millax simulate` writes traces.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import ClassVar

import numpy as np

from millax._units import parse

from ._measured import Measured, TraceError, check_finite
from ._table import Layout, read_table

CHANNELS = {"Fx": "N", "Fy": "N", "Fz": "N", "x": "m", "y": "m", "z": "m"}
"""Every channel that can be compared with the model, and its SI unit."""

LAYOUT = Layout("trace", "time [s],Fx [N],Fy [N],x [mm]", CHANNELS, {"time": "s"}, required=("time",))
"""The columns of a file."""

REPAIR = "Repair the samples, or choose a window without them"

UNEVEN = 0.05
"""Largest deviation of a time stamp from an even grid, in sampling steps: more than rounding makes of it, less than a
lost sample does."""


@dataclass(frozen=True)
class Trace(Measured):
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

    CHANNELS: ClassVar[Mapping[str, str]] = CHANNELS

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
        self.check_channels()
        check_finite(self.name, np.column_stack([time, values]), ("time", *self.channels), _sample, REPAIR)
        # The rounding of single time stamps is not part of the measurement: the even grid through them is.
        object.__setattr__(self, "time", _even_grid(self.name, time, _sample))
        object.__setattr__(self, "values", values)
        object.__setattr__(self, "channels", tuple(self.channels))
        self.check_not_zero()

    @property
    def step(self) -> float:
        """Sampling step [s]."""
        return float(self.time[-1] - self.time[0]) / (len(self.time) - 1)


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
    table = read_table(path, LAYOUT, channels)
    if window is not None:
        table = table.part(_inside(path, table.of("time")[:, 0], window))
    table.check_finite(REPAIR)
    time, values = table.of("time")[:, 0], table.of(*table.channels)
    _even_grid(str(path), time, table.place)
    return Trace(time, table.channels, values, table.noise(noise), table.units, path.name)


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


def _sample(i: int) -> str:
    return f"sample {i}"


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
