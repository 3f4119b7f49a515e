"""The values that a number of a case takes in a sweep: written as a text, as a list, or drawn at random."""

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float

from ._units import NUMBER, UNIT, show

_SERIES = re.compile(rf"\s*({NUMBER}(?:\s*[:,]\s*{NUMBER})*)\s*({UNIT})?\s*")
_NORMAL = re.compile(rf"\s*({NUMBER})\s*(?:±|\+-|\+/-)\s*({NUMBER})\s*({UNIT})?\s*")

GRID_FORMS = (
    '"4000:16000:49 rpm" (from, to, how many), "0.5, 1, 2 mm" (a list) or "0.1 mm" (one value); in Python also numbers in SI'
)
SAMPLE_FORMS = '"4000:6000 N/mm^2" (uniform from, to) or "5000 ± 100 N/mm^2" (normal: mean and standard deviation)'


@dataclass(frozen=True, eq=False)
class Values:
    """Numbers with their unit.

    - `numbers`: one number, or an array of shape (n,), in `unit`.
    - `unit`: as it is written ("N/mm^2"), "" for numbers without unit; None: SI.
    """

    numbers: Float[np.ndarray, "..."]
    unit: str | None = None

    def __len__(self):
        return len(self.numbers)

    def __array__(self, dtype=None, copy=None):
        return np.array(self.numbers, dtype=dtype, copy=copy)


Given = Values | str | float | Sequence[float] | Sequence[str] | np.ndarray
"""Everything that stands for values of a number: "4000:16000:49 rpm", [1e-3, 2e-3], 0.3."""


def read(name: str, given: Given) -> Values:
    """The values that `given` stands for. Raises `ValueError`, which says what is allowed, for a text of no known form, an
    empty list, and what is not a number or not finite."""
    if isinstance(given, str):
        values = _from_text(name, given)
    elif isinstance(given, Values):
        values = Values(np.asarray(given.numbers, dtype=float), given.unit)
    elif isinstance(given, list | tuple) and given and all(isinstance(item, str) for item in given):
        values = _from_texts(name, [str(item) for item in given])
    else:
        try:
            values = Values(np.array(given, dtype=float))
        except (TypeError, ValueError):
            raise ValueError(f"{name}: {_short(given)} given; it takes {GRID_FORMS}") from None
    if values.numbers.ndim > 1:
        raise ValueError(f"{name}: an array of shape {values.numbers.shape} given; it must have one dimension")
    if values.numbers.size == 0:
        raise ValueError(f"{name}: no value given; it takes {GRID_FORMS}")
    if not np.isfinite(values.numbers).all():
        bad = np.flatnonzero(~np.isfinite(np.atleast_1d(values.numbers)))
        first = np.atleast_1d(values.numbers)[bad[0]]
        raise ValueError(f"{name}: {first} given at position {bad[0]}; every value must be finite")
    return values


def sample(
    ranges: Mapping[str, str],
    number: int,
    *,
    seed: int = 0,
    method: Literal["latin hypercube", "sobol"] = "latin hypercube",
    correlation: Float[np.ndarray, "n n"] | None = None,
) -> dict[str, Values]:
    """Random values of several numbers at once, for `millax.sweep(case, samples=...)`.

    **Arguments:**

    - `ranges`: by name, "4000:6000 N/mm^2" for a uniform distribution between two ends, or "5000 ± 100 N/mm^2" (also
      "5000 +- 100 N/mm^2") for a normal one with this mean and standard deviation.
    - `number`: how many, >= 1.
    - `seed`: of the random numbers; the same seed gives the same values.
    - `method`: "latin hypercube" fills the range of every number evenly; "sobol" (scrambled) fills all of them together
      more evenly still, for a power of two.
    - `correlation`: of the numbers, in the order of `ranges`: symmetric, positive definite, with ones on its diagonal. For
      normal distributions it is their correlation; for uniform ones that of the normal numbers they are made of. None:
      independent.

    **Returns:** `Values` of shape (number,) by name, in the units of `ranges`.

    Raises `ValueError` for a text of another form, an empty range, a standard deviation that is not positive, and a
    correlation that is none.
    """
    from scipy import stats

    if isinstance(number, bool) or not isinstance(number, int) or number < 1:
        raise ValueError(f"number: {number!r} given; it must be a whole number of at least 1")
    if not ranges:
        raise ValueError(f"ranges: none given; each takes {SAMPLE_FORMS}")
    spreads = {name: _spread(name, text) for name, text in ranges.items()}
    engines = {"latin hypercube": stats.qmc.LatinHypercube, "sobol": stats.qmc.Sobol}
    if method not in engines:
        raise ValueError(f"method: {show(method)} given; it must be one of {', '.join(map(show, engines))}")
    uniform = engines[method](len(spreads), rng=np.random.default_rng(seed)).random(number)
    if correlation is not None:
        # A Sobol sequence may hold 0, which a normal number cannot be made of.
        normal = stats.norm.ppf(np.clip(uniform, 1e-12, 1 - 1e-12))
        uniform = stats.norm.cdf(normal @ _root(correlation, len(spreads)).T)
    return {
        name: Values(low + (high - low) * u, unit)
        if kind == "uniform"
        else Values(stats.norm.ppf(np.clip(u, 1e-12, 1 - 1e-12), low, high), unit)
        for (name, (kind, low, high, unit)), u in zip(spreads.items(), uniform.T, strict=True)
    }


