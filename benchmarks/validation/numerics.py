"""Order of accuracy through the entry into a border, and the bias of the smoothed gates."""

import numpy as np

import millax as mx

from ..figures import Figure, below
from ..slot import slot

FINE = 1280


def figures():
    yield from _order("rigid", axes=())
    yield from _order("2-DOF", axes=("x", "y"), sweeps=6)
    yield from _hard_limit()


def _errors(coarse, fine):
    """Root mean square and largest force error, over the root mean square and the largest force."""
    fine = fine.reshape(-1, len(fine) // len(coarse), 2).mean(axis=1)
    error = coarse - fine
    return np.sqrt((error**2).mean() / (fine**2).mean()), np.abs(error).max() / np.abs(fine).max()


def _force(**settings):
    return np.asarray(mx.simulate(slot(duration=0.16, **settings)).force)[:, :2]


def _order(name, **case):
    """The whole entry, from first contact to the tool centre past the border: 107 tooth periods."""
    fine = _force(steps_per_tooth=FINE, blocks=16, **({"sweeps": 6} | case))
    rms, largest = {}, {}
    for steps in (10, 20, 40, 80):
        rms[steps], largest[steps] = _errors(_force(steps_per_tooth=steps, blocks=1, **({"sweeps": 6} | case)), fine)
    yield below(f"{name}, entry: RMS force error at 40 steps per tooth", 100 * rms[40], 0.2, unit=" %")
    yield Figure(f"{name}, entry: largest force error of any one step, at 40", f"{100 * largest[40]:.2g} %", "", None)
    order = -np.polyfit(np.log(list(rms)), np.log(list(rms.values())), 1)[0]
    yield Figure(f"{name}, entry: order of the RMS error, 10 to 80 steps", f"{order:.2f}", "≥ 1.6", bool(order >= 1.6))
    order = -np.polyfit(np.log(list(largest)), np.log(list(largest.values())), 1)[0]
    yield Figure(f"{name}, entry: order of the largest error", f"{order:.2f}", "≥ 1.6", bool(order >= 1.6))


def _hard_limit():
    hard = _force(width=0.0, sweeps=6)
    differences = []
    for width in (4e-6, 2e-6, 1e-6, 0.5e-6):
        soft = _force(width=width, sweeps=6)
        differences.append(np.sqrt(((soft - hard) ** 2).mean() / (hard**2).mean()))
        yield Figure(
            f"gates of width {width * 1e6:.1f} µm: RMS force difference from the hard model",
            f"{100 * differences[-1]:.2g} %",
            "",
            None,
        )
    order = np.polyfit(np.log([8, 4, 2, 1]), np.log(differences), 1)[0]
    yield Figure("order in the width", f"{order:.2f}", "≥ 1", bool(order >= 1))
    default = _force(sweeps=6)
    means = [trace[-160:].mean(axis=0) for trace in (default, hard)]
    bias = np.abs(means[0] - means[1]).max() / np.abs(means[1]).max()
    yield below("default width (1 µm): bias of the mean force", 100 * bias, 0.3, unit=" %")
    yield below("default width (1 µm): RMS force difference", 100 * differences[2], 0.3, unit=" %")
