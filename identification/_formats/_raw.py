"""What every format gives: named columns of numbers, and how messages call a place in the file."""

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

_LABEL = re.compile(r"\s*(?P<name>.*?)\s*(?:\[\s*(?P<square>[^\[\]]*?)\s*\]|\(\s*(?P<round>[^()]*?)\s*\))?\s*", re.DOTALL)

LONGEST = 60
"""Characters of a name that messages show, and names of columns that they list: a broken header may have thousands."""


@dataclass(frozen=True)
class EvenTimes:
    """Even times that a file states instead of listing them: start [s], step [s], and what the start is counted from."""

    start: float
    step: float
    epoch: Any = None

    def __str__(self) -> str:
        return f"{self.start:g} s + {self.step:g} s per sample" + (f" from {self.epoch}" if self.epoch else "")


@dataclass(frozen=True)
class RawColumn:
    """A column as it stands in its file.

    - `name`: without its unit, with "/" between the levels of a file that has levels.
    - `unit`: as it is written; None where there is none.
    - `label`: what messages call it: `column 2 "Fx [N]"`.
    - `clock`: the times of its samples, where the file states them.
    """

    name: str
    unit: str | None
    label: str
    clock: EvenTimes | None = None

    @property
    def last(self) -> str:
        """The name without the levels above it."""
        return self.name.rpartition("/")[2]


@dataclass(frozen=True)
class Raw:
    """The columns of a file.

    - `numbers`: reads columns by their positions: numbers, shape (rows, columns), NaN where a cell is no number, and the
      number of each row in the file.
    - `row`: what messages call a row.
    - `text`: whether a person can write a unit into the file.
    """

    columns: tuple[RawColumn, ...]
    numbers: Callable[[Sequence[int]], tuple[np.ndarray, np.ndarray]]
    row: str
    text: bool

    @property
    def names(self) -> str:
        """Every column, for messages."""
        return listed([column.name + (f" [{column.unit}]" if column.unit else "") for column in self.columns])


def split_label(label: str) -> tuple[str, str | None]:
    """Name and unit of `Fx [N]` or `Fx (N)`; a number in brackets is no unit: `forces[0]`."""
    match = _LABEL.fullmatch(label)
    assert match  # every text does
    unit = match["square"] or match["round"] or None
    return (label.strip(), None) if unit and unit.isdigit() else (match["name"], unit)


def shown(name: str) -> str:
    """A name for a message."""
    return name if len(name) <= LONGEST else f"{name[:LONGEST]}..."


def listed(names: Sequence[str]) -> str:
    """Names for a message."""
    more = [f"and {len(names) - LONGEST} more"] if len(names) > LONGEST else []
    return ", ".join([*map(shown, names[:LONGEST]), *more])
