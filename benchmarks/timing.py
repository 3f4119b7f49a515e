"""Times that can be compared on a machine that does other things as well."""

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import jax
import numpy as np


@dataclass(frozen=True)
class Times:
    """Seconds of several functions, measured in turn: `rounds[name][i]` belongs to round i."""

    rounds: dict[str, np.ndarray]

    def seconds(self, name: str) -> float:
        """The median."""
        return float(np.median(self.rounds[name]))

    def ratio(self, name: str, base: str) -> float:
        """How many times longer `name` takes than `base`: the median over the rounds of the ratio in each."""
        return float(np.median(self.rounds[name] / self.rounds[base]))


def interleaved(functions: Mapping[str, Callable], rounds: int) -> Times:
    """Run all functions in turn, `rounds` times, so that a slow spell of the machine slows them alike.

    One run of each before, not counted: it compiles.
    """
    times = {name: np.zeros(rounds) for name in functions}
    for function in functions.values():
        jax.block_until_ready(function())
    for i in range(rounds):
        for name, function in functions.items():
            begin = time.perf_counter()
            jax.block_until_ready(function())
            times[name][i] = time.perf_counter() - begin
    return Times(times)


def exponent(sizes, seconds) -> float:
    """The p of seconds ~ sizes^p: the slope of the straight line through the points in logarithms."""
    return float(np.polyfit(np.log(sizes), np.log(seconds), 1)[0])
