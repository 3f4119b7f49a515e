"""A first guess of a trace's clock: when its first sample was taken, and how far the spindle was off its speed.

In a steady cut forces repeat with every turn of the spindle. Their amplitudes at multiples of the spindle frequency,

    Y_h = mean of y(t) exp(-i h W (1 + e) t)  over whole turns,

are the largest where e is the true error of the speed W; and those of the model, M_h, follow from them by the angle between
the two: the shift with the largest sum of Re(conj(M_h) Y_h exp(-i h shift)) over harmonics and forces. Neither the scale nor
an offset of a force matters, so coefficients may be wrong by a factor.
"""

import numpy as np

from millax import Case, Clock, simulate

from ._measured import TraceError
from ._traces import Trace

HARMONICS = 4
"""Multiples of the tooth frequency looked at: those beyond are weak, and turned in phase by resonances."""

SPEED = 0.005
"""Largest error of the speed looked for."""

PHASES = 2048
"""Angles of a turn tried, before the best is refined."""


def align(case: Case, trace: Trace) -> Clock:
    """The clock with which a trace of a steady cut fits best to a simulation of `case`.

    **Arguments:**

    - `case`: coefficients need not be right, the signs of forces must. The trace is taken to begin within one turn after its
      `clock.start`, 0 where there is none: give one after which the cut is steady.
    - `trace`: with a force at least, two turns long or longer.

    **Returns:** the `Clock`, `start` right to a few degrees of spindle rotation, `speed_error` between -0.5 % and 0.5 %,
    right to a small part of a turn over the length of the trace. Both are meant to be fitted then.

    Raises `TraceError` for a trace without forces, one of less than two turns, and where the simulation has no whole turn
    after `clock.start` or no force in it.
    """
    forces = [channel for channel in trace.channels if channel.startswith("F")]
    if not forces:
        raise TraceError(f"{trace.name}: it has no force, which is what tells the phase of the spindle")
    speed = float(case.cut.spindle_speed)
    turns = len(trace.time) * trace.step * speed / (2 * np.pi)
    if turns < 2:
        raise TraceError(f"{trace.name}: {turns:.2g} turns of the spindle long; two at least are needed to find its phase")
    earliest = 0.0 if case.clock is None else float(case.clock.start)
    harmonics = np.arange(1, HARMONICS * case.tool.teeth + 1)
    measured = trace.values[:, [trace.channels.index(channel) for channel in forces]]
    time = trace.time - trace.time[0]
    error = speed_error(time, measured, speed, harmonics)
    found = _amplitudes(time, measured, speed * (1 + error), harmonics)
    model = _amplitudes(*_one_turn(case, trace, forces, earliest), speed, harmonics)
    # The trace at its time 0 is where the model is after this angle.
    cross = np.sum(found * model.conj(), axis=1)
    angles = 2 * np.pi * np.arange(PHASES) / PHASES
    fit = np.real(np.exp(-1j * np.outer(angles, harmonics)) @ cross)
    angle = angles[np.argmax(fit)] + _refined(fit, int(np.argmax(fit))) * angles[1]
    return Clock(earliest + (angle % (2 * np.pi)) / speed, error)


def _one_turn(case: Case, trace: Trace, forces: list[str], earliest: float) -> tuple[np.ndarray, np.ndarray]:
    """Times since `earliest` and forces, less their means, of the first turn of the model from there on."""
    sim = simulate(case, throw=False)
    time, force = np.asarray(sim.time), sim.force
    if case.sensor is not None:
        force = case.sensor(force, time[1] - time[0])
    turn = case.tool.teeth * case.settings.steps_per_tooth
    first = int(np.searchsorted(time, earliest))
    if first + turn > len(time):
        raise TraceError(
            f"{trace.name}: no whole turn of the spindle is simulated after clock.start = {earliest:.6g} s, of "
            f"{len(time) * (time[1] - time[0]):.6g} s; raise simulation.duration"
        )
    part = np.asarray(force)[first : first + turn, ["xyz".index(channel[1]) for channel in forces]]
    if not (np.isfinite(part).all() and (part - part.mean(axis=0)).any()):
        raise TraceError(f"{trace.name}: the simulation has no force in the turn after clock.start = {earliest:.6g} s")
    return time[first : first + turn] - earliest, part


def _amplitudes(time: np.ndarray, values: np.ndarray, speed: float, harmonics: np.ndarray) -> np.ndarray:
    """Complex amplitudes of the forces at multiples of a speed, shape (harmonics, forces), over whole turns."""
    step = (time[-1] - time[0]) / (len(time) - 1)
    turn = 2 * np.pi / speed
    whole = round(float(np.floor(len(time) * step / turn + 1e-6) * turn / step))
    wave = np.exp(-1j * speed * np.outer(harmonics, time[:whole]))
    return wave @ (values[:whole] - values[:whole].mean(axis=0)) / whole


def speed_error(time: np.ndarray, values: np.ndarray, speed: float, harmonics: np.ndarray) -> float:
    """That with the most power at the multiples of the speed."""
    # Turn by turn, so that every error tried is a short sum.
    turn = 2 * np.pi / speed
    starts = np.searchsorted(time, np.arange(0.0, time[-1], turn))
    wave = np.exp(-1j * speed * np.outer(harmonics, time))[..., None] * (values - values.mean(axis=0))
    parts = np.add.reduceat(wave, starts, axis=1)
    # The line of the highest harmonic is 1 / (its cycles) wide: a fifth of it apart none is missed.
    step = 0.2 / (harmonics[-1] * time[-1] / turn)
    errors = np.arange(-np.ceil(SPEED / step), np.ceil(SPEED / step) + 1) * step
    middle = (np.arange(len(starts)) + 0.5) * turn
    turned = np.exp(-1j * speed * errors[:, None, None] * harmonics[:, None] * middle)
    power = np.sum(np.abs(np.einsum("ehb,hbc->ehc", turned, parts)) ** 2, axis=(1, 2))
    best = int(np.argmax(power))
    return float(np.clip(errors[best] + _refined(power, best) * step, -SPEED, SPEED))


def _refined(values: np.ndarray, best: int) -> float:
    """Where the parabola through the largest value and its neighbours, in a ring, has its top: in steps from there."""
    before, top, after = values[[best - 1, best, (best + 1) % len(values)]]
    curvature = before - 2 * top + after
    return float(0.5 * (before - after) / curvature) if curvature < 0 else 0.0
