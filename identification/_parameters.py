"""Which numbers of the cases are free, and the way from a vector of coordinates to cases that hold them."""

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
class Prior:
    """What is known of a number before anything is measured: it is normal about `mean`, or its logarithm is.

    It counts in a fit as one more measurement would, of the number itself.

    **Arguments:**

    - `mean`: [unit of the number]; the median, where `factor` is given.
    - `std`: standard deviation [unit of the number]; or
    - `factor`: > 1 [-]: the number is within this factor of `mean` with 68 %. Exactly one of the two is given.
    """

    mean: Number
    std: Number | None = None
    factor: float | None = None


@dataclass(frozen=True)
class Parameter:
    """A number of the case to be found by a fit.

    **Arguments:**

    - `name`: as in a case file: "force.k0", "structure.stiffness.y".
    - `guess`: where the fit starts. None: the case's own value.
    - `bounds`: (lower, upper), None for no bound on that side. The guess lies strictly between. Where the quantity
      itself has a limit (a stiffness is positive), that limit is a bound too. With one bound the fit goes by the logarithm
      of the distance to it, with two by the logit.
    - `unit`: in which the estimate is given. None: the unit of the guess, SI if that has none.
    - `prior`: what is known of it. None: nothing.
    - `each`: whether it has a value of its own in every trace, called "force.k0.trace_1" and so on, and not one in all of
      them. Without a `guess` each starts from the value of its own case.
    """

    name: str
    guess: Number | None = None
    bounds: tuple[Number | None, Number | None] = (None, None)
    unit: str | None = None
    prior: Prior | None = None
    each: bool = False


@dataclass(frozen=True)
class Tie:
    """A number of the case that follows a free one: `name` = `factor` times `to`.

    **Arguments:**

    - `name`: of the number, which must not be free itself.
    - `to`: of the free one; where that has a value in each trace, this one has too.
    - `factor`: [unit of `name` over unit of `to`, SI].
    """

    name: str
    to: str
    factor: float = 1.0


class Known(eqx.Module):
    """Priors in numbers: of which coordinates, centres and widths, of the logarithm where `log`."""

    of: tuple[int, ...] = eqx.field(static=True)
    log: tuple[bool, ...] = eqx.field(static=True)
    centre: Float[Array, " k"] = eqx.field(converter=as_number)
    width: Float[Array, " k"] = eqx.field(converter=as_number)

    def residuals(self, values: Float[Array, " n"]) -> Float[Array, " k"]:
        """By how many standard deviations the values are off."""
        seen = [jnp.log(values[i]) if log else values[i] for i, log in zip(self.of, self.log, strict=True)]
        return (jnp.stack(seen) - self.centre) / self.width if seen else jnp.zeros(0)


class FreeParameters(eqx.Module):
    """The free numbers of some cases and their transforms, in a fixed order.

    A pytree whose numbers may change without a new compilation. `low` and `high` are the bounds in SI units, infinite
    where there is none; `units` are those in which estimates are shown. `leaves` are the names of the numbers in their case
    and `places` says in which case, None for all; `names` are those two in one. `ties` are (leaf, place, coordinate), with
    `factors`.
    """

    transforms: tuple[Transform, ...]
    guess: Float[Array, " n"] = eqx.field(converter=as_number)
    low: Float[Array, " n"] = eqx.field(converter=as_number)
    high: Float[Array, " n"] = eqx.field(converter=as_number)
    names: tuple[str, ...] = eqx.field(static=True)
    units: tuple[str, ...] = eqx.field(static=True)
    leaves: tuple[str, ...] = eqx.field(static=True)
    places: tuple[int | None, ...] = eqx.field(static=True)
    ties: tuple[tuple[str, int | None, int], ...] = eqx.field(static=True)
    factors: Float[Array, " ties"] = eqx.field(converter=as_number)
    known: Known

    def __len__(self):
        return len(self.names)

    def values(self, y: Float[Array, " n"]) -> Float[Array, " n"]:
        """The parameters in SI units at the coordinates `y`; the guess at y = 0."""
        return jnp.stack([transform(y[i]) for i, transform in enumerate(self.transforms)])

    def coordinates(self, values: Float[Array, " n"]) -> Float[Array, " n"]:
        """The coordinates y of parameters strictly within their bounds [SI]."""
        return jnp.stack([transform.inverse(values[i]) for i, transform in enumerate(self.transforms)])

    def slopes(self, y: Float[Array, " n"]) -> Float[Array, " n"]:
        """dv/dy of each parameter."""
        return jnp.stack([jax.grad(transform)(y[i]) for i, transform in enumerate(self.transforms)])

    def prior(self, y: Float[Array, " n"]) -> Float[Array, " k"]:
        """By how many standard deviations the parameters are off what was known of them."""
        return self.known.residuals(self.values(y))

    def insert(self, case: Case, y: Float[Array, " n"], place: int = 0) -> Case:
        """`case`, the one at `place`, with the free numbers replaced by their values at `y`. Differentiable."""
        values, here = self.values(y), (None, place)
        own = {leaf: values[i] for i, (leaf, at) in enumerate(zip(self.leaves, self.places, strict=True)) if at in here}
        tied = zip(self.ties, self.factors, strict=True)
        return replace(case, own | {leaf: factor * values[i] for (leaf, at, i), factor in tied if at in here})

    def shown(self, i: int, value: float) -> float:
        """A value of parameter `i` in the unit in which it is shown."""
        return express(value, self.units[i])


