"""The engine beside exact tooth paths and the papers' grid, along the motion that it found itself.

Both take the displacement as it is, so that they show what the chip thickness and the step means of the engine cost, and
nothing else. Exact paths are of second order in the parts of a step; the grid is good to about its spacing over the
thickness, and forgets no pass.
"""

import dataclasses

import jax.numpy as jnp
import numpy as np

import millax as mx

from .. import exact, grid
from ..figures import Figure, below
from ..slot import down_milling, slot, strong_chatter, up_milling

DURATION = 0.06
SPACING = 5e-6
FINER = 8
"""Steps of the grid in a step: it takes the force of a mean thickness, which errs where a tooth begins to cut."""
PASSES = 8
MANY = 64
"""As good as all of them."""

CUTS = {
    "entry into a slot": (slot, 0.1),
    "slot from inside": (lambda **numbers: slot(border=False, **numbers), None),
    "half immersion, up-milling": (up_milling, 0.1),
    "half immersion, down-milling": (down_milling, 0.1),
    "strong chatter, contact loss": (strong_chatter, 1.0),
}
"""Cases, and the RMS difference of the force that is allowed [%].

The tool that starts inside swings by more than its feed, 0.4 mm at 9 Hz, along a path more curved than itself: it meets
the wall that it left many passes ago."""


TOOLS = {
    "helix 30°": {"helix": np.radians(30)},
    "runout 20 µm": {"runout": [0.0, 2e-5, 5e-6, -8e-6]},
    "variable pitch": {"pitch": np.radians([82, 97, 86, 95])},
    "axis offset by 10 µm, helix 30°": {"offset": 1e-5, "offset_angle": 0.3, "helix": np.radians(30)},
}
FLANKS = 3e7
"""Process damping [N/m]: that of a worn tool, ten times as much."""
SHORT = 0.02
"""Of the cuts with these tools [s]: of a helix every slice is followed by itself."""


def figures():
    yield from _simulated()
    yield from _tools()
    yield _flanks()
    yield _any_cutter()


def _simulated():
    for name, (build, limit) in CUTS.items():
        case = build(duration=DURATION, passes=PASSES)
        sim = mx.simulate(case)
        cut = exact.followed(case, sim)
        same, few, many = (exact.cut_along(*cut, passes=passes).force for passes in (PASSES, 3, MANY))
        nodes = grid.cut_along(*cut, spacing=SPACING, finer=FINER, early=4 * case.settings.steps_per_tooth).force
        what = f"{name}: engine beside exact paths, both with {PASSES} passes, RMS force difference"
        percent = _percent(sim.force, same)
        yield below(what, percent, limit, unit=" %") if limit else _read(what, percent)
        yield _read(f"{name}: engine beside exact paths with {MANY} passes", _percent(sim.force, many))
        yield _read(f"{name}: exact paths with 3 passes beside {MANY}", _percent(few, many))
        yield _read(f"{name}: exact paths with {PASSES} passes beside {MANY}", _percent(same, many))
        yield _read(f"{name}: engine beside the grid, nodes every {SPACING * 1e6:.0f} µm", _percent(sim.force, nodes))
        yield below(f"{name}: exact paths with {MANY} passes beside the grid", _percent(many, nodes), 1.0, unit=" %")


def _tools():
    for name, tool in TOOLS.items():
        for what, build in (("slot", slot), ("half immersion, up", up_milling), ("half immersion, down", down_milling)):
            case = build(duration=SHORT, passes=PASSES, tool=tool)
            sim, slices = mx.simulate(case), case.settings.slices
            # Of a helix also what cutting it into slices costs.
            cut = exact.followed(case, sim, 4 * slices if slices > 1 else 1)
            percent = _percent(sim.force, exact.cut_along(*cut, passes=PASSES).force)
            many = f", in {4 * slices} slices (engine: {slices})" if slices > 1 else ""
            yield below(f"{name}, {what}: engine beside exact paths{many}, RMS force difference", percent, 0.1, unit=" %")
        nodes = grid.cut_along(*cut, spacing=SPACING, finer=FINER, early=4 * case.settings.steps_per_tooth).force
        yield _read(
            f"{name}, {what}: engine beside the grid, nodes every {SPACING * 1e6:.0f} µm", _percent(sim.force, nodes)
        )


def _flanks() -> Figure:
    """Process damping, of a structure that swings."""
    case = down_milling(duration=SHORT, passes=PASSES)
    law = dataclasses.replace(case.force, process_damping=jnp.asarray(FLANKS))
    case = dataclasses.replace(case, force=law)
    sim = mx.simulate(case)
    reference = exact.cut_along(*exact.followed(case, sim), passes=PASSES, flank=exact.flank_of(case)).force
    what = f"process damping {FLANKS:.0e} N/m, half immersion, down: engine beside exact paths, RMS force difference"
    return below(what, _percent(sim.force, reference), 0.1, unit=" %")


def _any_cutter() -> Figure:
    """Helix, runout, pitch, edge and axial forces at once, along a motion as wide as the feed."""
    case = slot(border=False)
    speed, radius = float(case.cut.spindle_speed), float(case.tool.radius)
    pitch, runout = np.radians([80.0, 100.0, 85.0, 95.0]), [[2e-5, 0.0, -2e-5, 0.0], [0.0, 2e-5, 0.0, -2e-5]]
    cutter = exact.Cutter.end_mill(radius, 4, speed, 4e-3, slices=2, helix=np.radians(30), pitch=pitch, runout=runout)
    law = exact.linear(8e8, 0.3, 0.2, kte=2e4, kre=1e4, kae=5e3)
    dt = float(case.cut.tooth_period(case.tool)) / case.settings.steps_per_tooth
    time = (np.arange(480) + 0.5) * dt
    phase = 2 * np.pi * 400 * time
    trembling = 1e-4 * np.stack([np.sin(phase), 0.7 * np.sin(1.3 * phase)], axis=1)
    cut = cutter, exact.motion(case.cut.start, case.cut.feed_rate, time, trembling), case.stock, law, time, dt
    many, nodes = (
        exact.cut_along(*cut, passes=MANY).force,
        grid.cut_along(*cut, spacing=SPACING, finer=FINER, early=160).force,
    )
    what = f"helix, runout, pitch, swings of 0.1 mm: exact paths with {MANY} passes beside the grid"
    return below(what, _percent(many, nodes), 1.0, unit=" %")


def _percent(force, reference) -> float:
    return 100 * float(np.sqrt(((np.asarray(force) - reference) ** 2).mean() / (reference**2).mean()))


def _read(what: str, percent: float) -> Figure:
    return Figure(what, f"{percent:.2g} %", "", None)
