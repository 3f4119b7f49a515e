"""What may be wrong with a measured trace that can be read: saturation, drop-outs, drift and offset.

Everything here is judged from a channel alone, without a model, and so that a good measurement gives no finding: better to
miss a small fault than to report one that is none. Nothing is refused.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from ._traces import Trace

FLAT = 3
"""Fewest samples that an extreme value is held for: two equal ones are a peak between two samples."""

REPEATED = 3
"""Fewest times that it is held, with less in between: one peak that is cut off may be a shock."""

DIP = 0.05
"""What is less, in parts of the range."""

TOP = 3.5
"""What belongs to an extreme value, in steps of quantisation: the noise of a converter is one or two."""

PILED = 5.0
"""How many times more samples lie within `TOP` of an extreme than in the next two such steps. At round peaks there are 1.4
times as many, as the time says that a parabola stays near its top."""

FINE = 40.0
"""Fewest steps of quantisation in the range of a channel, for the above to be told apart."""

HELD = 10
"""Fewest equal samples in a row that are a drop-out: an instrument repeats a few by chance or by its own filter."""

OUTSTANDING = 10.0
"""How many times longer than a value is held on average: a coarsely quantised signal repeats values throughout."""

MANY = 30
"""How many holds belong to the signal, such as those of chatter, in which the tool leaves the workpiece: one that is a
drop-out is twice as long."""

MOVING = 10.0
"""How far the signal goes away from the value in the `HELD` samples before and in those after, in steps of quantisation:
where it hardly moves, in the air or at a round peak of a slow signal, these steps make it flat."""

REGULAR = 0.4
"""Largest scatter of the intervals between holds, in parts of their mean, where they belong to the signal: teeth out of
contact in a simulation without noise, unequal pitch and runout included. Intervals of chance scatter by 1."""

BLOCKS = 20
"""Parts of a trace whose averages are compared: enough for an error of their trend, and each of several teeth."""

SHORTEST = 8
"""Fewest samples in a block."""

STEADY = 0.15
"""Largest deviation of the standard deviation in a block from the usual one, in parts of it, where the cut is taken as the
same."""

COMMON = 0.5
"""How much of the trend of the mean the highest and the lowest values must have at least: drift moves all alike, while the
teeth of a tool that enters the workpiece move only one end."""

ENDS = (5, 95)
"""Percentiles that are the lowest and the highest values."""

SIGNIFICANT = 5.0
"""Of how many standard errors a trend or an offset must be: a report on six channels of many traces is right then."""

RELEVANT = 0.02
"""What of a trend or an offset matters, in parts of the range of the channel; less moves coefficients less than runout does,
and blocks that cut tooth periods make up to half of it."""

QUIET = 0.1
"""Largest standard deviation in a block before the cut begins, in parts of the largest; then it goes above half of that
within two blocks."""

ALIKE = 0.5
"""Largest correlation of a sample with the next before the cut begins: noise has less, a stable cut before chatter more."""

SMALL = 0.2
"""Largest offset, in parts of the range: more is a steady cut without vibration, or a limit."""


@dataclass(frozen=True)
class Finding:
    """Something in a channel that a fit should not be given as it is.

    - `kind`: "saturated", "drop-out", "drift" or "offset".
    - `channel`: where it is, from `start` to `end` [s].
    - `value`: SI; the limit, the value that is held, the rise from start to end, or the offset.
    - `words`: what was found and what to do, for a person.
    """

    kind: str
    channel: str
    start: float
    end: float
    value: float
    words: str


def quality(trace: Trace) -> tuple[Finding, ...]:
    """What may be wrong with a trace, channel by channel: nothing in a good one.

    - Saturation: the highest or lowest value, where it is far from 0, is held again and again.
    - Drop-out: a value stays exactly the same far longer than usual, and not as regularly as teeth leave the workpiece.
      Where all forces are exactly 0 at the beginning or the end, the tool is taken to be in the air.
    - Drift: the mean goes up or down along the trace, and the lowest and highest values with it.
    - Offset: a value other than 0 before the cut suddenly begins.
    """
    return tuple(
        finding
        for channel, values in zip(trace.channels, trace.values.T, strict=True)
        for check in (_saturated, _dropped, _drifting, _offset)
        for finding in check(trace, channel, values)
    )


def _saturated(trace: Trace, channel: str, values: np.ndarray) -> Iterator[Finding]:
    step, reach = _step(values), np.ptp(values)
    if reach < FINE * step:
        return
    for sign, limit, side in ((1, values.max(), "above"), (-1, values.min(), "below")):
        away = sign * (limit - values)
        near = away < TOP * step
        starts, ends = _runs(near)
        long = ends - starts >= FLAT
        starts, ends = starts[long], ends[long]
        # Near 0 the tool is in the air.
        if (
            abs(limit) <= SMALL * reach
            or len(starts) < REPEATED
            or near.sum() <= PILED * (~near & (away < 3 * TOP * step)).sum()
        ):
            continue
        count = 1 + int((np.maximum.reduceat(away, starts)[:-1] > DIP * reach).sum())
        if count < REPEATED:
            continue
        words = (
            f"it does not go {side} {_text(trace, channel, limit)}, where it is held {count} times: sensor, amplifier or "
            "converter is saturated. Measure again with a larger range, or leave the channel out"
        )
        yield _finding("saturated", trace, channel, starts[0], ends[-1] - 1, limit, words)


def _dropped(trace: Trace, channel: str, values: np.ndarray) -> Iterator[Finding]:
    starts = np.concatenate([[0], 1 + np.flatnonzero(np.diff(values))])
    ends = np.concatenate([starts[1:], [len(values)]])
    lengths = ends - starts
    usual = (len(values) - lengths.max()) / max(len(lengths) - 1, 1)
    often = 2 * np.sort(lengths)[-MANY] if len(lengths) >= MANY else 0
    long = lengths >= max(HELD, OUTSTANDING * usual, often)
    step, air = _step(values), _in_air(trace)
    holds = [
        (a, b)
        for a, b in zip(starts[long], ends[long], strict=True)
        if not (air[a:b].all() and (a == 0 or b == len(values)))
        and all(
            np.abs(beside - values[a]).max() >= MOVING * step
            for beside in (values[max(a - HELD, 0) : a], values[b : b + HELD])
            if len(beside)
        )
    ]
    # An extreme value that is held again and again is saturation.
    extreme = [hold for hold in holds if values[hold[0]] in (values.min(), values.max()) and values[hold[0]] != 0]
    if len(extreme) >= REPEATED:
        holds = [hold for hold in holds if hold not in extreme]
    intervals = np.diff([a for a, _ in holds])
    if not holds or (len(holds) >= REPEATED and intervals.std() <= REGULAR * intervals.mean()):
        return
    a, b = max(holds, key=lambda hold: hold[1] - hold[0])
    others = f", the longest of {len(holds)} such times" if len(holds) > 1 else ""
    words = (
        f"it stays at exactly {_text(trace, channel, values[a])} for {b - a} samples{others}: the signal dropped out. "
        "Choose a window without it, and see to the cable; or leave the channel out"
    )
    yield _finding("drop-out", trace, channel, a, b - 1, values[a], words)


def _drifting(trace: Trace, channel: str, values: np.ndarray) -> Iterator[Finding]:
    size = len(values) // BLOCKS
    if size < SHORTEST:
        return
    blocks = _blocks(values)
    spread = blocks.std(axis=1)
    steady = np.flatnonzero(np.abs(spread - np.median(spread)) <= STEADY * np.median(spread))
    if len(steady) < BLOCKS / 2:
        return
    slope, error = _trend(steady, blocks[steady].mean(axis=1))
    ends = [_trend(steady, end)[0] for end in np.percentile(blocks[steady], ENDS, axis=1)]
    rise = slope * (steady[-1] - steady[0])
    if (
        abs(slope) > SIGNIFICANT * error
        and abs(rise) > RELEVANT * np.ptp(values)
        and all(end * np.sign(slope) > COMMON * abs(slope) for end in ends)
    ):
        words = (
            f"its mean {'rises' if rise > 0 else 'falls'} by {_text(trace, channel, abs(rise))}, and its lowest and highest "
            "values with it: the amplifier or the temperature drifts. Take the trend out, or measure again with the "
            "amplifier reset just before the cut; a shorter window has less of it"
        )
        yield _finding("drift", trace, channel, steady[0] * size, (steady[-1] + 1) * size - 1, rise, words)


def _offset(trace: Trace, channel: str, values: np.ndarray) -> Iterator[Finding]:
    size = len(values) // BLOCKS
    if size < SHORTEST:
        return
    spread = _blocks(values).std(axis=1)
    quiet = int(np.argmax(spread > QUIET * spread.max()))  # blocks before the first that is not
    if quiet < 2 or spread[quiet : quiet + 2].max() < 0.5 * spread.max():
        return
    before = values[: quiet * size]
    level, noise = before.mean(), before - before.mean()
    if noise[1:] @ noise[:-1] > ALIKE * (noise @ noise):
        return
    error = before.std() / np.sqrt(len(before))
    if abs(level) > SIGNIFICANT * error and RELEVANT < abs(level) / np.ptp(values) < SMALL:
        words = (
            f"it is {_text(trace, channel, level)} before the cut begins, not 0: subtract that, or set the amplifier to "
            "zero before the cut and measure again"
        )
        yield _finding("offset", trace, channel, 0, len(before) - 1, level, words)


def _in_air(trace: Trace) -> np.ndarray:
    """Where all forces, or without any all channels, are exactly 0."""
    forces = [i for i, channel in enumerate(trace.channels) if channel.startswith("F")]
    return (trace.values[:, forces or slice(None)] == 0).all(axis=1)


def _step(values: np.ndarray) -> float:
    """The step of quantisation; 0 of a constant."""
    return float(np.diff(np.unique(values)).min(initial=np.inf)) if np.ptp(values) else 0.0


def _blocks(values: np.ndarray) -> np.ndarray:
    """Shape (BLOCKS, samples)."""
    return values[: len(values) // BLOCKS * BLOCKS].reshape(BLOCKS, -1)


def _trend(place: np.ndarray, mean: np.ndarray) -> tuple[float, float]:
    """Slope per block and its standard error, both hardly moved by single blocks (Theil and Sen): the median of the slopes
    between any two, and the median deviation."""
    i, j = np.triu_indices(len(place), 1)
    slope = float(np.median((mean[j] - mean[i]) / (place[j] - place[i])))
    rest = mean - slope * place
    rest = rest - np.median(rest)
    # Blocks beside each other are alike where the rest is slow: there are then fewer independent ones.
    alike = np.clip((rest[1:] @ rest[:-1]) / max(rest @ rest, np.finfo(float).tiny), 0, 0.9)
    deviation = 1.4826 * np.median(np.abs(rest))  # the standard deviation, of a normal distribution
    return slope, float(deviation / (np.std(place) * np.sqrt(len(place))) * np.sqrt((1 + alike) / (1 - alike)))


def _runs(flags: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Where runs of true begin, and where they have ended."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], flags, [False]])))
    return edges[::2], edges[1::2]


def _text(trace: Trace, channel: str, value) -> str:
    return f"{trace.shown(channel, value) + 0.0:.4g} {trace.unit(channel)}"  # 0.0: not "-0"


def _finding(kind: str, trace: Trace, channel: str, first, last, value, words: str) -> Finding:
    start, end = float(trace.time[first]), float(trace.time[last])
    return Finding(
        kind, channel, start, end, float(value), f"{trace.name}: {channel} from {start:.6g} s to {end:.6g} s: {words}"
    )
