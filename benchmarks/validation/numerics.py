"""Order of accuracy through the entry into a border, and the bias of the smoothed gates."""

import numpy as np

import millax as mx

from ..figures import Figure, below
from ..slot import slot

FINE = 1280


def figures():
    yield from _order("rigid", axes=())
    yield from _order("2-DOF", axes=("x", "y"), sweeps=8, tolerance=1e-10)
    yield from _hard_limit()


def _errors(coarse, fine):
    """Root mean square and largest error, over the root mean square and the largest value."""
    fine = fine.reshape(-1, len(fine) // len(coarse), fine.shape[1]).mean(axis=1)
    error = coarse - fine
    return np.sqrt((error**2).mean() / (fine**2).mean()), np.abs(error).max() / np.abs(fine).max()


def _traces(**settings):
    sim = mx.simulate(slot(duration=0.16, **settings))
    return np.asarray(sim.force)[:, :2], np.asarray(sim.displacement)


def _force(**settings):
    return _traces(**settings)[0]


def _order(name, **case):
    """The whole entry, from first contact to the tool centre past the border: 107 tooth periods."""
    numerics = {"sweeps": 6} | case
    fine = _traces(steps_per_tooth=FINE, blocks=16, **numerics)
    runs = {steps: _traces(steps_per_tooth=steps, blocks=1, **numerics) for steps in (10, 20, 40, 80)}
    force = {steps: _errors(run[0], fine[0]) for steps, run in runs.items()}
    yield below(f"{name}, entry: RMS force error at 40 steps per tooth", 100 * force[40][0], 0.2, unit=" %")
    yield below(f"{name}, entry: largest force error of any one step, at 40", 100 * force[40][1], 0.2, unit=" %")
    yield _slope(f"{name}, entry: order of the RMS force error, 10 to 40 steps", force, 0, 1.7)
    yield _slope(f"{name}, entry: order of the largest force error, 10 to 40 steps", force, 1, 1.7)
    at_80 = f"{100 * force[80][0]:.2g} %, {100 * force[80][1]:.2g} %"
    yield Figure(f"{name}, entry: RMS and largest force error at 80", at_80, "", None)
    if case.get("axes"):
        moves = {steps: _errors(run[1], fine[1]) for steps, run in runs.items()}
        yield below(f"{name}, entry: largest displacement error at 40", 100 * moves[40][1], 0.2, unit=" %")
        yield _slope(f"{name}, entry: order of the largest displacement error, 10 to 40 steps", moves, 1, 1.9)


def _slope(what, errors, which, least) -> Figure:
    steps = (10, 20, 40)
    order = -np.polyfit(np.log(steps), np.log([errors[n][which] for n in steps]), 1)[0]
    return Figure(what, f"{order:.2f}", f"≥ {least}", bool(order >= least))


def _hard_limit():
    hard = _force(width=0.0, sweeps=8, tolerance=1e-10)
    differences = []
    for width in (4e-6, 2e-6, 1e-6, 0.5e-6):
        soft = _force(width=width, sweeps=8, tolerance=1e-10)
        differences.append(np.sqrt(((soft - hard) ** 2).mean() / (hard**2).mean()))
        yield Figure(
            f"gates of width {width * 1e6:.1f} µm: RMS force difference from the hard model",
            f"{100 * differences[-1]:.2g} %",
            "",
            None,
        )
    order = np.polyfit(np.log([8, 4, 2, 1]), np.log(differences), 1)[0]
    yield Figure("order in the width", f"{order:.2f}", "≥ 1", bool(order >= 1))
    default = _force(sweeps=8, tolerance=1e-10)
    means = [trace[-160:].mean(axis=0) for trace in (default, hard)]
    bias = np.abs(means[0] - means[1]).max() / np.abs(means[1]).max()
    yield below("default width (1 µm): bias of the mean force", 100 * bias, 0.3, unit=" %")
    yield below("default width (1 µm): RMS force difference", 100 * differences[2], 0.3, unit=" %")
