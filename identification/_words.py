"""Numbers as a person writes them."""

import math
import re

_RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


def plain(value: float, digits: int = 4) -> str:
    """`value` with so many significant digits: 0.01800, 5000, 4.970·10⁹."""
    if not math.isfinite(value) or value == 0:
        return f"{value:g}"
    exponent = math.floor(math.log10(abs(value)))
    if -4 <= exponent < 6:
        return f"{value:.{max(digits - 1 - exponent, 0)}f}"
    return f"{value / 10.0**exponent:.{digits - 1}f}{power(exponent)}"


def with_error(value: float, std: float | None) -> str:
    """`value ± std`, both to the second digit of the standard error; the value alone where there is none."""
    if std is None or not std > 0 or not math.isfinite(std):
        return plain(value)
    return _together([value, std], std, " ± ")


def interval(ends: tuple[float, float]) -> str:
    """`low … high`, to the second digit of a quarter of the width: the digits of the standard error."""
    low, high = ends
    return _together([low, high], (high - low) / 4, " … ") if high > low else f"{plain(low)} … {plain(high)}"


def _together(values: list[float], resolution: float, between: str) -> str:
    """Numbers with one power of ten and as many decimals as the second digit of `resolution` needs."""
    largest = math.floor(math.log10(max(map(abs, values))))
    exponent = 0 if -4 <= largest < 6 else largest
    decimals = max(exponent - math.floor(math.log10(resolution)) + 1, 0)
    text = between.join(f"{value / 10.0**exponent:.{decimals}f}" for value in values)
    return f"({text}){power(exponent)}" if exponent else text


def unit_words(unit: str) -> str:
    """A unit as it is printed: N/mm², µm."""
    raised = re.sub(r"(?:\^|\*\*)(-?\d+)", lambda match: match[1].translate(_RAISED), unit)
    return re.sub(r"\bu(?=[a-zA-Z])", "µ", raised)


def power(exponent: int) -> str:
    """A power of ten: ·10⁻⁶."""
    return "·10" + str(exponent).translate(_RAISED)
