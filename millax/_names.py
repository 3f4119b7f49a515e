"""The numbers of a case by their names: which there are, what they may be, and a case with others in their place."""

import dataclasses
import difflib
from collections.abc import Mapping

import equinox as eqx
import numpy as np
from jaxtyping import Array

from ._case import Case
from ._casekeys import FORCE, LAWS, POSITIVE, SECTIONS, Quantity, Range, Section
from ._caseleaves import labels
from ._forces import ExponentialLaw
from ._units import parse, show

Number = float | str
"""A number in SI units, or a text with a unit: 0.018, "18 um"."""


def valid_names(case: Case) -> list[str]:
    """The names of all numbers of `case`: those of a case file, with the axis where there is one number per axis."""
    return list(_places(case))


def value_of(case: Case, name: str) -> float:
    """The number called `name` in SI units. Raises `ValueError` for an unknown name."""
    section, key, index = _place(case, name)
    return float(getattr(_part(case, section), key)[index])


def quantity_of(case: Case, name: str) -> Quantity:
    """Unit and range of the number called `name`; where the unit has an exponent that depends on the force law, with that
    exponent as a number. Raises `ValueError` for an unknown name."""
    quantity = _quantity(case, name)
    return dataclasses.replace(quantity, unit=quantity.resolved(None, _table(case))[1])


def read_value(case: Case, name: str, value: Number, label: str | None = None) -> float:
    """`value`, a number or a text with a unit, as the SI value of the number called `name`.

    Messages call it `label`, by default its name. Raises `ValueError` for an unknown name, a unit of another kind and what
    is not one number. The range of the quantity is not looked at.
    """
    label = name if label is None else label
    number = parse(label, *_quantity(case, name).resolved(value, _table(case)))
    if not isinstance(number, float):
        raise ValueError(f"{label}: {show(value)} given; it must be one number")
    return number


def replace(case: Case, values: Mapping[str, Array]) -> Case:
    """`case` with the numbers of these names replaced by SI values. Differentiable. Nothing else changes: `cut.start` stays
    where it is with another `tool.diameter`. Raises `ValueError` for an unknown name."""
    leaves = _leaves(case)
    changed: dict[tuple[str, str], Array] = {}
    for name, value in values.items():
        section, key, index = _place(case, name)
        leaf = changed.get((section, key), leaves[section, key])
        changed[section, key] = leaf.at[index].set(value)
    return eqx.tree_at(lambda c: [getattr(_part(c, s), k) for s, k in changed], case, list(changed.values()))


def _quantity(case: Case, name: str) -> Quantity:
    """What the table of case-file keys says about a number."""
    section, key, index = _place(case, name)
    quantity = _tables(case)[section].keys[key]
    assert isinstance(quantity, Quantity)
    if (section, key) == ("structure", "stiffness") and quantity.range == Range():
        # A matrix may hold negative entries; the numbers that have names are diagonal, and those hold the tool.
        return dataclasses.replace(quantity, range=POSITIVE)
    if (section, key) == ("robot", "joints"):
        assert case.robot is not None
        lower, upper = case.robot.robot.limits
        return dataclasses.replace(quantity, range=Range(float(lower[index[0]]), float(upper[index[0]])))
    return quantity


def _table(case: Case) -> dict[str, float]:
    """What the unit of a force coefficient may depend on: the exponent of its law."""
    return {"m": float(case.force.m)} if isinstance(case.force, ExponentialLaw) else {}


def _tables(case: Case) -> dict[str, Section]:
    """What the case file may say; of the force what its law may. The numbers of a law that no case file knows, one of the
    user's own, have no names."""
    known = next((FORCE[law] for law, kind in LAWS.items() if isinstance(case.force, kind)), None)
    tables = {section: known if section == "force" else table for section, table in SECTIONS.items()}
    return {section: table for section, table in tables.items() if table is not None}


Place = tuple[str, str, tuple[int, ...]]
"""Section and key of a case file, and the index of the number within the leaf."""


def _leaves(case: Case) -> dict[tuple[str, str], Array]:
    """Every leaf that is a number, or numbers, of the case file."""
    return {
        (section, key): leaf
        for section, table in _tables(case).items()
        for key, kind in table.keys.items()
        if kind.parameter and (part := _part(case, section)) is not None and (leaf := getattr(part, key)) is not None
    }


def _part(case: Case, section: str):
    """The object that holds the numbers of a section of the case file, None where the case has none such."""
    if section == "structure" and case.robot is not None:
        return None
    found = case
    for name in section.split("."):
        found = None if found is None else getattr(found, name)
    return found


def _places(case: Case) -> dict[str, Place]:
    places: dict[str, Place] = {}
    for (section, key), leaf in _leaves(case).items():
        shape = np.shape(leaf)
        if shape == ():
            places[f"{section}.{key}"] = (section, key, ())
        elif len(shape) == 1:
            for i, part in enumerate(_parts(case, section, key, shape[0])):
                places[f"{section}.{key}.{part}"] = (section, key, (i,))
        elif len(shape) == 3:
            for index in np.ndindex(shape):
                places[".".join((section, key, *labels(section, key, index, {})))] = (section, key, index)
    return places


def _parts(case: Case, section: str, key: str, n: int) -> list[str]:
    """Names of the n numbers of a leaf: directions, joints, modes, or numbers from 0 of teeth and of coordinates without
    direction."""
    table = {}
    if section == "structure":
        s = case.at_tool
        table = {"axes": s.axes} if s.mode_shapes is None else {"axes": s.axes, "mode_shapes": s.mode_shapes}
    return [labels(section, key, (i,), table)[0] for i in range(n)]


def _place(case: Case, name: str) -> Place:
    places = _places(case)
    if name in places:
        return places[name]
    whole = name if name in {f"{section}.{key}" for section, key in _leaves(case)} else name.rpartition(".")[0]
    members = [known for known in places if known.startswith(f"{name}.")]
    shapes = {f"{section}.{key}": np.shape(leaf) for (section, key), leaf in _leaves(case).items()}
    if len(shapes.get(whole, ())) == 2:
        way_out = "; give one number per axis" if whole.startswith("structure.") else ""
        raise ValueError(f"{name}: the case gives {whole} as a matrix, whose entries have no names{way_out}")
    if members:
        one = name.startswith("structure.") or name == "robot.damping_ratio"
        way_out = ", or give one number for all in the case" if one else ""
        raise ValueError(
            f"{name}: the case gives {len(members)} numbers; name them one by one: {', '.join(members)}{way_out}"
        )
    if whole in places:
        each = "mode" if whole == "robot.damping_ratio" else "axis"
        every = {"mode": "modes", "axis": "axes"}[each]
        raise ValueError(
            f"{name}: the case gives one number for all {every}; name it {whole}, or give a list with one number per {each} "
            "in the case"
        )
    near = difflib.get_close_matches(name, places, n=1, cutoff=0.5)
    suggestion = f"did you mean {near[0]}?" if near else "this is no number of the case."
    raise ValueError(f"{name}: unknown parameter; {suggestion} Valid: {', '.join(places)}")
