"""The members of a sweep: which numbers vary, and the values of every member."""

import difflib
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Array, Float

from ._case import Case
from ._casekeys import SECTIONS, Quantity
from ._names import quantity_of, replace, valid_names
from ._units import EXPONENT, express, parse
from ._values import Given, Values, read

FEED_PER_TOOTH = "cut.feed_per_tooth"
"""No number of a case, which holds the feed rate, but one that a sweep can vary or hold."""

SPINDLE_SPEED = "cut.spindle_speed"
"""The number that sets the tooth period, and with it the length of a time step."""


@dataclass(frozen=True, eq=False)
class Members:
    """The members of a sweep, in C order of the grid.

    - `names`: the numbers that differ from the case.
    - `dims`: by dimension of the results, how long it is: the varied names of a grid, or "sample".
    - `coordinates`: by name, the dimension along which it varies (None for one value), and the values as given.
    - `units`: by name, the unit of the coordinate.
    - `table`: SI values, shape (members, names).
    """

    names: tuple[str, ...]
    dims: dict[str, int]
    coordinates: dict[str, tuple[str | None, Float[np.ndarray, "..."]]]
    units: dict[str, str]
    table: Float[np.ndarray, "members names"]

    def __len__(self):
        return len(self.table)

    @property
    def shape(self) -> tuple[int, ...]:
        """Lengths of the dimensions."""
        return tuple(self.dims.values())

    def words(self, member: int) -> str:
        """One member for a message: "cut.depth = 1 mm, force.kr = 0.3"."""
        values = (express(float(v), self.units[name]) for name, v in zip(self.names, self.table[member], strict=True))
        return ", ".join(f"{name} = {v:.6g} {self.units[name]}".strip() for name, v in zip(self.names, values, strict=True))


def members_of(case: Case, grid: Mapping[str, Given] | None, samples: Mapping[str, Given] | None) -> Members:
    """Check what is to be varied, and list the members.

    Raises `ValueError` for both or neither of `grid` and `samples`, a name that is no number of the case, a unit of
    another kind, values that are empty, not finite, out of the range of the quantity or (in a grid) given twice, and
    samples of different lengths.
    """
    if (not grid) == (not samples):
        raise ValueError(
            "give what is to be varied as a grid or as samples, and only one of them: "
            'millax.sweep(case, grid={"cut.depth": "0.2:4:20 mm"})'
        )
    given = dict(grid or samples or {})
    if FEED_PER_TOOTH in given and "cut.feed_rate" in given:
        raise ValueError(f"give {FEED_PER_TOOTH} or cut.feed_rate, and only one of them: each follows from the other")
    values, units, si = {}, {}, {}
    for name, text in given.items():
        quantity = _quantity(case, name)
        values[name] = read(name, text)
        units[name], scale = _unit(case, name, values[name], quantity, varied=given)
        si[name] = values[name].numbers * scale
        _require_range(name, values[name], si[name], quantity)
    vectors = {name: v for name, v in values.items() if v.numbers.ndim}
    if grid:
        for name, v in vectors.items():
            _require_distinct(name, v)
        dims = {name: len(v) for name, v in vectors.items()}
        columns = np.meshgrid(*(si[name] for name in given), indexing="ij")
        coordinates = {name: (name if name in vectors else None, v.numbers) for name, v in values.items()}
    else:
        lengths = {name: len(v) for name, v in vectors.items()}
        if len(set(lengths.values())) > 1:
            words = ", ".join(f"{name} has {n}" for name, n in lengths.items())
            raise ValueError(f"samples: {words} values; every number needs one value per sample (or one for all)")
        dims = {"sample": next(iter(lengths.values()))} if lengths else {}
        columns = [np.broadcast_to(si[name], dims.get("sample", 1)) for name in given]
        coordinates = {name: ("sample" if name in vectors else None, v.numbers) for name, v in values.items()}
    table = np.stack([np.ravel(column) for column in columns], axis=1)
    return Members(tuple(given), dims, coordinates, units, table)


def member(case: Case, names: tuple[str, ...], values: Float[Array, " names"]) -> Case:
    """`case` with the numbers of one member. Differentiable."""
    by_name = dict(zip(names, values, strict=True))
    feed_per_tooth = by_name.pop(FEED_PER_TOOTH, None)
    case = replace(case, by_name) if by_name else case
    if feed_per_tooth is None:
        return case
    return replace(case, {"cut.feed_rate": feed_per_tooth / case.cut.tooth_period(case.tool)})


def _quantity(case: Case, name: str) -> Quantity:
    if name == FEED_PER_TOOTH:
        quantity = SECTIONS["cut"].keys["feed_per_tooth"]
        assert isinstance(quantity, Quantity)
        return quantity
    if name in _NOT_VARIED:
        raise ValueError(f"{name}: {_NOT_VARIED[name]}")
    valid = valid_names(case)
    if name not in valid and difflib.get_close_matches(name, [FEED_PER_TOOTH, *valid], n=1, cutoff=0.5) == [FEED_PER_TOOTH]:
        raise ValueError(f"{name}: unknown parameter; did you mean {FEED_PER_TOOTH}?")
    return quantity_of(case, name)


_NOT_VARIED = {
    "tool.teeth": "the number of teeth cannot be varied in one sweep; sweep one case for each",
    "simulation.duration": "the duration belongs to the case; change it there",
} | {f"stock.{key}": "the workpiece cannot be varied in a sweep; sweep one case for each" for key in SECTIONS["stock"].keys}


def _unit(case: Case, name: str, values: Values, quantity: Quantity, varied: Mapping[str, Given]) -> tuple[str, float]:
    """The unit of the coordinate, and one of it in SI."""
    open_ended = name == "force.kf" and "force.m" in varied
    if values.unit is None:
        return f"N/m^{EXPONENT}" if open_ended else quantity.unit, 1.0
    if open_ended:
        raise ValueError(
            f"{name}: its unit changes with force.m, which is varied too; give its values in SI, as plain numbers"
        )
    if not values.unit:
        if quantity.unit:
            example = f"{np.atleast_1d(values.numbers)[0]:g} {quantity.unit}"
            raise ValueError(f'{name}: numbers without a unit given; write it behind them, as in "{example}"')
        return "", 1.0
    # The unit of a coordinate is written with its exponent as a number, since a file knows nothing of m.
    unit = values.unit.replace(EXPONENT, quantity.unit.partition("^")[2])
    return unit, parse(name, f"1 {unit}", quantity.unit)


def _require_range(name: str, values: Values, si: np.ndarray, quantity: Quantity) -> None:
    if not quantity.range.admits(si):
        bad = next(i for i, v in enumerate(np.atleast_1d(si)) if not quantity.range.admits(v))
        unit = quantity.unit if values.unit is None else values.unit
        shown = f"{np.atleast_1d(values.numbers)[bad]:g} {unit}".strip()
        raise ValueError(f"{name}: {shown} given; it must be {quantity.range}")


def _require_distinct(name: str, values: Values) -> None:
    numbers, counts = np.unique(values.numbers, return_counts=True)
    if counts.max() > 1:
        raise ValueError(f"{name}: {numbers[counts > 1][0]:g} given twice; the values of a grid must differ")
