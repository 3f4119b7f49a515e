"""How the cost grows with length, teeth, modes and members of a batch: seconds ~ size^p."""

import dataclasses

import jax

import millax as mx

from ..figures import Figure
from ..slot import modes, slot
from ..timing import exponent, interleaved
from .batch import batch
from .run import Run

STRAIGHT = 1.1
"""Largest exponent that counts as a straight line. Small sizes carry a fixed cost, which makes it smaller than 1."""

TEETH = (1, 2, 4, 8, 16)
MODES = (2, 4, 8, 16)
SLICES = (1, 2, 4, 8, 16)
MEMBERS = (16, 64, 256, 1024)


def figures(run: Run):
    yield _growth(run, "duration [s]", run.lengths, lambda s: _one(slot(duration=s)))
    yield _growth(run, "teeth", TEETH, lambda n: _one(_with_teeth(n, run.duration)))
    yield _growth(run, "slices", SLICES, lambda n: _one(slot(duration=run.duration, tool={"helix": 0.5}, slices=n)))
    yield _growth(run, "modes", MODES, lambda n: _one(modes(n, duration=run.duration)))
    yield _growth(run, "members of a batch", MEMBERS, lambda n: batch(slot(duration=run.duration / 50), n))


def _growth(run: Run, name: str, sizes, function) -> Figure:
    # Each size by itself: in turn, the largest would leave nothing of the smallest in any cache.
    rounds = max(3, run.rounds // 7)
    seconds = [interleaved({name: function(size)}, rounds).seconds(name) for size in sizes]
    run.growth[name] = (sizes, seconds)
    p = exponent(sizes, seconds)
    jax.clear_caches()
    what = f"cost against {name}, {sizes[0]:g} to {sizes[-1]:g}: exponent"
    return Figure(what, f"{p:.2f}", f"≤ {STRAIGHT}", bool(p <= STRAIGHT))


def _one(case: mx.Case):
    return lambda: mx.simulate(case, throw=False)


def _with_teeth(teeth: int, duration: float) -> mx.Case:
    """As many steps and as much feed per tooth, whatever the number of teeth."""
    case = slot(duration=duration)
    tool = mx.EndMill(case.tool.diameter, teeth)
    cut = dataclasses.replace(case.cut, feed_rate=case.cut.feed_rate * teeth / case.tool.teeth)
    return dataclasses.replace(case, tool=tool, cut=cut)
