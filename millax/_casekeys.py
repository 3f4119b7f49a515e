"""What a case file may contain: one table, read by the reader, its error messages, the writer and the fits.

A key is a `Quantity`, a whole number or a choice; each knows how to read its value and how to say what it takes.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ._forces import ExponentialLaw, ForceLaw, FractionalLaw, LinearLaw
from ._tool import STEEPEST
from ._types import AXES
from ._units import EXPONENT, parse, show
from .robot import Robot, models


@dataclass(frozen=True)
class Range:
    """The numbers from `low` to `high`, `low` itself only if `closed`."""

    low: float = -math.inf
    high: float = math.inf
    closed: bool = True

    def admits(self, v: np.ndarray) -> bool:
        """Whether every number of `v` is in the range."""
        return bool(np.all((v >= self.low if self.closed else v > self.low) & (v <= self.high)))

    def __str__(self):
        if self.low == -math.inf:
            return "a finite number"
        words = f"{self.low:g} or greater" if self.closed else f"greater than {self.low:g}"
        return words if self.high == math.inf else f"{words}, and at most {self.high:g}"


ANY = Range()
POSITIVE = Range(0, closed=False)
NOT_NEGATIVE = Range(0)

_SHAPES = {
    "number": (lambda v: v.ndim == 0, "one number"),
    "point": (lambda v: v.shape == (2,), "a list of two numbers"),
    "interval": (lambda v: v.shape == (2,) and v[0] < v[1], "a list of two numbers, the smaller first"),
    "list": (lambda v: v.ndim == 1, "a list with one number per tooth"),
    "teeth": (lambda v: v.ndim <= 1, "one number, or a list with one per tooth"),
    "joints": (lambda v: v.ndim == 1, "a list with one number per joint"),
    "links": (lambda v: v.ndim == 1, "a list with one number per elastic link"),
    "modes": (lambda v: v.shape in ((), (6,)), "one number, or a list of six, one per mode"),
    "vector": (lambda v: v.shape == (3,), "a list of three numbers"),
    "resonances": (lambda v: v.ndim == 1, "a list with one number per resonance"),
    "residues": (lambda v: v.ndim == 3 and v.shape[1:] == (3, 3), "a list with one matrix of 3 by 3 per resonance"),
    "array": (lambda v: v.ndim <= 2, "one number, a list with one per coordinate, or a matrix as a list of rows"),
    "matrix": (lambda v: v.ndim == 2, "a matrix as a list of rows"),
}


@dataclass(frozen=True)
class Quantity:
    """A number with a unit, or a list or matrix of them.

    `unit` is the SI unit, "" for a plain number. `range` holds for every number, but not for those of a matrix, whose
    entries off the diagonal have rules of their own. `parameter`: the number is a leaf of the `Case`, under this name.
    """

    unit: str = ""
    range: Range = ANY
    shape: str = "number"
    required: bool = True
    parameter: bool = True

    def read(self, name: str, value: Any, table: Mapping[str, Any]) -> Any:
        """`value` in SI, a float or nested lists; `table` is where it stands. Raises `ValueError`."""
        fits, words = _SHAPES[self.shape]
        numbers = parse(name, *self.resolved(value, table))
        try:
            array = np.array(numbers)
        except ValueError:  # rows of different lengths
            array = np.empty(0)
        if array.size == 0 or not fits(array):
            raise ValueError(f"{name}: {show(value)} given; it must be {words}")
        if array.ndim < 2 and not self.range.admits(array):
            raise ValueError(f"{name}: {show(value)} given; it must be {self.range}")
        return numbers

    def resolved(self, value: Any, table: Mapping[str, Any]) -> tuple[Any, str]:
        """`value` and `unit` with an exponent (1+m) in them as a number."""
        if EXPONENT not in self.unit:
            return value, self.unit
        number = f"{1 + parse('force.m', table['m'], ''):.9g}"
        return value.replace(EXPONENT, number) if isinstance(value, str) else value, self.unit.replace(EXPONENT, number)

    def __str__(self):
        return f"[{self.unit}]" if self.unit else "[number]"


@dataclass(frozen=True)
class Whole:
    """A whole number of at least `least`."""

    least: int
    required: bool = True
    parameter: bool = field(default=False, init=False)

    def read(self, name: str, value: Any, table: Mapping[str, Any]) -> int:
        """`value`. Raises `ValueError`."""
        if isinstance(value, bool) or not isinstance(value, int) or value < self.least:
            raise ValueError(f"{name}: {show(value)} given; it must be a whole number of at least {self.least}")
        return value

    def __str__(self):
        return "[whole number]"


@dataclass(frozen=True)
class Choice:
    """One of some words, or a list of them."""

    options: tuple[str, ...]
    several: bool = False
    required: bool = True
    parameter: bool = field(default=False, init=False)

    def read(self, name: str, value: Any, table: Mapping[str, Any]) -> Any:
        """`value`, a list as a tuple. Raises `ValueError`."""
        words = ", ".join(map(show, self.options))
        if self.several:
            if not isinstance(value, list) or not value or not set(map(str, value)) <= set(self.options):
                raise ValueError(f"{name}: {show(value)} given; it must be a list of some of {words}")
            return tuple(value)
        if value not in self.options:
            raise ValueError(f"{name}: {show(value)} given; it must be one of {words}")
        return value

    def __str__(self):
        return f"[{'list of ' if self.several else ''}{' | '.join(self.options)}]"


@dataclass(frozen=True)
class File:
    """The name of a file, from the folder of the case file on."""

    required: bool = True
    parameter: bool = field(default=False, init=False)

    def read(self, name: str, value: Any, table: Mapping[str, Any]) -> str:
        """`value`. Raises `ValueError`."""
        if not isinstance(value, str) or not value:
            raise ValueError(f"{name}: {show(value)} given; it must be the name of a file")
        return value

    def __str__(self):
        return "[file]"


@dataclass(frozen=True)
class Rows:
    """A list of rows, each of quantities with these units in this order."""

    columns: Mapping[str, str]
    required: bool = True
    parameter: bool = field(default=False, init=False)

    def read(self, name: str, value: Any, table: Mapping[str, Any]) -> dict[str, list[float]]:
        """The columns of `value` by their names, in SI. Raises `ValueError`."""
        words = f"a list of rows {self}"
        if not isinstance(value, list) or not value:
            raise ValueError(f"{name}: {show(value)} given; it must be {words}")
        columns: dict[str, list[float]] = {column: [] for column in self.columns}
        for i, row in enumerate(value):
            if not isinstance(row, list) or len(row) != len(self.columns):
                raise ValueError(f"{name}[{i}]: {show(row)} given; it must be one row of {words}")
            for (column, unit), item in zip(self.columns.items(), row, strict=True):
                columns[column].append(parse(f"{name}[{i}], {column}", item, unit))
        return columns

    def __str__(self):
        return "[" + ", ".join(f"{column} {unit}" for column, unit in self.columns.items()) + "]"


Key = Quantity | Whole | Choice | File | Rows


@dataclass(frozen=True)
class Section:
    """A table of the case file: its keys, and groups of keys of which exactly one must be given."""

    keys: Mapping[str, Key]
    exactly_one: tuple[tuple[str, ...], ...] = ()
    required: bool = True

    def __str__(self):
        """The keys with their units; a star marks those that must be given."""
        words = [f"{key}{'*' if kind.required else ''} {kind}" for key, kind in self.keys.items()]
        words += [f"one of {' and '.join(group)}*" for group in self.exactly_one]
        return ", ".join(words) + "  (* must be given)"


def _force(**keys: Key) -> Section:
    return Section({"law": Choice(tuple(LAWS)), **keys, **_OF_EVERY_LAW})


LAWS: dict[str, type[ForceLaw]] = {"fractional": FractionalLaw, "linear": LinearLaw, "exponential": ExponentialLaw}

MODELS: dict[str, Callable[[], Robot]] = {
    model.__name__: model
    for model in (models.kuka_kr270, models.kuka_kr210_r2700_2, models.abb_irb6660, models.abb_irb6660_ha)
}
"""Built-in robots by name."""


def _coefficient(unit: str = "", range: Range = ANY, *, required: bool = True) -> Quantity:
    return Quantity(unit, range, "teeth", required)


_OF_EVERY_LAW = {
    "kr": _coefficient(),
    "ka": _coefficient(required=False),
    "ke": _coefficient("N/m", NOT_NEGATIVE, required=False),
    "kre": _coefficient("N/m", required=False),
    "kae": _coefficient("N/m", required=False),
    "process_damping": _coefficient("N/m", NOT_NEGATIVE, required=False),
}

FORCE: dict[str, Section] = {
    "fractional": _force(
        k0=_coefficient("N/m^2", POSITIVE), hs=_coefficient("m", POSITIVE), r=_coefficient("", NOT_NEGATIVE)
    ),
    "linear": _force(kt=_coefficient("N/m^2", POSITIVE)),
    "exponential": _force(
        kf=_coefficient(f"N/m^{EXPONENT}", POSITIVE),
        # Units depend on it: it is one number.
        m=Quantity("", Range(0, 1, closed=False)),
    ),
}
"""The keys of [force], which depend on the law."""

SECTIONS: dict[str, Section] = {
    "tool": Section(
        {
            "diameter": Quantity("m", POSITIVE),
            "teeth": Whole(1),
            "helix": Quantity("rad", Range(0, STEEPEST), required=False),
            "pitch": Quantity("rad", POSITIVE, "list", required=False),
            "runout": Quantity("m", ANY, "list", required=False),
            "offset": Quantity("m", NOT_NEGATIVE, required=False),
            "offset_angle": Quantity("rad", required=False),
        }
    ),
    "force": Section({"law": Choice(tuple(LAWS))}),
    "cut": Section(
        {
            "spindle_speed": Quantity("rad/s", POSITIVE),
            "feed_rate": Quantity("m/s", NOT_NEGATIVE, required=False),
            # Not a leaf: the case holds the feed rate that follows from it.
            "feed_per_tooth": Quantity("m", NOT_NEGATIVE, required=False, parameter=False),
            "depth": Quantity("m", POSITIVE),
            "start": Quantity("m", shape="point", required=False),
        },
        exactly_one=(("feed_rate", "feed_per_tooth"),),
    ),
    "stock": Section(
        {
            "x": Quantity("m", shape="interval", required=False, parameter=False),
            "y": Quantity("m", shape="interval", required=False, parameter=False),
            # Not a leaf: the case holds the border that follows from it. `Stock.immersed` knows its range.
            "immersion": Quantity("m", required=False, parameter=False),
            "milling": Choice(("up", "down"), required=False),
        },
        required=False,
    ),
    "structure": Section(
        {
            "axes": Choice(AXES, several=True),
            "mass": Quantity("kg", POSITIVE, "array"),
            "stiffness": Quantity("N/m", ANY, "array"),
            "damping_ratio": Quantity("", NOT_NEGATIVE, "array", required=False),
            "damping": Quantity("N s/m", NOT_NEGATIVE, "array", required=False),
            "mode_shapes": Quantity("", ANY, "matrix", required=False),
        },
        exactly_one=(("damping_ratio", "damping"),),
        required=False,
    ),
    "robot": Section(
        {
            "model": Choice(tuple(MODELS), required=False),
            "urdf": File(required=False),
            "dh": Rows({"a": "m", "alpha": "rad", "d": "m", "theta": "rad"}, required=False),
            "joints": Quantity("rad", ANY, "joints"),
            "compliance": Quantity("rad/(N m)", POSITIVE, "joints"),
            "damping_ratio": Quantity("", NOT_NEGATIVE, "modes", required=False),
            "damping": Quantity("N m s/rad", NOT_NEGATIVE, "joints", required=False),
            "feed_angle": Quantity("rad", required=False),
            # Not leaves: inertia follows from them, and what replaces that of the model.
            "link_mass": Quantity("kg", POSITIVE, "joints", required=False, parameter=False),
            "link_thickness": Quantity("m", POSITIVE, required=False, parameter=False),
        },
        exactly_one=(("model", "urdf", "dh"), ("damping_ratio", "damping")),
        required=False,
    ),
    "robot.tool": Section(
        {
            "xyz": Quantity("m", ANY, "vector", required=False),
            "rpy": Quantity("rad", ANY, "vector", required=False),
            "mass": Quantity("kg", NOT_NEGATIVE, required=False),
            "centre_of_mass": Quantity("m", ANY, "vector", required=False),
            "inertia": Quantity("kg m^2", ANY, "matrix", required=False),
        },
        required=False,
    ),
    "robot.links": Section(
        {
            # Not leaves: the case holds the beams that follow from them.
            "joints": Quantity("", POSITIVE, "links", parameter=False),
            "outer": Quantity("m", POSITIVE, "links", parameter=False),
            "inner": Quantity("m", NOT_NEGATIVE, "links", required=False, parameter=False),
            "young": Quantity("N/m^2", POSITIVE, required=False, parameter=False),
            "shear": Quantity("N/m^2", POSITIVE, required=False, parameter=False),
        },
        required=False,
    ),
    "robot.loads": Section(
        {
            "force": Quantity("N", ANY, "vector", required=False),
            "moment": Quantity("N m", ANY, "vector", required=False),
            "gravity": Quantity("m/s^2", ANY, "vector", required=False),
        },
        required=False,
    ),
    "sensor": Section(
        {
            "gain": Quantity("", ANY, "vector", required=False),
            "bias": Quantity("N", ANY, "vector", required=False),
            "delay": Quantity("s", required=False),
        },
        required=False,
    ),
    "sensor.resonances": Section(
        {
            "frequency": Quantity("Hz", POSITIVE, "resonances"),
            "damping_ratio": Quantity("", POSITIVE, "resonances"),
            "axes": Choice(AXES, several=True, required=False),
            "residue": Quantity("", ANY, "residues", required=False),
        },
        exactly_one=(("axes", "residue"),),
        required=False,
    ),
    "sensor.low_pass": Section({"cutoff": Quantity("Hz", POSITIVE), "order": Whole(1, required=False)}, required=False),
    "clock": Section(
        {"start": Quantity("s", required=False), "speed_error": Quantity("", Range(-1, closed=False), required=False)},
        required=False,
    ),
    "simulation": Section(
        {
            "duration": Quantity("s", POSITIVE, parameter=False),
            "steps_per_tooth": Whole(10, required=False),
            "passes": Whole(1, required=False),
            "slices": Whole(1, required=False),
            "width": Quantity("m", NOT_NEGATIVE, required=False, parameter=False),
            "blocks": Whole(1, required=False),
            "sweeps": Whole(1, required=False),
            "tolerance": Quantity("", POSITIVE, required=False, parameter=False),
        }
    ),
}
"""Every table of a case file; "robot.tool" is the table [robot.tool] in [robot]. The keys of [force] are those of its law,
in `FORCE`."""


def table_of(tables: Mapping[str, Any], section: str) -> Any:
    """The table of this name, None where there is none. Raises `ValueError` for what is no table."""
    found: Any = tables
    for name in section.split("."):
        found = found.get(name) if isinstance(found, Mapping) else None
    if found is not None and not isinstance(found, Mapping):
        raise ValueError(f"{section}: {show(found)} given; it must be a table, [{section}]")
    return found


OTHER_TABLES = ("fit", "trace", "load_test")
"""Tables that a case file may hold for the package `identification`, which reads and checks them."""
