"""Even times: checking them, stating them, making them."""

from collections.abc import Callable, Mapping

import numpy as np

from millax._units import parse

from ._formats._raw import EvenTimes
from ._measured import TraceError

UNEVEN = 0.05
"""Largest deviation of a time stamp from an even grid, in sampling steps: more than rounding makes of it, less than a
lost sample does."""

BRIDGED = 4.5
"""Longest step that is interpolated over, in median steps: three lost samples, and jitter. Over more, a tooth may have
come and gone."""


def even_grid(name: str, time: np.ndarray, place: Callable[[int], str]) -> np.ndarray:
    """The even grid through the time stamps [s]. Raises `TraceError` where they are not even, with the `place`."""
    steps = _steps(name, time, place)
    grid = _line(time)
    if not _even(time, grid):
        usual = np.median(steps)
        i = int(np.argmax(np.abs(steps - usual))) + 1
        raise TraceError(
            f"{name}: {place(i)}, column time: a step of {steps[i - 1]:.6g} s where {usual:.6g} s is usual. The time "
            "must be even: resample the trace (resample = true, where no more than a few samples are lost), or choose a "
            "window without the gap"
        )
    return grid


def resampled(name: str, time: np.ndarray, values: np.ndarray, place: Callable[[int], str]) -> tuple[np.ndarray, np.ndarray]:
    """Times [s] and values, shape (samples, channels), on the even grid of the median step, interpolated linearly; as they
    are where they are even. Raises `TraceError` where a step is longer than `BRIDGED` median steps."""
    steps = _steps(name, time, place)
    if _even(time, _line(time)):
        return time, values
    usual = float(np.median(steps))
    i = int(np.argmax(steps)) + 1
    if steps[i - 1] > BRIDGED * usual:
        raise TraceError(
            f"{name}: {place(i)}, column time: a step of {steps[i - 1]:.6g} s where {usual:.6g} s is usual. "
            "Interpolated is over three lost samples at most: choose a window without the gap"
        )
    # The last sample is reached also where the division rounds down.
    grid = time[0] + usual * np.arange(int((time[-1] - time[0]) / usual * (1 + 1e-9)) + 1)
    return grid, np.stack([np.interp(grid, time, channel) for channel in values.T], axis=1)


def stated_times(name: str, clocks: Mapping[str, EvenTimes | None], rate: float | str | None, count: int) -> np.ndarray:
    """Times [s] of a file without a column of them, from what it states for its columns or from the sampling `rate`.
    Raises `TraceError` where there is neither, or both, or columns differ."""
    (first, clock), *others = clocks.items()
    for other, its in others:
        if its != clock:
            raise TraceError(
                f"{name}: the times of column {other} are not those of {first}: the file states {its or 'none'}, "
                f"and {clock or 'none'}; take columns of one recording"
            )
    if clock is None and rate is None:
        raise TraceError(
            f'{name}: no column time; add it, or say which it is: columns = {{ time = "t [s]" }}, or rate = ...'
        )
    if clock is not None and rate is not None:
        raise TraceError(f"{name}: rate = {rate!r} given, but the file states a step of {clock.step:g} s; leave rate out")
    if rate is not None:
        frequency = float(parse(f"{name}: rate", rate, "Hz"))
        if not frequency > 0:
            raise TraceError(f"{name}: rate = {rate!r} given; it must be greater than 0")
        clock = EvenTimes(0.0, 1 / frequency)
    assert clock
    if not (np.isfinite([clock.start, clock.step]).all() and clock.step > 0):
        raise TraceError(f"{name}: the file states a start of {clock.start:g} s and a step of {clock.step:g} s")
    return clock.start + clock.step * np.arange(count)


def _steps(name: str, time: np.ndarray, place: Callable[[int], str]) -> np.ndarray:
    """Raises `TraceError` where they do not go up."""
    if len(time) < 2:
        raise TraceError(f"{name}: {len(time)} samples; a trace needs many more")
    steps = np.diff(time)
    if not (steps > 0).all():
        i = int(np.argmax(steps <= 0)) + 1
        raise TraceError(
            f"{name}: {place(i)}, column time: {time[i]:.9g} s follows {time[i - 1]:.9g} s; sort the samples, and "
            "remove repeated ones"
        )
    return steps


def _line(time: np.ndarray) -> np.ndarray:
    index = np.arange(len(time))
    slope, start = np.polyfit(index, time, 1)
    return start + slope * index


def _even(time: np.ndarray, grid: np.ndarray) -> bool:
    return bool((np.abs(time - grid) <= UNEVEN * (grid[1] - grid[0])).all())
