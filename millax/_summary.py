"""What the papers tabulate of a simulated cut: static displacement, overshoot, settling time, frequency, forces.

Every quantity is defined on traces that start at t = 0 with the structure at rest. "Averaged" means the moving average
over one tooth period, which takes the tooth passage and its harmonics out.
"""

import math
from typing import Any

import numpy as np
from jaxtyping import Float

from ._case import Case
from ._simulate import Simulation
from ._surface import form_error, phases, roughness, wall_profile, walls
from ._types import AXES

SETTLED = 0.03
"""Half-width of the settling band, over the static displacement."""

_SMALLEST = 1e-15
"""Displacements [m] below this are rounding."""

_LEAST_PERIODS = 20
"""Tooth periods below which a trace says nothing about the structure."""

_LEAST_PEAK = 0.25
"""Height of a peak over the spectrum's maximum. A steady push without vibration has side lobes of up to 0.22."""

DEFINITIONS = {
    "static_displacement": ("m", "mean over the last half of the trace, weighted by a Hann window"),
    "overshoot": ("%", "largest displacement over the static one, less 1 (both without sign)"),
    "settling_time": (
        "s",
        f"time after which the displacement averaged over a tooth period stays within {SETTLED:.0%} of the static one",
    ),
    "first_frequency": (
        "Hz",
        "highest peak of the spectrum of the velocity of the displacement averaged over a tooth period, from t = 0",
    ),
    "mean_force": ("N", "mean over the whole revolutions in the last half of the trace"),
    "peak_force": ("N", "largest force, without sign, over the whole revolutions in the last half of the trace"),
    "phase_Ia.begin": ("s", "first contact of a tooth"),
    "phase_Ia.end": ("s", "two teeth in contact at the same time, or the begin of phase II"),
    "phase_Ib.begin": ("s", "two teeth in contact at the same time"),
    "phase_Ib.end": ("s", "the begin of phase II, or the end of the trace"),
    "phase_II.begin": ("s", "the tool centre passes the border that it feeds towards"),
    "phase_II.end": ("s", "the tool reaches a border ahead, or the trace ends"),
    "form_error": ("m", "mean distance of the wall from its nominal place over its last half; > 0: material is left"),
    "roughness_ra": ("m", "mean distance of the wall from its straight mean line, over its last half, along the feed"),
    "roughness_rz": ("m", "highest peak less deepest valley of the wall about its mean line, over its last half"),
}
"""Unit and definition of every quantity."""


def summarize(sim: Simulation, case: Case) -> dict[str, dict[str, Any]]:
    """What the papers tabulate of a simulated cut.

    **Returns:** `{"static_displacement.x": {"value": 1.3e-4, "unit": "m", "definition": "..."}, ...}`, every one of
    `DEFINITIONS` for x and y (also z if the tool moves in z), forces for x, y and z; begin and end of the phases of an
    entry; and for each side on which there is a wall ("left", "right") its form error and roughness. A quantity that this
    trace does not define has the value None and says why under "reason".
    """
    dt = float(case.cut.tooth_period(case.tool)) / case.settings.steps_per_tooth
    summary = {}
    for axis in dict.fromkeys((*AXES[:2], *sim.axes)):
        if axis in sim.axes:
            x = np.asarray(sim.displacement, dtype=float)[:, sim.axes.index(axis)]
            values = _of_displacement(x, dt, case.settings.steps_per_tooth)
        else:
            values = dict.fromkeys(_DISPLACEMENT, f"the tool does not move in {axis}")
        summary |= {f"{name}.{axis}": _entry(name, value) for name, value in values.items()}
    revolution = case.settings.steps_per_tooth * case.tool.teeth
    for axis, force in zip(AXES, np.asarray(sim.force, dtype=float).T, strict=True):
        summary |= {f"{name}.{axis}": _entry(name, value) for name, value in _of_force(force, revolution).items()}
    for phase, between in phases(case, sim).items():
        for end, value in zip(("begin", "end"), between or ("the cut has no such phase",) * 2, strict=True):
            summary[f"phase_{phase}.{end}"] = _entry(f"phase_{phase}.{end}", value)
    for side in walls(case):
        summary |= {f"{name}.{side}": _entry(name, value) for name, value in _of_wall(case, sim, side).items()}
    return summary


