"""The fits, all recordings at once."""

import dataclasses
from collections.abc import Callable
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np

import millax as mx
from identification import FitResult, Parameter, Tie, Trace, align, fit
from identification._compare import compare
from millax._names import read_value, replace, value_of

from .models import (
    DAMPING,
    FREQUENCY,
    MODES,
    RESIDUES,
    STARTS,
    Free,
    by_tooth,
    coupled,
    fitted,
    flexible_tool,
    per_axis,
)
from .modes import guesses
from .recordings import DURATION, EARLIEST, FEEDS, TURN, TURNING, Data, case_of

SOLVER = "scipy_trf"
"""Numbers of very different scales: it sizes its steps by the columns of the Jacobian."""

EVALUATIONS = 120
"""Most of model and Jacobian in a fit."""

FIRST = 25
"""Evaluations after which starts are compared; the best one goes on."""

NUMERICS = {"slices": 6, "blocks": 32, "sweeps": 14, "width": 3e-6}
"""An edge force begins all at once, and the tool gives way at once: short blocks and gates that are not too narrow."""

CHAINS, BEFORE = 3, 3
"""How many guesses of the coupled chain are fitted from a simulated force, and from how many such forces at first."""

GAIN = 0.01
"""A round of guesses that lowers the cost by a smaller part is the last one."""

Say = Callable[[str], None]


class Fitted(NamedTuple):
    """A fit and what was free in it."""

    result: FitResult
    parameters: Free
    ends: list[FitResult]
    """Where the starts were when they were compared, the best first."""


def best_of(data: Data, cases_of_starts: list[list[mx.Case]], parameters: Free, say: Say) -> Fitted:
    """The fit with the lowest cost; the starts share one compiled program."""
    ends = sorted(_each(data, cases_of_starts, parameters, FIRST, say), key=lambda result: result.cost)
    return Fitted(_each(data, [list(ends[0].cases)], parameters, EVALUATIONS, say)[0], parameters, ends)


def _each(data: Data, starts: list[list[mx.Case]], parameters: Free, most: int, say: Say) -> list[FitResult]:
    found = []
    for start in starts:
        cases = [off_bounds(case, parameters) for case in start]
        found.append(fit(cases, data.turns, parameters, solver=SOLVER, check=False, max_iterations=most))
        if found[-1].status == "cannot_start":
            raise RuntimeError(f"a start that cannot be simulated: {found[-1].message}")
        said = f"{found[-1].iterations} evaluations, {found[-1].status}"
        say(f"  {len(found)} of {len(starts)}: cost {found[-1].cost:.0f}, {said}")
    return found


def fit_per_axis(data: Data, law: mx.ForceLaw, say: Say) -> Fitted:
    """A flexible tool, and one resonance per axis of the dynamometer."""
    law, coefficients = by_tooth(law)
    structure, _ = flexible_tool()
    starts, parameters = [], []
    for frequency, runout in STARTS:
        resonances, parameters = per_axis(frequency)
        cases = []
        for feed, average in zip(FEEDS, data.averages, strict=True):
            case = case_of(feed, law)
            tool = dataclasses.replace(case.tool, runout=(0.0, runout))
            settings = mx.Settings.suited(tool, law, structure, case.cut, DURATION, **NUMERICS)
            case = dataclasses.replace(case, tool=tool, structure=structure, settings=settings)
            clock = dataclasses.replace(align(case, average.trace), speed_error=jnp.zeros(()))
            cases.append(dataclasses.replace(case, sensor=mx.Sensor(resonances=resonances), clock=clock))
        starts.append(cases)
    return best_of(data, starts, fitted(coefficients, parameters), say)


def fit_law(data: Data, before: FitResult, law: mx.ForceLaw, bend: list[Parameter], say: Say) -> Fitted:
    """Another law, from the tool and the chain that the result with one resonance per axis has."""
    law, coefficients = by_tooth(law)
    cases = [dataclasses.replace(case, force=law) for case in before.cases]
    parameters = fitted([*coefficients, *bend], per_axis(STARTS[0][0])[1])
    return best_of(data, [cases], parameters, say)


