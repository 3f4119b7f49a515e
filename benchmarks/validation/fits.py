"""Fits from many starts, and a question without an answer."""

from collections.abc import Iterator

import numpy as np

import identification as ident
from millax._names import value_of

from ..demo import cut, recorded
from ..figures import Figure, below

STARTS, SPREAD = 64, 5.0
NAMES = (
    "force.k0",
    "force.hs",
    "force.r",
    "force.kr",
    "structure.damping_ratio.x",
    "structure.damping_ratio.y",
)


def figures() -> Iterator[Figure]:
    yield from _starts()
    yield from _unknown()


def _starts() -> Iterator[Figure]:
    """Of the demo's slot, 0.2 s: starts wrong by up to a factor of five in every number."""
    case = cut(0.2)
    result = ident.fit(case, recorded(case, 0), NAMES, starts=STARTS, spread=SPREAD, seed=1)
    falls = result.waterfall
    assert falls is not None
    best = np.array([e.value for e in result.parameters])
    near = np.all(np.abs(falls.ends / best - 1) < 0.01, axis=1)
    told = near | (falls.optimum != 0)
    yield Figure(f"{STARTS} starts, each number off by up to a factor of {SPREAD:g}: {falls.words}", "", "", None)
    yield _least("starts within 1 % of the optimum, or told to be elsewhere", 100 * np.mean(told), 95)
    yield _least("starts within 1 % of the optimum", 100 * np.mean(near), 95)
    errors = [abs(e.value - value_of(case, e.name)) / e.std for e in result.parameters if e.std]
    yield below("the best optimum: largest error, in standard errors", max(errors), 3.5)


def _unknown() -> Iterator[Figure]:
    """A question without an answer."""
    case = cut(0.2)
    found = ident.check(case, recorded(case, 0), ["force.k0", "cut.depth", "force.kr"])
    named = [p.name for p in found.parameters if p.reason and "force.k0, cut.depth cannot be told apart" in p.reason]
    words = "k0 with the depth free: refused, these named"
    yield Figure(words, ", ".join(named), "force.k0, cut.depth", named == ["force.k0", "cut.depth"])


def _least(what: str, value: float, limit: float) -> Figure:
    return Figure(what, f"{value:.1f} %", f"≥ {limit:g} %", bool(value >= limit))
