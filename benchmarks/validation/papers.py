"""The rigid slot's mean forces, and all rows of the papers' Tables 1 and 2 (E) beside the model's values.

The tables are printed with few digits; a value must agree within 2 % plus half the last digit, the overshoot within 2.5
points, the frequency within 0.5 Hz. The f1y of Table 2 belongs to the lower of two whirl peaks of similar height: the
peak of the spectrum may be either, so it is shown against the bound of the paper's value and both whirl frequencies.
"""

import numpy as np
from scipy.integrate import quad

import millax as mx

from ..figures import Figure, near
from ..slot import slot

MASS = (100, 100, 100, 100, 100, 150, 200)
STIFFNESS = (0.05e6, 0.30e6, 0.60e6, 1.00e6, 2.00e6, 2.00e6, 2.00e6)
TABLE_1 = {
    "static_displacement.x": (0.80, 0.13, 0.07, 0.04, 0.02, 0.02, 0.02),
    "overshoot.x": (52, 30, 23, 17, 11, 14, 18),
    "first_frequency.x": (3.5, 8.8, 12.4, 15.6, 22.6, 18.3, 15.6),
}
TABLE_2 = {
    "static_displacement.x": (0.80, 0.13, 0.07, 0.04, 0.02, 0.02, 0.02),
    "static_displacement.y": (2.61, 0.43, 0.22, 0.13, 0.06, 0.06, 0.06),
    "first_frequency.x": (3.2, 8.2, 12.4, 15.6, 22.4, 18.3, 15.6),
    "first_frequency.y": (2.2, 7.3, 11.4, 14.6, 21.5, 17.4, 15.6),
}
SYMBOL = {
    "static_displacement.x": ("x_s", " mm"),
    "static_displacement.y": ("y_s", " mm"),
    "overshoot.x": ("PO", " %"),
    "first_frequency.x": ("f1x", " Hz"),
    "first_frequency.y": ("f1y", " Hz"),
}


def figures():
    yield from _slot_means()
    for number, (table, axes) in enumerate(((TABLE_1, ("x",)), (TABLE_2, ("x", "y"))), start=1):
        for row, (mass, stiffness) in enumerate(zip(MASS, STIFFNESS, strict=True)):
            case = slot(axes=axes, mass=float(mass), stiffness=stiffness, duration=2.0)
            summary = mx.summarize(mx.simulate(case), case)
            for name, values in table.items():
                yield _beside(f"E Table {number}, {mass} kg, {stiffness / 1e6:.2f} MN/m", name, summary[name], values[row])


def _beside(row: str, name: str, found: dict, paper: float) -> Figure:
    symbol, unit = SYMBOL[name]
    if found["value"] is None:
        return Figure(f"{row}: {symbol}", "none", f"{paper}{unit}", False)
    if name.startswith("static"):
        return near(f"{row}: {symbol}", abs(found["value"]) * 1e3, paper, 0.02 * paper + 0.005, form=".4f", unit=unit)
    within = 2.5 if name.startswith("overshoot") else 0.5
    return near(f"{row}: {symbol}", found["value"], paper, within, form=".1f", unit=unit)


def _slot_means():
    """Mean forces of the rigid slot with h = f_z cos(phi): the model's first order, where feed/diameter vanishes."""

    def per_angle(phi, side):
        u = 1e-4 * np.cos(phi) / 18e-6
        tangential = 90.0 * (u + 0.1 * u**2) / (1 + u)
        radial = 0.3 * tangential
        x, y = -radial * np.cos(phi) + tangential * np.sin(phi), radial * np.sin(phi) + tangential * np.cos(phi)
        return 4 / (2 * np.pi) * (x, y)[side]

    case = slot(axes=(), diameter=2000.0, border=False, steps_per_tooth=2000, width=0.0, duration=0.0015)
    mean = np.asarray(mx.simulate(case).force).mean(axis=0)
    for side, (name, published) in enumerate((("F_x", -39.637), ("F_y", 132.124))):
        exact = quad(per_angle, -np.pi / 2, np.pi / 2, args=(side,))[0]
        yield near(f"rigid slot, first order: mean {name} beside quadrature", mean[side], exact, 1e-4, form=".4f", unit=" N")
        yield near(f"rigid slot, first order: mean {name} as published", mean[side], published, 6e-4, form=".4f", unit=" N")
