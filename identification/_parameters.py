"""Which numbers of a case are free, and the way from a vector of coordinates to a case that holds them."""

import difflib
import math
from collections.abc import Sequence
from dataclasses import dataclass

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from millax import Case, ExponentialLaw
from millax._casekeys import FORCE, LAWS, POSITIVE, SECTIONS, Quantity, Range
from millax._types import AXES, as_number
from millax._units import EXPONENT, express, parse, si_scale, written_unit

from ._transforms import Transform, transform_for

Number = float | str
"""A number in SI units, or a text with a unit: 0.018, "18 um"."""


@dataclass(frozen=True)
class Parameter:
    """A number of the case to be found by a fit.

    **Arguments:**

    - `name`: as in a case file: "force.k0", "structure.stiffness.y".
    - `guess`: where the fit starts. None: the case's own value.
    - `bounds`: (lower, upper), None for no bound on that side. The guess lies strictly between. Where the quantity
      itself has a limit (a stiffness is positive), that limit is a bound too.
    - `unit`: in which the estimate is given. None: the unit of the guess, SI if that has none.
    """

    name: str
    guess: Number | None = None
    bounds: tuple[Number | None, Number | None] = (None, None)
    unit: str | None = None


class FreeParameters(eqx.Module):
    """The free numbers of a case and their transforms, in a fixed order.

    A pytree whose numbers may change without a new compilation. `low` and `high` are the bounds in SI units, infinite
    where there is none; `units` are those in which estimates are shown.
    """

    transforms: tuple[Transform, ...]
    guess: Float[Array, " n"] = eqx.field(converter=as_number)
    low: Float[Array, " n"] = eqx.field(converter=as_number)
    high: Float[Array, " n"] = eqx.field(converter=as_number)
    names: tuple[str, ...] = eqx.field(static=True)
    units: tuple[str, ...] = eqx.field(static=True)

    def __len__(self):
        return len(self.names)

    def values(self, y: Float[Array, " n"]) -> Float[Array, " n"]:
        """The parameters in SI units at the coordinates `y`; the guess at y = 0."""
        return jnp.stack([transform(y[i]) for i, transform in enumerate(self.transforms)])

    def slopes(self, y: Float[Array, " n"]) -> Float[Array, " n"]:
        """dv/dy of each parameter."""
        return jnp.stack([jax.grad(transform)(y[i]) for i, transform in enumerate(self.transforms)])

    def insert(self, case: Case, y: Float[Array, " n"]) -> Case:
        """`case` with the free numbers replaced by their values at `y`. Differentiable."""
        return replace(case, dict(zip(self.names, self.values(y), strict=True)))

    def shown(self, i: int, value: float) -> float:
        """A value of parameter `i` in the unit in which it is shown."""
        return express(value, self.units[i])


def free(case: Case, parameters: Sequence[Parameter]) -> FreeParameters:
    """Check `parameters` against `case`.

    Raises `ValueError` for an unknown name (the nearest valid one suggested), a name given twice, a guess that is not
    strictly within its bounds, bounds outside the range of the quantity, and units that do not fit.
    """
    if not parameters:
        raise ValueError(f"no free parameters given; choose from {', '.join(valid_names(case))}")
    names = tuple(parameter.name for parameter in parameters)
    for name in names:
        if names.count(name) > 1:
            raise ValueError(f"{name}: given twice as a free parameter; give it once")
    parts = [_check(case, parameter) for parameter in parameters]
    transforms, guess, low, high, units = zip(*parts, strict=True)
    return FreeParameters(transforms, guess, low, high, names, units)


def valid_names(case: Case) -> list[str]:
    """The names of all numbers of `case` that can be free."""
    return list(_places(case))


def value_of(case: Case, name: str) -> float:
    """The number called `name` in SI units. Raises `ValueError` for an unknown name."""
    section, key, index = _place(case, name)
    return float(getattr(getattr(case, section), key)[index])


def read_value(case: Case, name: str, value: Number) -> float:
    """`value`, a number or a text with a unit, as the SI value of the parameter `name`."""
    section, key, _ = _place(case, name)
    return _number(case, name, value, _quantity(case, section, key))


def replace(case: Case, values: dict[str, Array]) -> Case:
    """`case` with the numbers of these names replaced. Differentiable."""
    leaves = _leaves(case)
    changed: dict[tuple[str, str], Array] = {}
    for name, value in values.items():
        section, key, index = _place(case, name)
        leaf = changed.get((section, key), leaves[section, key])
        changed[section, key] = leaf.at[index].set(value)
    return eqx.tree_at(lambda c: [getattr(getattr(c, s), k) for s, k in changed], case, list(changed.values()))