def free(cases: Case | Sequence[Case], parameters: Sequence[Parameter | Tie]) -> FreeParameters:
    """Check `parameters` against `cases`, of one trace each.

    Raises `ValueError` for an unknown name (the nearest valid one suggested), a name given twice, a guess that is not
    strictly within its bounds, bounds outside the range of the quantity, units that do not fit, a prior that is none, and a
    tie to what is not free.
    """
    cases = [cases] if isinstance(cases, Case) else list(cases)
    asked = [p for p in parameters if isinstance(p, Parameter)]
    if not asked:
        raise ValueError(f"no free parameters given; choose from {', '.join(valid_names(cases[0]))}")
    given = [parameter.name for parameter in parameters]
    for name in given:
        if given.count(name) > 1:
            raise ValueError(f"{name}: given twice as a free parameter; give it once")
    found = [one for parameter in asked for one in _coordinates(cases, parameter)]
    ties = [one for tie in parameters if isinstance(tie, Tie) for one in _tied(cases, tie, found)]
    known = [(i, one.prior) for i, one in enumerate(found) if one.prior is not None]
    return FreeParameters(
        transforms=tuple(transform_for(one.guess, one.low, one.high, one.spread) for one in found),
        guess=[one.guess for one in found],
        low=[one.low for one in found],
        high=[one.high for one in found],
        names=tuple(one.name for one in found),
        units=tuple(one.unit for one in found),
        leaves=tuple(one.leaf for one in found),
        places=tuple(one.place for one in found),
        ties=tuple((leaf, place, i) for leaf, place, i, _ in ties),
        factors=jnp.array([factor for *_, factor in ties]),
        known=Known(
            tuple(i for i, _ in known),
            tuple(log for _, (_, _, log) in known),
            jnp.array([centre for _, (centre, _, _) in known]),
            jnp.array([width for _, (_, width, _) in known]),
        ),
    )


@dataclass(frozen=True)
class _Coordinate:
    """One free number: its leaf and its place among the cases, None for all of them; its prior as (centre, width, log)."""

    leaf: str
    place: int | None
    guess: float
    low: float
    high: float
    unit: str
    prior: tuple[float, float, bool] | None

    @property
    def name(self) -> str:
        return self.leaf if self.place is None else f"{self.leaf}.trace_{self.place + 1}"

    @property
    def spread(self) -> float:
        """Standard deviation of the prior, 0 where there is none for the number itself."""
        return 0.0 if self.prior is None or self.prior[2] else self.prior[1]


def _coordinates(cases: Sequence[Case], parameter: Parameter) -> list[_Coordinate]:
    """One, or one of each case."""
    every = []
    for place, case in enumerate(cases):
        try:
            every.append(_check(case, parameter, place if parameter.each else None))
        except ValueError as error:
            raise ValueError(f"case {place + 1} of {len(cases)}: {error}" if place else str(error)) from error
    return every if parameter.each else every[:1]


def _check(case: Case, parameter: Parameter, place: int | None) -> _Coordinate:
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
    prior = None if parameter.prior is None else _prior(case, name, parameter.prior, low, high)
    return _Coordinate(name, place, guess, low, high, unit, prior)


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


def _prior(case: Case, name: str, prior: Prior, low: float, high: float) -> tuple[float, float, bool]:
    """Centre, width, and whether they are those of the logarithm."""
    mean = read_value(case, name, prior.mean, f"prior of {name}")
    if (prior.std is None) == (prior.factor is None):
        raise ValueError(f"prior of {name}: give std or factor, and only one of them")
    if not low < mean < high:
        raise ValueError(
            f"prior of {name}: its mean {mean:g} lies outside the bounds, {low:g} to {high:g}; move the one or the others"
        )
    if prior.factor is not None:
        if not prior.factor > 1:
            raise ValueError(f"prior of {name}: factor {prior.factor:g} given; it must be greater than 1")
        if not low >= 0:
            raise ValueError(f"prior of {name}: a factor is for numbers that are positive by their bounds; give std")
        return math.log(mean), math.log(prior.factor), True
    assert prior.std is not None
    std = read_value(case, name, prior.std, f"prior of {name}, std")
    if not std > 0:
        raise ValueError(f"prior of {name}: std {std:g} given; it must be greater than 0")
    return mean, std, False


def _tied(cases: Sequence[Case], tie: Tie, found: Sequence[_Coordinate]) -> list[tuple[str, int | None, int, float]]:
    """Leaf, place, coordinate and factor of a tie, one for each value of what it is tied to."""
    for case in cases:
        value_of(case, tie.name)  # raises for a name that is none
    bounds = quantity_of(cases[0], tie.name).range
    near = [i for i, one in enumerate(found) if one.leaf == tie.to]
    if not near:
        raise ValueError(f"{tie.name}: tied to {tie.to}, which is not free; free it, or tie to one of those that are")
    for i in near:
        ends = sorted(tie.factor * end for end in (found[i].low, found[i].high))
        if not (bounds.low <= ends[0] and ends[1] <= bounds.high) or not math.isfinite(tie.factor) or tie.factor == 0:
            raise ValueError(
                f"{tie.name}: {tie.factor:g} times {tie.to}, which goes from {found[i].low:g} to {found[i].high:g}, given; "
                f"it must be {bounds}"
            )
    return [(tie.name, found[i].place, i, tie.factor) for i in near]


def _show(value: float, unit: str) -> str:
    return f"{value / si_scale(unit):.6g} {unit}".strip() if math.isfinite(value) else f"{value:g}"