def fit_coupled(data: Data, before: Fitted, say: Say) -> Fitted:
    """Modes that couple the axes, from fits with one resonance per axis: guessed from the forces of these, then in rounds
    from those of the best fit so far, until nothing is gained."""
    _, coefficients = by_tooth(before.result.cases[0].force)
    parameters = fitted(coefficients, coupled())
    best, forces = None, [before.result, *before.ends[1:BEFORE]]
    while True:
        starts = [start for result in forces for start in _with_chains(data, result, say)]
        found = best_of(data, starts, parameters, say)
        if best is not None and found.result.cost > (1 - GAIN) * best.result.cost:
            return min(best, found, key=lambda one: one.result.cost)
        best, forces = found, [found.result]


def _with_chains(data: Data, result: FitResult, say: Say) -> list[list[mx.Case]]:
    """Its cases with the best guesses of a coupled chain."""
    bounds = tuple(zip(FREQUENCY, DAMPING, strict=True))
    assert RESIDUES.std is not None
    found = guesses(*lines(data, result), TURNING, MODES, bounds, float(RESIDUES.std))[:CHAINS]
    for chain in found:
        say(f"  a guess: modes at {', '.join(f'{f:.0f}' for f in np.sort(np.asarray(chain.frequency)))} Hz")
    return [[eqx.tree_at(lambda c: c.sensor.resonances, case, chain) for case in result.cases] for chain in found]


def off_bounds(case: mx.Case, parameters: Free) -> mx.Case:
    """The case with no number on its bounds: there, none knows where to go."""
    values = {}
    for p in parameters:
        if isinstance(p, Tie):
            continue
        low, high = (None if bound is None else read_value(case, p.name, bound) for bound in p.bounds)
        if low is not None and high is not None:
            room = [max(0.1 * abs(bound), 1e-3 * (high - low)) for bound in (low, high)]
            values[p.name] = jnp.clip(value_of(case, p.name), low + room[0], high - room[1])
    return replace(case, values)


def lines(data: Data, result: FitResult) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Of the force on the tool in a result and of what was measured, lines at the multiples of the spindle frequency,
    shape (recordings, lines, 3) for x, y and z; and sigma of the mean over the samples of a trace."""
    forces, measured, sigma = [], [], []
    for case, trace in zip(result.cases, data.turns, strict=True):
        order = [trace.channels.index(f"F{axis}") for axis in "xyz"]
        alone = dataclasses.replace(case, sensor=None)
        forces.append(spectrum(np.asarray(compare(trace, alone).predict(mx.simulate(alone), alone)).T[:, order]))
        measured.append(spectrum(trace.values[:, order]))
        sigma.append([trace.noise[f"F{axis}"] / np.sqrt(trace.samples) for axis in "xyz"])
    return np.array(forces), np.array(measured), np.array(sigma)


def spectrum(values: np.ndarray) -> np.ndarray:
    """Lines of the first turn, from the spindle frequency to below half the sampling rate."""
    return np.fft.rfft(values[:TURN], axis=0)[1 : TURN // 2] / TURN


def predicted(case: mx.Case, trace: Trace, speed_error: float) -> np.ndarray:
    """A fitted case beside a recording as it is, shape (samples, channels)."""
    assert case.clock is not None
    clock = mx.Clock(case.clock.start, speed_error)
    length = EARLIEST + 0.05 + (trace.time[-1] - trace.time[0])
    longer = mx.Settings.suited(case.tool, case.force, case.structure, case.cut, length, **NUMERICS)
    case = dataclasses.replace(case, clock=clock, settings=longer)
    return np.asarray(compare(trace, case).predict(mx.simulate(case), case)).T
