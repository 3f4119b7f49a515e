"""The numbers of a case file one by one: their names, values and units, and how to write others in their place."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from ._casekeys import Quantity, Section, table_of
from ._types import AXES
from ._units import EXPONENT, express, parse, written_unit


@dataclass(frozen=True)
class Leaf:
    """A number of a case file that is a leaf of its `Case`.

    - `field`: table and key: ("structure", "damping_ratio") is `case.structure.damping_ratio`, and ("robot.tool", "mass")
      is `case.robot.tool.mass`.
    - `index`: its place in that array, () for a single number.
    - `value`: in SI.
    - `unit`: the unit in which the file gives it; the SI unit for a bare number, and for `force.kf`, whose unit changes
      with `force.m`.
    - `si_unit`: the SI unit.
    """

    field: tuple[str, str]
    index: tuple[int, ...]
    value: float
    unit: str
    si_unit: str

    def express(self, value: float) -> float:
        """The SI number `value` in this leaf's `unit`."""
        return express(value, self.unit)


def leaves(tables: Mapping[str, Any], sections: Mapping[str, Section]) -> dict[str, Leaf]:
    """Every leaf of a case file whose tables have been checked, by name."""
    found = {}
    for section, known in sections.items():
        table = table_of(tables, section) or {}
        for key, kind in known.keys.items():
            if isinstance(kind, Quantity) and kind.parameter and key in table:
                for index, given in _items(table[key]):
                    name = ".".join((section, key, *labels(section, key, index, table)))
                    unit = kind.unit if EXPONENT in kind.unit else written_unit(given, kind.unit)
                    value = parse(name, *kind.resolved(given, table))
                    found[name] = Leaf((section, key), index, value, unit, kind.unit)
    return found


def rewrite(text: str, values: Mapping[Leaf, float]) -> str:
    """TOML `text` with SI numbers in place of leaves, each in the leaf's unit; bare numbers stay bare.

    Numbers have 12 digits. Comments and layout are kept.
    """
    import tomlkit

    document = tomlkit.parse(text)
    for leaf, value in values.items():
        section, key = leaf.field
        *path, last = (*section.split("."), key, *leaf.index)
        place: Any = document
        for step in path:
            place = place[step]
        number = f"{leaf.express(float(value)):.12g}"
        place[last] = f"{number} {leaf.unit}".rstrip() if isinstance(place[last], str) else float(number)
    return tomlkit.dumps(document)


def _items(value: Any, index: tuple[int, ...] = ()) -> Iterator[tuple[tuple[int, ...], Any]]:
    if isinstance(value, list):
        for i, item in enumerate(value):
            yield from _items(item, (*index, i))
    else:
        yield index, value


def labels(section: str, key: str, index: tuple[int, ...], table: Mapping[str, Any]) -> list[str]:
    """Names of the axes where there is one number per axis, of joints, modes and resonances, and numbers for rows, columns,
    coordinates and teeth."""
    if section == "sensor.resonances":
        return [f"mode_{index[0] + 1}", *(AXES[i] for i in index[1:])]
    if len(index) == 1 and section == "robot":
        return [f"{'mode' if key == 'damping_ratio' else 'joint'}_{index[0] + 1}"]
    if len(index) == 1 and section not in ("tool", "force") and "mode_shapes" not in table:
        return [table.get("axes", AXES)[index[0]]]
    return [str(i) for i in index]