_DISPLACEMENT = ("static_displacement", "overshoot", "settling_time", "first_frequency")


def _of_wall(case: Case, sim: Simulation, side) -> dict[str, float | str]:
    wall = wall_profile(case, sim, side)
    found = roughness(wall)
    values = {"form_error": form_error(wall), "roughness_ra": found.ra, "roughness_rz": found.rz}
    short = "the wall is shorter than two turns of the tool"
    return {name: float(value) if math.isfinite(value) else short for name, value in values.items()}


def _entry(name: str, value: float | str) -> dict[str, Any]:
    unit, definition = DEFINITIONS[name]
    if isinstance(value, str):
        return {"value": None, "unit": unit, "definition": definition, "reason": value}
    return {"value": value, "unit": unit, "definition": definition}


def _of_displacement(x: Float[np.ndarray, " steps"], dt: float, period: int) -> dict[str, float | str]:
    """A number, or the reason why there is none, for every quantity of a displacement."""
    if x.size < _LEAST_PERIODS * period:
        return dict.fromkeys(_DISPLACEMENT, f"the trace is shorter than {_LEAST_PERIODS} tooth periods")
    if np.abs(x).max() < _SMALLEST:
        return dict.fromkeys(_DISPLACEMENT, "the displacement is zero") | {"static_displacement": 0.0}
    tail = x[x.size // 2 :]
    static = float(np.average(tail, weights=np.hanning(tail.size)))
    return {
        "static_displacement": static,
        "overshoot": _overshoot(x, static),
        "settling_time": _settling_time(x, static, dt, period),
        "first_frequency": _first_frequency(x, dt, period),
    }


def _overshoot(x, static: float) -> float | str:
    if abs(static) < _SMALLEST:
        return "the static displacement is zero"
    return float(100 * (np.abs(x).max() / abs(static) - 1))


def _settling_time(x, static: float, dt: float, period: int) -> float | str:
    if abs(static) < _SMALLEST:
        return "the static displacement is zero"
    averaged = np.convolve(x, np.full(period, 1 / period), mode="valid")
    outside = np.flatnonzero(np.abs(averaged - static) > SETTLED * abs(static))
    if outside.size == 0:
        return 0.0
    if outside[-1] == averaged.size - 1:
        return "the displacement is outside the band at the end of the trace: simulate longer"
    return float((outside[-1] + 1 + period / 2) * dt)


def _first_frequency(x, dt: float, period: int) -> float | str:
    # The derivative of the moving average is the difference over its window.
    velocity = (x[period:] - x[:-period]) / (period * dt)
    duration = velocity.size * dt
    padded = 2 ** math.ceil(math.log2(16 * velocity.size))
    spectrum = np.abs(np.fft.rfft(velocity, padded))
    step = 1 / (padded * dt)
    inner = spectrum[1:-1]
    peaks = np.flatnonzero((inner > spectrum[:-2]) & (inner >= spectrum[2:])) + 1
    # Fewer than one cycle in the trace is a drift, not a vibration.
    peaks = peaks[peaks * step > 1 / duration]
    peaks = peaks[spectrum[peaks] > _LEAST_PEAK * spectrum.max()]
    if peaks.size == 0:
        return "no peak of the spectrum stands out: the tool does not vibrate for a whole cycle, or is strongly damped"
    k = peaks[np.argmax(spectrum[peaks])]
    left, top, right = spectrum[k - 1 : k + 2]
    return float((k + 0.5 * (left - right) / (left - 2 * top + right)) * step)


def _of_force(force: Float[np.ndarray, " steps"], revolution: int) -> dict[str, float | str]:
    revolutions = force.size // 2 // revolution or force.size // revolution
    if revolutions == 0:
        return dict.fromkeys(("mean_force", "peak_force"), "the trace is shorter than one revolution")
    tail = force[-revolutions * revolution :]
    return {"mean_force": float(tail.mean()), "peak_force": float(np.abs(tail).max())}
