"""Measured deflections: a robot stands still, is loaded at the tool in several poses, and gives way.

A file has one header row, each column with its unit, and one row per measurement:
`q1 [deg],...,q6 [deg],Fx [N],Fy [N],Fz [N],Mx [N m],x [um],y [um],z [um]`. Loads that are not in the file are 0; without any
column of q the robot stands as in its case.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import ClassVar

import numpy as np

from ._measured import Measured, TraceError, check_finite
from ._table import Layout, Table, read_table

CHANNELS = {"x": "m", "y": "m", "z": "m", "rx": "rad", "ry": "rad", "rz": "rad"}
"""Every channel that can be compared with the model, and its SI unit: displacement of the tool centre point, and rotation
of the tool."""

FORCE, MOMENT = ("Fx", "Fy", "Fz"), ("Mx", "My", "Mz")

LAYOUT = Layout(
    "load test",
    "q1 [deg],q2 [deg],...,Fx [N],Fz [N],x [um],z [um]",
    CHANNELS,
    dict.fromkeys(FORCE, "N") | dict.fromkeys(MOMENT, "N m"),
    {"q": "rad"},
)
"""The columns of a file."""

REPAIR = "Repair the measurement, or leave it out"


@dataclass(frozen=True)
class LoadTest(Measured):
    """How far a robot that stands still gives way to loads on its tool: from unloaded to loaded, once per measurement.

    Everything is in the axes of the robot's base frame. "Unloaded" is with gravity, where the case has it
    ([robot.loads] gravity); force and moment that the case has there for a cut do not count.

    **Arguments:**

    - `joints`: q, what the drives set in each measurement [rad], [m], shape (m, n). None: always that of the case.
    - `force`: on the tool, at the tool centre point [N], shape (m, 3).
    - `channels`: what the columns of `values` are: of x, y, z [m], displacement of the tool centre point, and rx, ry, rz
      [rad], rotation of the tool: axis times angle.
    - `values`: SI, shape (m, channels).
    - `moment`: on the tool, about the tool centre point [N m], shape (m, 3). None: 0.
    - `noise`: standard deviation of the noise of a channel in SI, where it is known.
    - `units`: in which a channel is shown; SI where it is not named.
    - `name`: for messages and reports.

    Raises `TraceError` for shapes that do not fit, values that are not finite, no load at all, unknown or repeated channels,
    a channel that is zero throughout, and noise that is not positive.
    """

    CHANNELS: ClassVar[Mapping[str, str]] = CHANNELS

    joints: np.ndarray | None
    force: np.ndarray
    channels: tuple[str, ...]
    values: np.ndarray
    moment: np.ndarray | None = None
    noise: Mapping[str, float] = field(default_factory=dict)
    units: Mapping[str, str] = field(default_factory=dict)
    name: str = "load test"

    def __post_init__(self):
        force, values = np.asarray(self.force, dtype=float), np.asarray(self.values, dtype=float)
        moment = np.zeros_like(force) if self.moment is None else np.asarray(self.moment, dtype=float)
        joints = None if self.joints is None else np.asarray(self.joints, dtype=float)
        m, channels = len(values) if values.ndim else 0, tuple(self.channels)
        if not channels or m == 0 or values.shape != (m, len(channels)):
            raise TraceError(
                f"{self.name}: values of shape {values.shape} given; they must be (measurements, {len(channels)}), with at "
                "least one measurement and one channel"
            )
        for name, given in (("force", force), ("moment", moment)):
            if given.shape != (m, 3):
                raise TraceError(
                    f"{self.name}: {name} of shape {given.shape} given; with {m} measurements it must be ({m}, 3)"
                )
        if joints is not None and (joints.ndim != 2 or len(joints) != m):
            raise TraceError(
                f"{self.name}: joints of shape {joints.shape} given; with {m} measurements it must be ({m}, joints of the "
                "robot)"
            )
        self.check_channels()
        poses = np.empty((m, 0)) if joints is None else joints
        names = (*(f"q{i + 1}" for i in range(poses.shape[1])), *FORCE, *MOMENT, *channels)
        check_finite(self.name, np.column_stack([poses, force, moment, values]), names, measurement, REPAIR)
        for name, given in (("joints", joints), ("force", force), ("moment", moment), ("values", values)):
            object.__setattr__(self, name, given)
        object.__setattr__(self, "channels", channels)
        if not self.wrench.any():
            raise TraceError(
                f"{self.name}: there is no load at all: every force and moment is zero. Give them as columns Fx [N] to "
                "Mz [N m], or as force and moment"
            )
        self.check_not_zero()

    @property
    def wrench(self) -> np.ndarray:
        """Force [N] and moment [N m] on the tool, shape (m, 6)."""
        return np.concatenate([self.force, np.zeros_like(self.force) if self.moment is None else self.moment], axis=1)


def measurement(i: int) -> str:
    """What messages call measurement `i`, counted from 0: they count from 1."""
    return f"measurement {i + 1}"


def read_load_test(
    path: str | Path,
    *,
    channels: Sequence[str] | None = None,
    noise: Mapping[str, float | str] | None = None,
) -> LoadTest:
    """Read a CSV file. Its joints turn; the pose of a robot with joints that slide is given to `LoadTest` itself.

    **Arguments:**

    - `path`: the file.
    - `channels`: which of x, y, z, rx, ry, rz to use. None: all there are; every other column must then be q or a load.
    - `noise`: standard deviation of the noise per channel ("10 um"), where it is known.

    Raises `TraceError`, which names the file and the row or column.
    """
    path = Path(path)
    table = read_table(path, LAYOUT, channels, format="csv")
    table.check_finite(REPAIR)
    test = LoadTest(
        joints=_joints(table),
        force=table.of(*FORCE),
        channels=table.channels,
        values=table.of(*table.channels),
        moment=table.of(*MOMENT),
        noise=table.noise(noise),
        units=table.units,
        name=str(path),
    )
    return replace(test, name=path.name)  # the path is for messages


def _joints(table: Table) -> np.ndarray | None:
    """The columns q1 ... qn; None where there are none. Raises `TraceError` where one is missing."""
    given = sum(name not in LAYOUT.others and name not in CHANNELS for name in table.names)
    names = [f"q{i + 1}" for i in range(given)]
    missing = [name for name in names if name not in table.names]
    if missing:
        raise TraceError(
            f"{table.path}: no column {missing[0]}, but {given} others of q; give every joint, or none for the pose of "
            "the case"
        )
    return table.of(*names) if names else None
