"""How a cut that is yet to be made would be recorded."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from millax._units import parse, show

from ._identifiability import ASSUMED
from ._measured import known_channel
from ._traces import CHANNELS, Trace

MOST_SAMPLES = 10**7
"""Longest recording."""


@dataclass(frozen=True)
class Recording:
    """Channels, times and noise of a recording. What is None is as in the first trace.

    **Arguments:**

    - `channels`: of Fx, Fy, Fz, x, y, z.
    - `duration`: [s] or "0.3 s", > 0.
    - `rate`: of sampling [Hz] or "10 kHz", > 0. The noise is white at this rate: what is sampled more often, and what is
      recorded for longer, is known better.
    - `noise`: standard deviation of a channel [N], [m] or "2 N", > 0. Where it is not given it is that of the first trace
      with the channel, where that is not known 1 % of its root mean square.
    - `start`: [s] or "0.1 s", of the simulation, where the case has no clock. 0 where there is no trace.
    """

    channels: Sequence[str] | None = None
    duration: float | str | None = None
    rate: float | str | None = None
    noise: Mapping[str, float | str] = field(default_factory=dict)
    start: float | str | None = None

    def blank(self, traces: Sequence[Trace]) -> Trace:
        """A trace with these channels, times and noise, all of it known, but with nothing in it yet.

        Raises `ValueError` for what is given neither here nor by a trace, and numbers that are out of range.
        """
        first = traces[0] if traces else None
        channels = self.channels if self.channels is not None else first.channels if first else None
        if not channels:
            raise ValueError("channels: none given, and there is no trace that has them; say what is measured: Fx, Fy, x")
        channels = tuple(known_channel(channel, CHANNELS, "channels:") for channel in channels)
        for channel in self.noise:
            known_channel(channel, dict.fromkeys(channels, ""), "noise:")
        step = 1 / self._positive("rate", "Hz") if self.rate is not None else first.step if first else None
        if step is None:
            raise ValueError('rate: not given, and there is no trace that has one; give it: "10 kHz"')
        length = self._positive("duration", "s") if self.duration is not None else None
        if length is None and first is None:
            raise ValueError('duration: not given, and there is no trace that has one; give it: "0.3 s"')
        length = first.samples * first.step if first and length is None else length
        start = float(parse("start", self.start, "s")) if self.start is not None else first.time[0] if first else 0.0
        assert length is not None
        samples = round(length / step)
        if not 2 <= samples <= MOST_SAMPLES:
            raise ValueError(
                f"duration: {length:g} s at {1 / step:g} Hz are {samples} samples; it must be from 2 to {MOST_SAMPLES:.0e}"
            )
        values = np.ones((samples, len(channels)))
        noise = {channel: self._noise(channel, traces) for channel in channels}
        return Trace(start + step * np.arange(samples), channels, values, noise, name="the recording")

    def _noise(self, channel: str, traces: Sequence[Trace]) -> float:
        if channel in self.noise:
            found = float(parse(f"noise of {channel}", self.noise[channel], CHANNELS[channel]))
            if not (found > 0 and np.isfinite(found)):
                raise ValueError(f"noise of {channel}: {show(self.noise[channel])} given; it must be greater than 0")
            return found
        for trace in traces:
            if channel in trace.channels:
                column = trace.values[:, trace.channels.index(channel)]
                return trace.noise.get(channel, ASSUMED * float(np.sqrt(np.mean(column**2))))
        raise ValueError(f'noise of {channel}: not given, and no trace has this channel; give it: "2 N", or "1 um"')

    def _positive(self, name: str, unit: str) -> float:
        given = getattr(self, name)
        found = float(parse(name, given, unit))
        if not (found > 0 and np.isfinite(found)):
            raise ValueError(f"{name}: {show(given)} given; it must be greater than 0")
        return found
