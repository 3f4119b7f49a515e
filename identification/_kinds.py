"""Whether values are of the kinds that the fields of a dataclass are declared to be."""

import types
import typing
from collections.abc import Mapping
from typing import Any

import jax
import numpy as np


def hints_of(cls: type) -> dict[str, Any]:
    """The types of the fields; anything will do where only a type checker knows the name."""
    unknown: dict[str, Any] = {}
    while True:
        try:
            return typing.get_type_hints(cls, localns=unknown)
        except NameError as error:
            unknown[str(error.name)] = object


def fits(value: Any, hint: Any) -> bool:
    """Whether a value is of the kind that a field is declared to be. All numbers and arrays are one kind, as are all
    sequences: people give one for another, and constructors take them."""
    origin, inner = typing.get_origin(hint), typing.get_args(hint)
    if origin in (typing.Union, types.UnionType):
        return any(fits(value, one) for one in inner)
    if origin is typing.Literal:
        return value in inner
    if origin is not None and issubclass(origin, Mapping):
        return isinstance(value, dict) and all(fits(part, inner[1]) for part in value.values())
    if origin in (tuple, list):
        if not isinstance(value, list | tuple):
            return _number(value)
        if origin is list or inner[1:] == (...,):
            return all(fits(part, inner[0]) for part in value)
        return len(value) == len(inner) and all(map(fits, value, inner))
    if hint in (int, float, bool, np.ndarray, jax.Array) or hasattr(hint, "array_type"):  # the last: of jaxtyping
        return _number(value)
    return isinstance(value, hint) if isinstance(hint, type) else True


def _number(value: Any) -> bool:
    return isinstance(value, int | float | np.ndarray | np.generic | jax.Array)
