"""The synchronous average of a trace: what of it repeats with every turn of the spindle.

A model of a steady cut is periodic in one turn. Of a long trace it can explain only the part that is, and that part is one
turn long: a fit of it costs a fraction of that of the whole trace, and has the same optimum. What is left no such model
explains, and it bounds the R² of all of them.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import fminbound

from millax import Case

from ._align import speed_error
from ._measured import TraceError
from ._traces import Trace


@dataclass(frozen=True)
class SynchronousAverage:
    """What repeats in a trace.

    - `trace`: the average over all turns, repeated for some turns, by the clock of a spindle that turns exactly at its
      speed.
    - `speed_error`: true over commanded spindle speed, less 1 [-].
    - `r2`: of the average, per channel: the most that a model periodic in one turn can reach.
    - `rest`: root mean square of what does not repeat, per channel [N], [m].
    """

    trace: Trace
    speed_error: float
    r2: Mapping[str, float]
    rest: Mapping[str, float]


def synchronous_average(case: Case, trace: Trace, turns: int = 3) -> SynchronousAverage:
    """The part of a trace of steady cutting that repeats with every turn of the spindle, least squares in

        y(t) = sum_h Re(Y_h exp(i h W (1 + e) t)),   h = 0, 1, ... below half the sampling rate,

    over the lines Y_h and the error e of the speed W, looked for up to 0.5 %.

    **Arguments:**

    - `case`: its spindle speed and tool count.
    - `trace`: of at least ten turns, so that the average is one.
    - `turns`: length of the trace that is returned.

    Raises `TraceError` for a shorter trace.
    """
    speed = float(case.cut.spindle_speed)
    length = len(trace.time) * trace.step * speed / (2 * np.pi)
    if length < 10:
        raise TraceError(f"{trace.name}: {length:.3g} turns of the spindle long; an average needs 10 at least")
    time = trace.time - trace.time[0]
    lines = np.arange(1, int(np.ceil(np.pi / (speed * trace.step) - 1e-6)))
    coarse = speed_error(time, trace.values, speed, lines[: 4 * case.tool.teeth])
    width = 0.5 / (lines[-1] * length)

    def left(e):
        return np.sum((trace.values - _fitted(time, trace.values, speed * (1 + e), lines)[1]) ** 2 / size)

    size = trace.values.var(axis=0)
    error = np.asarray(fminbound(left, coarse - width, coarse + width, xtol=1e-3 * width)).item()
    amplitudes, fitted = _fitted(time, trace.values, speed * (1 + error), lines)
    rest = np.mean((trace.values - fitted) ** 2, axis=0)
    again = np.arange(round(turns * 2 * np.pi / (speed * trace.step))) * trace.step
    average = replace(trace, time=trace.time[0] + again, values=_waves(again, speed, lines) @ amplitudes)
    return SynchronousAverage(
        average,
        error,
        {channel: float(1 - r / s) for channel, r, s in zip(trace.channels, rest, size, strict=True)},
        {channel: float(np.sqrt(r)) for channel, r in zip(trace.channels, rest, strict=True)},
    )


def _waves(time: np.ndarray, speed: float, lines: np.ndarray) -> np.ndarray:
    """One, and cosine and sine of every line, shape (samples, 1 + 2 lines)."""
    angle = speed * np.outer(time, lines)
    return np.hstack([np.ones((len(time), 1)), np.cos(angle), np.sin(angle)])


def _fitted(time: np.ndarray, values: np.ndarray, speed: float, lines: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Amplitudes of the waves that are nearest to the values, and their sum."""
    waves = _waves(time, speed, lines)
    amplitudes = np.linalg.solve(waves.T @ waves, waves.T @ values)
    return amplitudes, waves @ amplitudes
