"""The table [fit] of a case file: which numbers are free, and how they are found.

[fit.free]                              # the numbers to find
force.k0 = { guess = "10000 N/mm^2", bounds = ["1000 N/mm^2", "none"] }
force.kr = {}                           # start from the case's own value, without bounds
structure.damping_ratio.x = 0.1         # short for { guess = 0.1 }
structure.damping_ratio.y = { tie = "structure.damping_ratio.x", factor = 1.2 }     # follows another one
force.hs = { prior = { mean = "18 um", factor = 1.5 } }     # known before: or std = "3 um"
clock.start = { each = true }           # a value of its own in every trace

[fit]                                   # how: all of it may be left out
solver = "optimistix_lm"                # or optimistix_dogleg, optimistix_bfgs, scipy_trf, jaxopt_lm, jaxopt_lbfgsb
starts = 20                             # fit from so many starts, the guess among them
spread = 5                              # which differ from it by this factor at most
seed = 0                                # of all random numbers
profile = true                          # intervals by profile likelihood, too
posterior = 2000                        # draws of the posterior by NUTS
noise = { distribution = "student", degrees = 4, order = 1 }    # outliers; correlation in time, by so many terms

[fit.truth]                             # for synthetic data: what the estimates are compared with
force.k0 = "5000 N/mm^2"
"""

import difflib
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, fields
from typing import Any

from millax import CaseFile
from millax._names import Number, read_value, valid_names
from millax._units import show

from ._noise import NoiseModel
from ._options import Options
from ._parameters import Parameter, Prior, Tie

_FREE, _TIED = ("guess", "bounds", "prior", "each"), ("tie", "factor")
"""What may be said of a free number, and of one that follows another."""


@dataclass(frozen=True)
class Asked:
    """What the table [fit] asks: the free numbers, the truth by name, in SI, where it is known, and how."""

    parameters: tuple[Parameter | Tie, ...]
    truth: dict[str, float]
    options: Options


def asked_in(file: CaseFile) -> Asked:
    """What the table [fit] asks. Raises `ValueError`."""
    tables = file.tables.get("fit")
    if not isinstance(tables, Mapping):
        raise ValueError('the table [fit.free] is missing; it names the numbers to find: force.k0 = { guess = "..." }')
    how = [one.name for one in fields(Options)]
    check_keys("fit", tables, ("free", "truth", *how))
    known = valid_names(file.case)
    asked = dict(_flat("fit.free", tables.get("free", {}), known))
    truth = {name: read_value(file.case, name, value) for name, value in _flat("fit.truth", tables.get("truth", {}), known)}
    given = {name: tables[name] for name in how if name in tables}
    if "noise" in given:
        given["noise"] = _noise(given["noise"])
    parameters = tuple(_parameter(file, name, one) for name, one in asked.items())
    return Asked(parameters, truth, Options(**given))


def _noise(given: Any) -> NoiseModel:
    if not isinstance(given, Mapping):
        raise ValueError(
            f'noise: {show(given)} given; it must be a table, such as {{ distribution = "student", order = 1 }}'
        )
    check_keys("fit.noise", given, [one.name for one in fields(NoiseModel)])
    return NoiseModel(**given)


def _flat(table: str, given: Any, known: Collection[str], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Names and values of a table whose keys are dotted names, quoted or not."""
    if not isinstance(given, Mapping):
        raise ValueError(f"{table}: {show(given)} given; it must be a table, [{table}]")
    for key, value in given.items():
        name = f"{prefix}{key}"
        # An empty table is a free number, known or not, and no table of others.
        if isinstance(value, Mapping) and value and name not in known and not set(value) & {*_FREE, *_TIED}:
            yield from _flat(table, value, known, f"{name}.")
        else:
            yield name, value


def _parameter(file: CaseFile, name: str, given: Any) -> Parameter | Tie:
    if not isinstance(given, Mapping):
        return Parameter(name, guess=given)
    if "tie" in given:
        check_keys(f"fit.free.{name}", given, _TIED)
        return Tie(name, str(given["tie"]), _number(f"factor of {name}", given.get("factor", 1.0)))
    check_keys(f"fit.free.{name}", given, _FREE)
    bounds, each = given.get("bounds", ["none", "none"]), given.get("each", False)
    if not isinstance(bounds, list) or len(bounds) != 2:
        raise ValueError(f'bounds of {name}: {show(bounds)} given; they are two, "none" where there is none')
    if not isinstance(each, bool):
        raise ValueError(f"each of {name}: {show(each)} given; it must be true or false")
    low, high = (None if bound == "none" else bound for bound in bounds)
    # Without a guess the number is the file's own, and so is its unit.
    unit = file.leaves[name].unit if "guess" not in given and name in file.leaves else None
    prior = _prior(name, given["prior"]) if "prior" in given else None
    return Parameter(name, given.get("guess"), (low, high), unit, prior, each)


def _prior(name: str, given: Any) -> Prior:
    if not isinstance(given, Mapping) or "mean" not in given:
        raise ValueError(
            f'prior of {name}: {show(given)} given; it must be a table, such as {{ mean = "5 um", std = "1 um" }}'
        )
    check_keys(f"fit.free.{name}.prior", given, ("mean", "std", "factor"))
    factor = _number(f"prior of {name}, factor", given["factor"]) if "factor" in given else None
    return Prior(given["mean"], given.get("std"), factor)


def _number(label: str, given: Any) -> float:
    if isinstance(given, bool) or not isinstance(given, int | float):
        raise ValueError(f"{label}: {show(given)} given; it must be a number")
    return float(given)


def check_keys(table: str, given: Mapping[str, Number], known: Collection[str]) -> None:
    """Raise `ValueError` for a key that is not known, with the nearest one that is."""
    for key in given:
        if key not in known:
            near = difflib.get_close_matches(key, known, n=1)
            hint = f" Did you mean {near[0]}?" if near else ""
            raise ValueError(f"[{table}]: unknown key {key}.{hint} It takes: {', '.join(known)}")
