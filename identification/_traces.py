"""Measured traces: reading a file, and every check that can be made before a model is asked.

Times count from the start of the simulation, forces act on the tool, displacements are deviations of the tool centre from
its commanded path. `millax simulate` writes traces as CSV, each column with its unit: `time [s],Fx [N],Fy [N],x [m]`.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import ClassVar

import numpy as np

from millax._units import parse

from ._measured import Measured, TraceError, check_finite
from ._sampling import even_grid, resampled, stated_times
from ._table import Layout, read_table

CHANNELS = {"Fx": "N", "Fy": "N", "Fz": "N", "x": "m", "y": "m", "z": "m"}
"""Every channel that can be compared with the model, and its SI unit."""

LAYOUT = Layout("trace", "time [s],Fx [N],Fy [N],x [mm]", CHANNELS, {"time": "s"}, any_case=("time",))
"""The columns of a file."""

REPAIR = "Repair the samples, or choose a window without them"


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
        object.__setattr__(self, "time", even_grid(self.name, time, _sample))
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
    format: str | None = None,
    columns: Mapping[str, str] | None = None,
    channels: Sequence[str] | None = None,
    noise: Mapping[str, float | str] | None = None,
    window: Sequence[float | str] | None = None,
    rate: float | str | None = None,
    resample: bool = False,
) -> Trace:
    """Read a file.

    In a file with levels (structures of MAT, groups of HDF5 and TDMS) a column is a path, "cut1/forces/Fx", of which the
    last part will do where it is there once. Of an array with several channels a column is "forces[0]", "forces[1]" and so
    on: samples run along its longer axis.

    **Arguments:**

    - `path`: the file.
    - `format`: "csv", "dynoware", "mat", "tdms" or "hdf5". None: found from the content and the extension.
    - `columns`: what the file calls a channel or the time, with a sign and a unit where the file has none:
      `{"time": "Time", "Fx": "-Fz", "x": "laser [um]"}`. Only these are used, and a column time, which need not be named.
      None: columns have the names of the channels.
    - `channels`: the channels to use. None: all, which without `columns` means that every column must be one.
    - `noise`: standard deviation of the noise per channel ("2 N"), where it is known.
    - `window`: (start, end) of the part to use ("0.1 s").
    - `rate`: of sampling ("10 kHz"), for a file without times: they then begin at 0.
    - `resample`: whether uneven times are made even, by linear interpolation at the median step, where no more than three
      samples in a row are lost.

    Raises `TraceError`, which names the file and the row or column; `ValueError` for `noise`, `window` and `rate` that are
    no quantities of their kind.
    """
    path = Path(path)
    table = read_table(path, LAYOUT, channels, columns=columns, format=format)
    if "time" not in table.names:
        time = stated_times(str(path), table.clocks, rate, len(table.lines))
    elif rate is None:
        time = table.of("time")[:, 0]
    else:
        raise TraceError(f"{path}: rate = {rate!r} given, but the file has a column of times; leave rate out")
    if window is not None:
        inside = _inside(path, time, window)
        table, time = table.part(inside), time[inside]
    table.check_finite(REPAIR)
    values = table.of(*table.channels)
    if resample:
        time, values = resampled(str(path), time, values, table.place)
    else:
        even_grid(str(path), time, table.place)
    trace = Trace(time, table.channels, values, table.noise(noise), table.units, str(path))
    return replace(trace, name=path.name)  # the path is for messages


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
