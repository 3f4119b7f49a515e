"""A trace beside a simulation: the model's channels at the trace's own sample times."""

from collections.abc import Collection

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from millax import Case, Simulation
from millax._types import AXES

from ._measured import TraceError
from ._resample import kernel, resample
from ._sampling import UNEVEN
from ._traces import Trace

PER_TOOTH = 4
"""Fewest samples per tooth period: with fewer, the force of a tooth is not resolved."""

PERIODS = 3
"""Fewest tooth periods in a trace."""


class Comparison(eqx.Module):
    """One trace, ready to be compared with simulations of one case.

    The sample j of a simulation belongs to the middle of its time step j. Where the case has a sensor or a clock, the trace
    is one of an instrument: the forces are what the sensor makes of them, and the model is read at the times of the clock,
    limited to the band that a trace sampled at this rate holds, see `_resample`.

    Where the case has neither, the times are those of the simulation, and the model is interpolated linearly: second order
    in the step, as the simulation is, and differentiable also where the step depends on a free spindle speed. Before the
    first and after the last sample it is continued by the half step they stand for. Where the trace has the time stamps of
    the simulation, or every k-th of them, up to their rounding, `taken` says which samples to take as they are (first,
    last + 1, k); otherwise it is None.
    """

    time: Float[Array, " samples"]
    measured: Float[Array, "channels samples"]
    kernel: Float[np.ndarray, "coefficients taps"] | None
    taken: tuple[int, int, int] | None = eqx.field(static=True)
    channels: tuple[str, ...] = eqx.field(static=True)

    def predict(self, sim: Simulation, case: Case) -> Float[Array, "channels samples"]:
        """The model's channels [N, m] at the times of the trace, of a case and its simulation."""
        step, force = sim.time[1] - sim.time[0], sim.force
        if case.sensor is not None:
            force = case.sensor(force, step)
        model = jnp.stack(
            [
                sim.displacement[:, sim.axes.index(channel)] if channel in AXES else force[:, "xyz".index(channel[1])]
                for channel in self.channels
            ]
        )
        if self.taken is not None:
            return model[:, slice(*self.taken)]
        time = _simulated(self.time, case)
        if self.kernel is None:
            position = _position(time, sim.time)
            before = jnp.clip(jnp.floor(position), 0, len(sim.time) - 2).astype(int)
            weight = position - before
            return (1 - weight) * model[:, before] + weight * model[:, before + 1]
        if case.sensor is None:
            return resample(model, _position(time, sim.time), self.kernel)
        # Only forces go through the sensor, and are late by its delay.
        moves = np.array([channel in AXES for channel in self.channels])
        parts = [
            resample(model[which], _position(time - delay, sim.time), self.kernel)
            for which, delay in ((np.flatnonzero(moves), 0.0), (np.flatnonzero(~moves), case.sensor.delay))
            if len(which)
        ]
        return jnp.concatenate(parts)[np.argsort(np.argsort(~moves, stable=True))]

    def covered(self, sim: Simulation, case: Case) -> Bool[Array, ""]:
        """Whether the simulation is long enough for the trace."""
        position = _position(_simulated(self.time, case)[jnp.array([0, -1])], sim.time)
        return (position[0] >= -0.5 - UNEVEN) & (position[1] <= len(sim.time) - 0.5 - _margin(self.kernel) + UNEVEN)


def compare(trace: Trace, case: Case, free_names: Collection[str] = ()) -> Comparison:
    """Check `trace` against `case`, in which the numbers `free_names` will vary.

    Raises `TraceError` for a displacement in a direction in which the structure does not move, an axial force where the law
    has none, a trace sampled too coarsely or too short for the tooth period, and one that begins before the
    simulation or ends after it.
    """
    axes = case.at_tool.axes
    for channel in trace.channels:
        if channel in AXES and channel not in axes:
            moves = f"only along {', '.join(axes)}" if axes else "not at all: it is rigid"
            raise TraceError(
                f"{trace.name}: channel {channel}: the structure of the case moves {moves}. Leave the channel out, or "
                "add the axis to the structure"
            )
        if channel == "Fz" and case.force.ka is None:
            raise TraceError(
                f"{trace.name}: channel Fz: the force law has no axial force. Give force.ka, or leave the channel out"
            )
    tooth_period = float(case.cut.tooth_period(case.tool))
    step = tooth_period / case.settings.steps_per_tooth
    resolves_teeth(trace, tooth_period)
    length = len(trace.time) * trace.step
    if length < PERIODS * tooth_period * (1 - 1e-9):
        raise TraceError(
            f"{trace.name}: {length:.4g} s long, {length / tooth_period:.2g} tooth periods; at least {PERIODS} "
            f"({PERIODS * tooth_period:.4g} s) are needed"
        )
    instrument = case.clock is not None or case.sensor is not None
    band = kernel(0.5 * step / trace.step) if instrument else None
    margin, time = _margin(band), np.asarray(_simulated(trace.time, case))
    position = _position(time, (np.arange(2) + 0.5) * step)
    if position[0] < -0.5 - UNEVEN:
        cure = "Choose a window, or say with [clock] what its first sample is" if case.clock is None else "Raise clock.start"
        raise TraceError(f"{trace.name}: it begins at {time[0]:.6g} s, before the simulation does at 0 s. {cure}")
    steps = case.settings.steps
    if position[-1] > steps - 0.5 - margin + UNEVEN:
        end = f"{steps * step:.6g} s" + (f", of which the last {margin} steps cannot be read" if margin else "")
        raise TraceError(
            f"{trace.name}: it ends at {time[-1]:.6g} s, after the simulation does at {end}. "
            "Raise simulation.duration, or choose a window"
        )
    nearest = np.rint(position).astype(int)
    aligned = not instrument and "cut.spindle_speed" not in free_names and np.abs(position - nearest).max() <= UNEVEN
    taken = (int(nearest[0]), int(nearest[-1]) + 1, int(nearest[1] - nearest[0])) if aligned else None
    return Comparison(jnp.asarray(trace.time), jnp.asarray(trace.values.T), band, taken, trace.channels)


def resolves_teeth(trace: Trace, tooth_period: float) -> None:
    """Raise `TraceError` for a trace sampled too coarsely for the force of a tooth."""
    if trace.step > tooth_period / PER_TOOTH * (1 + 1e-9):
        raise TraceError(
            f"{trace.name}: sampled every {trace.step:.4g} s, {tooth_period / trace.step:.2g} times per tooth period "
            f"({tooth_period:.4g} s); at least {PER_TOOTH} are needed. Are spindle speed and unit of time right?"
        )


def _simulated(time, case: Case):
    """Times of the simulation for those of a trace."""
    return time if case.clock is None else case.clock(time)


def _margin(band: np.ndarray | Array | None) -> int:
    """Steps at the end of the simulation from which nothing can be read by a kernel: it is not known what follows them."""
    return 0 if band is None else band.shape[1] // 2


def _position(time, model_time):
    """`time` counted in samples of the model, whose first two are at `model_time[:2]`."""
    return (time - model_time[0]) / (model_time[1] - model_time[0])
