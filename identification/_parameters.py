"""Which numbers of a case are free, and the way from a vector of coordinates to a case that holds them."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from millax import Case
from millax._casekeys import Quantity
from millax._names import Number, quantity_of, read_value, replace, valid_names, value_of
from millax._types import as_number
from millax._units import EXPONENT, express, parse, si_scale, written_unit

from ._transforms import Transform, transform_for


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


def _check(case: Case, parameter: Parameter) -> tuple[Transform, float, float, float, str]:
    name = parameter.name
    quantity = quantity_of(case, name)
    si_unit = quantity.unit
    guess = value_of(case, name) if parameter.guess is None else read_value(case, name, parameter.guess)
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
        limit if bound is None else read_value(case, name, bound, f"bounds of {name}")
        for bound, limit in zip(bounds, (quantity.range.low, quantity.range.high), strict=True)
    )
    if low < quantity.range.low or high > quantity.range.high:
        raise ValueError(f"bounds of {name}: {low:g} to {high:g} {quantity.unit} given; it must be {quantity.range}")
    return low, high


def _show(value: float, unit: str) -> str:
    return f"{value / si_scale(unit):.6g} {unit}".strip() if math.isfinite(value) else f"{value:g}"
