"""Quantities at the border: text with a unit in, SI numbers out, and back.

pint is imported, and its registry built, at the first use: `import millax` needs neither.
"""

import functools
import math
import re
from typing import Any

NUMBER = r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?"
"""Pattern of a number in a text."""

UNIT = r"(?:[^\W\d]|[%°]|1/).*?"
"""Pattern of a unit in a text, to be matched to the end of it."""

_NUMBER_AND_UNIT = re.compile(rf"\s*({NUMBER})\s*({UNIT})?\s*")

EXPONENT = "(1+m)"
"""In a unit: an exponent that depends on another number, as in "N/m^(1+m)" for a force that grows with h^m."""

_EXAMPLES = {
    "": "0.05",
    "m": "10 mm",
    "m/s": "4 m/min",
    "rad/s": "10000 rpm",
    "rad": "30 deg",
    "s": "2 s",
    "N": "100 N",
    "N/m": "0.3 N/um",
    "N/m^2": "5000 N/mm^2",
    "N s/m": "500 N s/m",
    "kg": "100 kg",
}


class UnitError(ValueError):
    """A text that is not a quantity of the expected kind."""


def parse(key: str, value: Any, unit: str) -> Any:
    """`value` in SI units: a float, or nested lists of floats in the shape of `value`.

    **Arguments:**

    - `key`: the name of the value, for messages.
    - `value`: a number (SI), a text with a number and a unit ("18 um"), or lists of these.
    - `unit`: the SI unit expected ("N/m^2"); "" for a number without unit, of which a percentage is one.

    Raises `UnitError` (a `ValueError`) naming the key, what was given and what is expected, for a text that is not a
    quantity, a unit of another kind, a number that is not finite, and anything that is not a number. Angles are told
    apart from plain numbers, so that an angular speed in Hz is an error and not a factor 2 pi.
    """
    if isinstance(value, list | tuple):
        return [parse(f"{key}[{i}]", item, unit) for i, item in enumerate(value)]
    if isinstance(value, str):
        number = _from_text(key, value, unit)
    elif isinstance(value, int | float) and not isinstance(value, bool):
        number = float(value)
    else:
        raise UnitError(f"{key}: {show(value)} given; it must be {expected(unit)}")
    if not math.isfinite(number):
        raise UnitError(f"{key}: {show(value)} given; the number must be finite")
    return number


def express(value: float, unit: str) -> float:
    """The SI number `value` in `unit`: express(0.018, "mm") is 18."""
    return value / si_scale(unit)


def si_scale(unit: str) -> float:
    """One `unit` in SI units; 1 for one with an open exponent, which is SI. Raises `UnitError` for an unknown unit."""
    if unit == f"N/m^{EXPONENT}":
        return 1.0
    return _in_base_units(unit)[0]


def written_unit(value: Any, unit: str) -> str:
    """The unit in which `value` is written: that of its text, or the SI `unit` of a bare number."""
    if isinstance(value, str):
        match = _NUMBER_AND_UNIT.fullmatch(value)
        return (match and match[2]) or unit
    return unit


def show(value: Any) -> str:
    """`value` as a TOML file writes it."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str):
        return f'"{value}"'
    if isinstance(value, list | tuple):
        return "[" + ", ".join(show(item) for item in value) + "]"
    return str(value)


def in_mm(length) -> str:
    """A length [m] for a message: "20 mm"."""
    return f"{1e3 * float(length):.4g} mm"


def expected(unit: str) -> str:
    """What a value of this unit looks like, in words."""
    if not unit:
        return f"a number without unit, such as {_EXAMPLES['']}"
    return f'a number with a unit, such as "{_EXAMPLES.get(unit, f"1 {unit}")}" (a bare number is in {unit})'


def _from_text(key: str, text: str, unit: str) -> float:
    match = _NUMBER_AND_UNIT.fullmatch(text)
    if not match:
        raise UnitError(f"{key}: {show(text)} given; it must be {expected(unit)}")
    number, written = float(match[1]), match[2] or ""
    if unit and not written:
        raise UnitError(f"{key}: {show(text)} given, without a unit; it must be {expected(unit)}")
    try:
        scale, kind = _in_base_units(written)
    except UnitError as error:
        raise UnitError(f"{key}: {show(text)} given; {error}. It must be {expected(unit)}") from None
    if kind != _in_base_units(unit)[1]:
        wanted = f"cannot be converted to {unit}" if unit else "does not belong here"
        raise UnitError(f"{key}: {show(text)} given; the unit {written} {wanted}. It must be {expected(unit)}")
    return number * scale


@functools.cache
def _registry():
    import pint

    return pint.UnitRegistry()


@functools.cache
def _in_base_units(unit: str) -> tuple[float, Any]:
    """One `unit` in SI base units, as a number and as a pint unit in which the radian is kept."""
    quantity = _registry().Quantity
    try:
        parsed = _registry().parse_units(unit)
        one, zero = (quantity(x, parsed).to_base_units() for x in (1.0, 0.0))
    except Exception:  # pint lets errors of its tokenizer, assertions included, through as they are
        raise UnitError(f"{unit} is not a unit that is known") from None
    if zero.magnitude != 0:
        raise UnitError(f"{unit} has an offset or a logarithm in it")
    return one.magnitude, one.units
