"""Checks of concrete numbers, before anything is traced.

Inside `jit`, `grad` or `vmap` a leaf has no value to look at: these checks then pass, and the simulation's status
reports what went wrong (see `millax.Simulation`).
"""

import numpy as np
from jax.core import Tracer


def concrete(value) -> np.ndarray | None:
    """`value` as a NumPy array, or None where it is traced, abstract or not a number."""
    if isinstance(value, Tracer):
        return None
    try:
        return np.asarray(value, dtype=float)
    except (TypeError, ValueError):
        return None


def positive(name: str, value, unit: str) -> None:
    """Raise `ValueError` unless every number of `value` is finite and > 0."""
    _require(name, value, unit, lambda v: v > 0, "greater than 0")


def not_negative(name: str, value, unit: str) -> None:
    """Raise `ValueError` unless every number of `value` is finite and >= 0."""
    _require(name, value, unit, lambda v: v >= 0, "0 or greater")


def finite(name: str, value, unit: str) -> None:
    """Raise `ValueError` unless every number of `value` is finite."""
    _require(name, value, unit, lambda v: np.full(v.shape, True), "a finite number")


def _require(name, value, unit, allowed, words) -> None:
    numbers = concrete(value)
    if numbers is None:
        return
    bad = ~np.isfinite(numbers) | ~allowed(numbers)
    if bad.any():
        shown = f"{numbers[bad].flat[0]:g}" + (f" {unit}" if unit else "")
        raise ValueError(f"{name}: {shown} given; it must be {words}")
