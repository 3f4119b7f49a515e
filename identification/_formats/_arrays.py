"""Files that hold arrays under names in levels: what MAT, HDF5 and TDMS have in common."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from .._measured import TraceError
from ._raw import EvenTimes, Raw, RawColumn, shown, split_label

WIDEST = 64
"""Most channels in one array; beyond it is a picture, a matrix or a file that is broken."""


@dataclass(frozen=True)
class Array:
    """An array in a file.

    - `name`: with "/" between the levels, and maybe with a unit: "cut1/forces/Fx".
    - `unit`: where the file has one beside the name.
    - `read`: its numbers.
    """

    name: str
    shape: tuple[int, ...]
    read: Callable[[], np.ndarray]
    unit: str | None = None
    clock: EvenTimes | None = None

    @property
    def channels(self) -> int:
        """How many there are in it: 1 where it is one long row or column. Samples run along the longer axis, so that it
        does not matter whether a program writes arrays by rows or by columns. 0: it is no recording, but a single number or
        a matrix."""
        long = sorted((n for n in self.shape if n != 1), reverse=True)
        if len(long) == 1:
            return 1
        return long[1] if len(long) == 2 and long[0] > long[1] and long[1] <= WIDEST else 0

    def samples(self) -> np.ndarray:
        """Shape (samples, channels)."""
        values = np.squeeze(np.asarray(self.read(), dtype=float))
        if values.ndim == 1:
            return values[:, None]
        return values if values.shape[0] > values.shape[1] else values.T


def with_arrays(path: Path, arrays: Iterable[Array]) -> Raw:
    """The columns of a file: "name" of an array with one channel, "name[0]", "name[1]" and so on of one with more."""
    sources, columns = [], []
    for array in arrays:
        name, inside = split_label(array.name)
        if inside and array.unit and inside != array.unit:
            raise TraceError(f'{path}: "{shown(array.name)}" has the unit {shown(array.unit)}; keep one of them')
        for i in range(array.channels):
            full = name if array.channels == 1 else f"{name}[{i}]"
            columns.append(RawColumn(full, array.unit or inside, f'column "{shown(full)}"', array.clock))
            sources.append((array, i))

    def numbers(used: Sequence[int]) -> tuple[np.ndarray, np.ndarray]:
        read: dict[str, np.ndarray] = {}
        parts = []
        for position in used:
            array, i = sources[position]
            if array.name not in read:
                read[array.name] = array.samples()
            parts.append(read[array.name][:, i])
            if len(parts[-1]) != len(parts[0]):
                raise TraceError(
                    f"{path}: {columns[position].label} has {len(parts[-1])} samples, {columns[used[0]].label} "
                    f"{len(parts[0])}; take columns of one recording"
                )
        return np.stack(parts, axis=1), np.arange(len(parts[0]))

    return Raw(tuple(columns), numbers, "sample", text=False)


def unreadable(path: Path, what: str, error: Exception) -> TraceError:
    """For whatever a reader of files raises when one is broken: there is no end to what that may be."""
    words = str(error).strip().partition("\n")[0] or type(error).__name__
    return TraceError(f"{path}: not {what} that can be read ({words}); is the file cut short?")
