"""What all measurements have in common: channels in columns, their units and noise, and checks of them."""

from collections.abc import Callable, Mapping, Sequence
from typing import ClassVar

import numpy as np

from millax._units import si_scale


class TraceError(ValueError):
    """A measurement that cannot be used; the message names file, row and column, and what to do."""


class Measured:
    """Channels measured several times: a `Trace`, a `LoadTest`."""

    CHANNELS: ClassVar[Mapping[str, str]]
    """Every channel that can be compared with the model, and its SI unit."""

    channels: tuple[str, ...]
    values: np.ndarray
    noise: Mapping[str, float]
    units: Mapping[str, str]
    name: str

    @property
    def samples(self) -> int:
        """How often each channel was measured."""
        return len(self.values)

    def unit(self, channel: str) -> str:
        """The unit in which a channel is shown."""
        return self.units.get(channel, self.CHANNELS[channel])

    def shown(self, channel: str, value):
        """SI values of a channel in the unit in which it is shown."""
        return value / si_scale(self.unit(channel))

    def check_channels(self) -> None:
        """Raise `TraceError` for channels that are unknown or there twice, and noise that fits none or is not positive."""
        for channel in self.channels:
            known_channel(channel, self.CHANNELS, f"{self.name}: channel")
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

    def check_not_zero(self) -> None:
        """Raise `TraceError` for a channel that is zero throughout."""
        for channel, column in zip(self.channels, self.values.T, strict=True):
            if not column.any():
                raise TraceError(
                    f"{self.name}: channel {channel} is zero throughout: nothing was measured, or it is in another "
                    "column. Leave it out of the channels"
                )


def known_channel(channel: str, channels: Mapping[str, str], where: str) -> str:
    """`channel`, where it is one of `channels`. Raises `TraceError`, which begins with `where`."""
    if channel not in channels:
        raise TraceError(f"{where} {channel!r} is unknown; known are {', '.join(channels)}")
    return channel


def check_finite(name: str, table: np.ndarray, columns: Sequence[str], place: Callable[[int], str], cure: str) -> None:
    """Raise `TraceError` where a number of `table`, shape (rows, columns), is not finite, with the `place` of its row and
    what to do."""
    if not np.isfinite(table).all():
        i, column = np.argwhere(~np.isfinite(table))[0]
        raise TraceError(f"{name}: {place(i)}, column {columns[column]}: not a finite number. {cure}")
