"""The cases that many tests start from."""

import math

import numpy as np

import millax as mx

RPM = 2 * np.pi / 60


def slot(
    *,
    mass=100.0,
    stiffness=3e5,
    damping_ratio=0.05,
    axes=("x", "y"),
    duration=0.02,
    stock=None,
    structure=None,
    force=None,
    speed=10000 * RPM,
    feed=4 / 60,
    diameter=0.02,
    teeth=4,
    start=None,
    **settings,
) -> mx.Case:
    """The papers' slot: KR240, aluminium, 10 000 rpm, 4 m/min, 4 teeth, entering a straight border at t = 0."""
    tool = mx.EndMill(diameter, teeth)
    law = mx.FractionalLaw(k0=5e9, hs=18e-6, r=0.1, kr=0.3) if force is None else force
    cut = mx.Cut.touching(tool, speed, feed, 1e-3) if start is None else mx.Cut(speed, feed, 1e-3, start)
    if structure is None:
        structure = mx.Structure(axes, mass, stiffness, damping_ratio=damping_ratio) if axes else mx.Structure.rigid()
    periods = math.ceil(duration / float(cut.tooth_period(tool)) - 1e-9)
    stock = mx.Stock.box() if stock is None else stock
    return mx.Case(tool, law, cut, stock, structure, mx.Settings(periods, **settings))


ENDLESS = mx.Stock.box((None, None))
"""A workpiece without borders: the tool has always been cutting."""

SLOT_FILE = """\
[tool]
diameter = "20 mm"
teeth = 4  # carbide
[force]
law = "fractional"
k0 = "5000 N/mm^2"   # per unit depth
hs = "18 um"
r = 0.1
kr = 0.3
[cut]
spindle_speed = "10000 rpm"
feed_rate = "4 m/min"
depth = "1 mm"
"""
"""The slot as a case file, but for the structure and the simulation."""
