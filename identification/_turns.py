"""Mean forces over whole turns of the spindle, and how certain they are."""

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from millax import Case

from ._compare import resolves_teeth
from ._measured import TraceError
from ._running import NOISE_FLOOR
from ._steady import Steady
from ._traces import Trace

FORCES = ("Fx", "Fy", "Fz")

FEWEST_TURNS = 5
"""Fewest turns whose means tell how much they scatter."""

ROUNDING = 1e-6
"""What the last turn may lack [turns]: time stamps are rounded."""


@dataclass(frozen=True)
class TurnMeans:
    """Means over whole turns: how many, of which force channels, and per channel the mean and its standard error [N]."""

    turns: int
    channels: tuple[str, ...]
    mean: Float[np.ndarray, " channels"]
    std: Float[np.ndarray, " channels"]


def turn_means(trace: Trace, case: Case, within: Steady) -> TurnMeans:
    """Mean forces over the whole turns in the steady part of a trace.

    Of n turns whose means have the standard deviation s, and the correlation r from one turn to the next, the standard error
    is s/sqrt(n) sqrt((1 + r)/(1 - r)): as if the correlation fell like r^k over k turns. A negative r counts as 0.

    Raises `TraceError` for a trace without a force, with fewer than `FEWEST_TURNS` turns in steady cutting, or with
    samples that do not resolve the teeth.
    """
    channels = tuple(channel for channel in FORCES if channel in trace.channels)
    if not channels:
        raise TraceError(f"{trace.name}: no force among its channels, {', '.join(trace.channels)}; give some of Fx, Fy, Fz")
    resolves_teeth(trace, float(case.cut.tooth_period(case.tool)))
    turn = 2 * math.pi / float(case.cut.spindle_speed)
    first = trace.time[0] if case.clock is None else float(case.clock.start)
    # A sample stands for the step around it, so that a turn need not be a whole number of samples.
    ends = first + (np.arange(trace.samples + 1) - 0.5) * trace.step
    begin, end = max(ends[0], within.begin), min(ends[-1], within.end)
    length = max((end - begin) / turn, 0.0)
    turns = math.floor(length + ROUNDING)
    if turns < FEWEST_TURNS:
        raise TraceError(
            f"{trace.name}: {length:.3g} turns of the spindle ({turn:.4g} s each) in steady cutting; at least "
            f"{FEWEST_TURNS} are needed. The trace reaches from {ends[0]:.4g} s to {ends[-1]:.4g} s, steady "
            f"cutting from {within.begin:.4g} s to {within.end:.4g} s. Give a longer trace, or "
            "the right time, spindle speed and stock"
        )
    values = trace.values[:, [trace.channels.index(channel) for channel in channels]]
    impulse = np.vstack([np.zeros(len(channels)), np.cumsum(values, axis=0)]) * trace.step
    at = begin + turn * np.arange(turns + 1)
    means = np.stack([np.diff(np.interp(at, ends, column)) for column in impulse.T], axis=1) / turn
    apart = means - means.mean(axis=0)
    floor = NOISE_FLOOR * np.sqrt((values**2).mean(axis=0))
    power = np.maximum((apart**2).sum(axis=0), turns * (turns - 1) * floor**2)
    r = np.maximum((apart[1:] * apart[:-1]).sum(axis=0) / power, 0.0)
    return TurnMeans(turns, channels, means.mean(axis=0), np.sqrt(power / (turns * (turns - 1)) * (1 + r) / (1 - r)))