def _check(case: Case, parameter: Parameter) -> tuple[Transform, float, float, float, str]:
    name = parameter.name
    section, key, _ = _place(case, name)
    quantity = _quantity(case, section, key)
    guess = value_of(case, name) if parameter.guess is None else _number(case, name, parameter.guess, quantity)
    si_unit = quantity.resolved(None, _table(case))[1]
    unit = parameter.unit if parameter.unit is not None else written_unit(parameter.guess, si_unit)
    if unit != si_unit and EXPONENT not in unit:
        parse(f"unit of {name}", f"1 {unit}", si_unit)
    if EXPONENT in unit:  # the scale of such a unit changes with the exponent; SI it is
        unit = si_unit
    low, high = _bounds(case, name, parameter.bounds, quantity)
    if not low < guess < high:
        where = f"between {_show(low, unit)} and {_show(high, unit)}"
        raise ValueError(f"{name}: the guess {_show(guess, unit)} must lie strictly {where}; move the guess or the bounds")
    return transform_for(guess, low, high), guess, low, high, unit


def _bounds(case: Case, name: str, bounds, quantity: Quantity) -> tuple[float, float]:
    if len(bounds) != 2:
        raise ValueError(f"bounds of {name}: {len(bounds)} given; they are two, a lower and an upper one")
    low, high = (
        limit if bound is None else _number(case, f"bounds of {name}", bound, quantity)
        for bound, limit in zip(bounds, (quantity.range.low, quantity.range.high), strict=True)
    )
    if low < quantity.range.low or high > quantity.range.high:
        raise ValueError(f"bounds of {name}: {low:g} to {high:g} {quantity.unit} given; it must be {quantity.range}")
    return low, high


def _number(case: Case, name: str, value: Number, quantity: Quantity) -> float:
    number = parse(name, *quantity.resolved(value, _table(case)))
    if not isinstance(number, float):
        raise ValueError(f"{name}: {value!r} given; it must be one number")
    return number


def _show(value: float, unit: str) -> str:
    return f"{value / si_scale(unit):.6g} {unit}".strip() if math.isfinite(value) else f"{value:g}"


def _quantity(case: Case, section: str, key: str) -> Quantity:
    """What the table of case-file keys says about a leaf."""
    keys = (FORCE[_law(case)] if section == "force" else SECTIONS[section]).keys
    quantity = keys[key]
    assert isinstance(quantity, Quantity)
    if (section, key) == ("structure", "stiffness") and quantity.range == Range():
        # A matrix may hold negative entries; the numbers that can be free are diagonal, and those hold the tool.
        return Quantity(quantity.unit, POSITIVE, quantity.shape)
    return quantity


def _table(case: Case) -> dict[str, float]:
    """What the unit of a force coefficient may depend on: the exponent of its law."""
    return {"m": float(case.force.m)} if isinstance(case.force, ExponentialLaw) else {}


def _law(case: Case) -> str:
    return next(law for law, kind in LAWS.items() if type(case.force) is kind)


Place = tuple[str, str, tuple[int, ...]]
"""Section and key of a case file, and the index of the number within the leaf."""


def _leaves(case: Case) -> dict[tuple[str, str], Array]:
    """Every leaf that is a number, or numbers, of the case file."""
    tables = {section: (FORCE[_law(case)] if section == "force" else table) for section, table in SECTIONS.items()}
    return {
        (section, key): leaf
        for section, table in tables.items()
        for key, kind in table.keys.items()
        if kind.parameter and (leaf := getattr(getattr(case, section), key)) is not None
    }


def _places(case: Case) -> dict[str, Place]:
    places: dict[str, Place] = {}
    for (section, key), leaf in _leaves(case).items():
        shape = np.shape(leaf)
        if shape == ():
            places[f"{section}.{key}"] = (section, key, ())
        elif len(shape) == 1:
            for i, part in enumerate(_parts(case, section, shape[0])):
                places[f"{section}.{key}.{part}"] = (section, key, (i,))
    return places


def _parts(case: Case, section: str, n: int) -> list[str]:
    """Names of the n numbers of a leaf: directions, or numbers from 0 where the coordinates are not directions."""
    if section != "structure":
        return list(AXES[:n])
    return list(case.structure.axes) if case.structure.mode_shapes is None else [str(i) for i in range(n)]


def _place(case: Case, name: str) -> Place:
    places = _places(case)
    if name in places:
        return places[name]
    whole = ".".join(name.split(".")[:2])
    members = [known for known in places if known.startswith(f"{name}.")]
    shapes = {f"{section}.{key}": np.shape(leaf) for (section, key), leaf in _leaves(case).items()}
    if len(shapes.get(whole, ())) == 2:
        raise ValueError(f"{name}: the case gives {whole} as a matrix; the entries of a matrix cannot be free")
    if members:
        raise ValueError(
            f"{name}: the case gives {len(members)} numbers; free them one by one as {', '.join(members)}, or give one "
            "number for all in the case"
        )
    if whole in places:
        raise ValueError(
            f"{name}: the case gives one number for all axes; free it as {whole}, or give a list with one number per "
            "axis in the case"
        )
    near = difflib.get_close_matches(name, places, n=1, cutoff=0.5)
    suggestion = f"did you mean {near[0]}?" if near else "this is no number of the case."
    raise ValueError(f"{name}: unknown parameter; {suggestion} Valid: {', '.join(places)}")