def _from_text(name: str, text: str) -> Values:
    match = _SERIES.fullmatch(text)
    if not match or (":" in match[1] and "," in match[1]):
        raise ValueError(f"{name}: {show(text)} given; it takes {GRID_FORMS}")
    unit = match[2] or ""
    if ":" not in match[1]:
        numbers = [float(item) for item in match[1].split(",")]
        return Values(np.array(numbers if len(numbers) > 1 else numbers[0]), unit)
    parts = match[1].split(":")
    if len(parts) == 2:
        raise ValueError(
            f"{name}: {show(text)} given, without how many; write {show(_with_count(parts, unit))} for 20 values"
        )
    low, high = float(parts[0]), float(parts[1])
    if len(parts) > 3 or not parts[2].strip().isdigit() or int(parts[2]) < 2:
        raise ValueError(f"{name}: {show(text)} given; after from and to comes how many, a whole number of at least 2")
    if low == high:
        raise ValueError(f"{name}: {show(text)} given; the two ends are the same")
    return Values(np.linspace(low, high, int(parts[2])), unit)


def _with_count(parts: list[str], unit: str) -> str:
    return f"{parts[0].strip()}:{parts[1].strip()}:20 {unit}".strip()


def _from_texts(name: str, texts: list[str]) -> Values:
    numbers, units = [], set()
    for text in texts:
        values = _from_text(name, text)
        if values.numbers.ndim or len(units | {values.unit}) > 1:
            raise ValueError(f"{name}: {_short(texts)} given; a list takes one number each, all with the same unit")
        numbers.append(float(values.numbers))
        units.add(values.unit)
    return Values(np.array(numbers), units.pop())


def _spread(name: str, text: str) -> tuple[str, float, float, str]:
    """ "uniform" with its ends or "normal" with mean and standard deviation, and the unit."""
    if isinstance(text, str):
        if match := _NORMAL.fullmatch(text):
            mean, std = float(match[1]), float(match[2])
            if not (std > 0 and math.isfinite(std)):
                raise ValueError(f"{name}: {show(text)} given; the standard deviation must be greater than 0")
            return "normal", mean, std, match[3] or ""
        match = _SERIES.fullmatch(text)
        if match and match[1].count(":") == 1 and "," not in match[1]:
            low, high = map(float, match[1].split(":"))
            if not low < high:
                raise ValueError(f"{name}: {show(text)} given; the first end must be the smaller")
            return "uniform", low, high, match[2] or ""
    raise ValueError(f"{name}: {_short(text)} given; it takes {SAMPLE_FORMS}")


def _root(correlation, n: int) -> Float[np.ndarray, "n n"]:
    """L with L L^T the correlation."""
    matrix = np.asarray(correlation, dtype=float)
    if matrix.shape != (n, n) or not np.allclose(np.diag(matrix), 1) or not np.allclose(matrix, matrix.T):
        raise ValueError(
            f"correlation: an array of shape {matrix.shape} given; it must be symmetric, {n} by {n}, ones on its diagonal"
        )
    try:
        return np.linalg.cholesky(matrix)
    except np.linalg.LinAlgError:
        raise ValueError("correlation: it is not positive definite; no numbers are correlated like this") from None


def _short(value) -> str:
    text = show(value)
    return text if len(text) <= 80 else f"{text[:77]}..."
