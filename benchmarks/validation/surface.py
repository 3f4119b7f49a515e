"""The wall that a cut leaves beside closed forms: feed marks, surface location error in up- and down-milling; an entry."""

import numpy as np

import millax as mx

from ..figures import Figure, near
from ..location_error import MODE, TOOL, location_error
from ..slot import slot

SPEEDS = (9000, 13000, 20000, 25000, 27000, 30000)
"""[rpm]. At 27 660 rpm the teeth pass as often as the mode swings, at 13 830 and 9220 half and a third as often."""

FEED = 0.05e-3
SIGN = {"left": 1, "right": -1}
WORDS = {"left": "up-milling", "right": "down-milling"}


def figures():
    yield from _feed_marks()
    yield from _location_errors()
    yield from _entry()


def _feed_marks():
    case = slot(axes=(), border=False, duration=0.1, steps_per_tooth=10)
    sim, start = mx.simulate(case), float(case.cut.start[0])
    feed, radius, teeth = 1e-4, 0.01, 4
    for side, sign in SIGN.items():
        deviation = np.asarray(mx.wall_profile(case, sim, side, start + np.linspace(3e-3, 4e-3, 2001)).deviation)
        height = feed**2 / (8 * radius * (1 + sign * feed * teeth / (2 * np.pi * radius)) ** 2)
        found = deviation.max() - deviation.min()
        what = f"{WORDS[side]}, rigid, 10 steps per tooth: height of feed marks (Martellotti 1941)"
        yield near(what, found * 1e9, height * 1e9, 0.02, form=".3f", unit=" nm")


def _location_errors():
    for side, words in WORDS.items():
        found, motions = zip(*(_milled(side, rpm) for rpm in SPEEDS), strict=True)
        expected = [location_error(side, speed=rpm * np.pi / 30, feed_per_tooth=FEED, **TOOL, **MODE) for rpm in SPEEDS]
        # The closed form is first order in the feed over the radius, 0.5 %.
        within = 0.01 * max(motions)
        for rpm, ours, theirs in zip(SPEEDS, found, expected, strict=True):
            what = f"{words}, {rpm} rpm: location error, + is material left (Schmitz and Mann 2006)"
            yield near(what, ours * 1e6, theirs * 1e6, within * 1e6, form="+.3f", unit=" µm")


def _milled(side: str, rpm: float) -> tuple[float, float]:
    """Form error and largest displacement at the end [m]."""
    tool, law = mx.EndMill(2 * TOOL["radius"], TOOL["teeth"]), mx.LinearLaw(kt=TOOL["kt"], kr=TOOL["kr"])
    tau = 60 / (rpm * TOOL["teeth"])
    cut = mx.Cut(rpm * np.pi / 30, FEED / tau, TOOL["depth"], (0.0, 0.0))
    inner = TOOL["radius"] - TOOL["immersion"]
    stock = mx.Stock.box((None, None), (inner, None) if side == "left" else (None, -inner))
    structure = mx.Structure(("y",), MODE["mass"], MODE["stiffness"], damping_ratio=MODE["damping_ratio"])
    settings = mx.Settings(400, 80, blocks=4, sweeps=12, width=1e-9)
    case = mx.Case(tool, law, cut, stock, structure, settings)
    sim = mx.simulate(case)
    error = mx.form_error(mx.wall_profile(case, sim, side))
    return float(error), float(np.abs(np.asarray(sim.displacement[-1000:])).max())


def _entry():
    """Phases and Fig. 9 of E. The figure shows the motion of the tool; the wall keeps what comes after its entry."""
    rigid = slot(axes=(), duration=0.2)
    found = mx.phases(rigid, mx.simulate(rigid))
    tau, opened = float(rigid.cut.tooth_period(rigid.tool)), 0.01 * (1 - np.cos(np.pi / 4)) / (4 / 60)
    begin, end = found["Ia"]
    what = "rigid entry: phase Ia ends when the arc of contact is a pitch long, and up to a tooth period later"
    yield near(what, end, opened + tau / 2, tau / 2, form=".4f", unit=" s")
    yield near("rigid entry: duration of phase Ia as published (E)", end - begin, 0.04, 0.005, form=".3f", unit=" s")
    yield near(
        "rigid entry: phase II begins, the tool centre passes the border", found["II"][0], 0.15, 1e-4, form=".4f", unit=" s"
    )
    case = slot(duration=1.0)
    sim = mx.simulate(case)
    between, y = mx.phases(case, sim)["Ib"], np.asarray(sim.displacement[:, 1]) * 1e3
    entering = y[(np.asarray(sim.time) > between[0] + 0.02) & (np.asarray(sim.time) < between[1])]
    yield near("E Fig. 9: largest y of the tool in phase Ib", entering.max(), 0.56, 0.02, form=".3f", unit=" mm")
    yield near("E Fig. 9: smallest y after it in phase Ib", entering.min(), 0.31, 0.03, form=".3f", unit=" mm")
    z = np.asarray(mx.wall_profile(case, sim, "right").deviation) * 1e3
    yield Figure("the same: material left on the right wall", f"{np.nanmin(z):.2f} to {np.nanmax(z):.2f} mm", "", None)
