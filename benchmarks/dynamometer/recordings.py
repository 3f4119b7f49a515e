"""The recordings, the turn that repeats in each, and the cut they are of."""

import dataclasses
from pathlib import Path

import millax as mx
from identification import SynchronousAverage, Trace, read_trace, synchronous_average

FEEDS = (300, 900, 1500)
"""[mm/min]."""

AXES = {"X": "Fy", "Y": "Fx", "Z": "Fz"}
"""The axes of the dynamometer by the forces of the model: the feed is along its Y."""

TURN, TURNING = 100, 100.0
"""Samples of a turn of the spindle, and turns a second [Hz]."""

EARLIEST = 0.13
"""Time of the simulation from which it is compared [s]. What the start excites in tool and chain has to have died out: where
one tooth hardly cuts, the waves that it leaves take ten turns. A fit from 0.05 s on made use of them."""

DURATION = EARLIEST + 0.045
"""Of a simulation: until three turns after the first sample, which is within a turn of `EARLIEST` [s]."""

MISSED = 0.3
"""sigma in parts of the varying force: about what one resonance per axis leaves. It sets how much priors weigh, no more."""

ANY_LAW = mx.LinearLaw(kt=1e9, kr=0.3, ka=0.1)
"""For what does not depend on the law."""


def case_of(feed: float, law: mx.ForceLaw) -> mx.Case:
    """The cut at a feed [mm/min]."""
    tables = {
        "tool": {"diameter": "25 mm", "teeth": 2, "helix": "45 deg", "runout": [0, "-16 um"]},
        "force": {"law": "linear", "kt": "1000 N/mm^2", "kr": 0.3},
        "cut": {"spindle_speed": "6000 rpm", "feed_rate": f"{feed} mm/min", "depth": "3 mm", "start": ["50 mm", 0]},
        "clock": {"start": f"{EARLIEST} s"},
        "simulation": {"duration": f"{DURATION} s"},
    }
    return dataclasses.replace(mx.load_case(tables), force=law)


@dataclasses.dataclass(frozen=True)
class Data:
    """The recordings: as they are, and the turn that repeats in each, with its weights."""

    whole: list[Trace]
    averages: list[SynchronousAverage]

    @property
    def turns(self) -> list[Trace]:
        return [weighted(average) for average in self.averages]


def weighted(average: SynchronousAverage) -> Trace:
    """With sigma in proportion to the varying force of each channel: the sum over feeds and axes of 1 - R² is made least."""
    trace = average.trace
    sigma = {channel: float(MISSED * s) for channel, s in zip(trace.channels, trace.values.std(axis=0), strict=True)}
    return dataclasses.replace(trace, noise=sigma)


def read(folder: Path) -> Data:
    """The recordings of a folder."""
    columns = {"time": "Time", **{force: f"F{axis.lower()}" for axis, force in AXES.items()}}
    whole = [read_trace(folder / f"n6000_f{feed}_ap3_ae25.csv", columns=columns) for feed in FEEDS]
    return Data(whole, averaged(whole))


def averaged(traces: list[Trace]) -> list[SynchronousAverage]:
    return [synchronous_average(case_of(f, ANY_LAW), trace) for f, trace in zip(FEEDS, traces, strict=True)]


def halves(data: Data) -> tuple[Data, list[Trace]]:
    """The first half of every recording, to be fitted, and the second, to be predicted."""
    first, second = [], []
    for trace in data.whole:
        middle = trace.samples // 2
        first.append(dataclasses.replace(trace, time=trace.time[:middle], values=trace.values[:middle]))
        second.append(dataclasses.replace(trace, time=trace.time[middle:], values=trace.values[middle:]))
    return Data(first, averaged(first)), second
