"""The checkpoint of a fit: where it is, kept in a file while it runs, so that a fit that was ended goes on from there."""

import dataclasses
import hashlib
import json
import os
import time
import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ._noise import Noise, NoiseModel
from ._question import Question
from ._store import load, save, tree, version

CONTENT = "checkpoint of a fit"

EVERY = 1.0
"""Seconds between two times that a state is kept while a stage of the fit lasts."""

SHOWN = ("name", "units")
"""Fields of a measurement that are for people to read: another file of the same numbers is the same measurement."""


class CheckpointError(ValueError):
    """A checkpoint from which this fit cannot go on; the message says why, and what to do."""


@dataclass(frozen=True)
class End:
    """Where one of many starts led: coordinates, shape (n,), and cost."""

    y: np.ndarray
    cost: float


@dataclass(frozen=True)
class State:
    """Where a fit is.

    - `y`: the best coordinates, shape (n,).
    - `noise`: at which they were found.
    - `round`: how often the noise has been estimated.
    - `ends`: of the starts that are done, where there are many.
    - `iterations`, `seconds`: so far.
    """

    y: np.ndarray
    noise: Noise
    round: int
    ends: tuple[End, ...]
    iterations: int
    seconds: float


@dataclass(frozen=True)
class _Kept:
    """The content of a checkpoint: the state of a fit, and what that fit is asked, as `fingerprint`."""

    asked: Mapping[str, str]
    state: State


class Checkpoint:
    """The file `path` in which the state of one fit is kept."""

    def __init__(self, path: str | os.PathLike, asked: Question, noise: NoiseModel, starts: np.ndarray | None):
        self.path = Path(path)
        self._asked = fingerprint(asked, noise, starts)
        self._next = 0.0

    def found(self) -> State | None:
        """The state in the file; None where there is no file.

        Raises `CheckpointError` for the checkpoint of another question, a file that is no checkpoint, and a directory that
        does not exist.
        """
        if not self.path.parent.is_dir():
            raise CheckpointError(
                f"{self.path}: the directory of the checkpoint does not exist; make it, or give another path"
            )
        if not self.path.exists():
            return None
        cure = "Delete the file to begin anew (millax fit --restart does), or give another path"
        try:
            kept = load(self.path, CONTENT, _Kept)
        except ValueError as error:
            raise CheckpointError(f"{error}. {cure}") from error
        other = [f"other {what}" for what, digest in self._asked.items() if kept.asked.get(what) != digest]
        if other:
            raise CheckpointError(f"{self.path}: the checkpoint belongs to another question: {', '.join(other)}. {cure}")
        return kept.state

    def keep(self, state: State, *, now: bool = False) -> None:
        """Write the state, where the last one is `EVERY` seconds old, or `now`. A disk that does not take it is no reason to
        end a fit: that is a warning."""
        if not now and time.monotonic() < self._next:
            return
        try:
            save(self.path, CONTENT, _Kept(self._asked, state))
        except OSError as error:
            warnings.warn(f"{self.path}: the checkpoint cannot be written: {error.strerror}; the fit goes on", stacklevel=2)
        self._next = time.monotonic() + EVERY

    def remove(self) -> None:
        """The fit has ended."""
        self.path.unlink(missing_ok=True)


def fingerprint(asked: Question, noise: NoiseModel, starts: np.ndarray | None) -> dict[str, str]:
    """Hashes of all that the answer of a fit depends on, by what it is: its question, the kind of noise, and the many
    starts, if there are. Neither the solver nor the names of files are part of it."""
    measured = [
        {f.name: getattr(one, f.name) for f in dataclasses.fields(one) if f.name not in SHOWN} for one in asked.measured
    ]
    return {
        "measurements": _digest(measured),
        "cases": _digest((asked.cases, asked.case_of)),
        "free parameters, guesses, bounds, priors or ties": _digest(dataclasses.replace(asked.numbers, units=())),
        "kind of noise": _digest(noise),
        "starts": _digest(starts),
        "version of millax": version(),
    }


def _digest(value: Any) -> str:
    def array(numbers, _):
        data = np.asarray(numbers)
        return [str(data.dtype), list(data.shape), hashlib.sha256(data.tobytes()).hexdigest()]

    structure = tree(value, array)
    return hashlib.sha256(json.dumps(structure, sort_keys=True).encode()).hexdigest()
