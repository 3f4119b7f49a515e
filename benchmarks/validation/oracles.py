"""The engine beside other programs that compute the same cut: a C loop, a scan over steps, the papers' grid."""

import dataclasses

import numpy as np

import millax as mx

from .. import compiled, grid
from ..figures import Figure, below
from ..scan import step_by_step
from ..slot import light, six_coordinates, slot

EQUAL = 1e-9
"""Of the largest value. All of them are iterated until nothing changes, so that rounding is left."""


def figures():
    if compiled.have_compiler():
        for name, case in _cuts():
            yield _beside_c(name, case)
    else:
        yield Figure("the model as a C loop over steps", "left out: no gcc here", "", None)
    yield _beside_scan()
    yield from _beside_grid()


def _cuts():
    entering = slot(duration=0.16)
    yield "entry into a slot", entering
    yield "slot, hard gates", slot(duration=0.16, width=0.0)
    yield "slot, one pass remembered", slot(duration=0.16, passes=1)
    yield "half immersion", dataclasses.replace(entering, stock=mx.Stock.box((0.0, None), (None, 0.0)))
    yield "walls, entry and exit", dataclasses.replace(entering, stock=mx.Stock.box((0.0, 0.004), (-0.003, 0.005)))
    yield "six coordinates, full M, C, K", six_coordinates(duration=0.16)
    yield "light tool mode at its limit depth", light(duration=0.16)


def _converged(case: mx.Case) -> mx.Simulation:
    return mx.simulate(case.with_settings(sweeps=30, tolerance=1e-14))


def _largest(values, reference) -> float:
    return float(np.abs(np.asarray(values) - np.asarray(reference)).max() / np.abs(np.asarray(reference)).max())


def _beside_c(name: str, case: mx.Case) -> Figure:
    """Forces, displacements and chip thickness: the largest difference of all."""
    sim, loop = _converged(case), compiled.same_model(case, tolerance=1e-18)()
    pairs = (
        (sim.force[:, :2], loop.force),
        (sim.displacement[:, :2], loop.displacement),
        (sim.chip_thickness, loop.thickness),
    )
    difference = max(_largest(ours, theirs) for ours, theirs in pairs)
    return below(f"{name}: all traces beside the C loop over steps, largest difference", difference, EQUAL, form=".1e")


def _beside_scan() -> Figure:
    case = slot(duration=0.05)
    force, _ = step_by_step(case, evaluations=3)()
    difference = _largest(_converged(case).force[:, :2], force)
    return below("entry into a slot: force beside a lax.scan over steps, largest difference", difference, EQUAL, form=".1e")


def _beside_grid():
    """The chip thickness of the papers, A/(R dalpha), is h - h²/(2 R)."""
    case = slot(duration=0.03)
    h = np.asarray(mx.simulate(case).chip_thickness)
    expected = h - h**2 / float(case.tool.diameter)
    spacings, errors = (20e-6, 10e-6, 5e-6), []
    for spacing in spacings:
        found = grid.simulate(case, spacing).thickness
        errors.append(float(np.sqrt(((found - expected) ** 2).mean() / (expected**2).mean())))
        what = f"papers' grid, nodes every {spacing * 1e6:.0f} µm: RMS difference of the chip thickness"
        limit = 1.0 if spacing == spacings[-1] else None
        percent = 100 * errors[-1]
        yield below(what, percent, limit, unit=" %") if limit else Figure(what, f"{percent:.2g} %", "", None)
    order = float(np.polyfit(np.log(spacings), np.log(errors), 1)[0])
    yield Figure("order in the distance of the nodes", f"{order:.2f}", "≥ 0.9", order >= 0.9)
