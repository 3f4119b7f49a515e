"""Pictures of simulated cuts. Needs matplotlib, which nothing else in the package imports."""

from collections.abc import Iterable

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ._case import Case
from ._simulate import Simulation
from ._types import AXES

COLOURS = {"x": "#0072B2", "y": "#D55E00", "z": "#009E73"}
"""Colours of the axes, told apart by colour-blind readers too (Okabe and Ito)."""

_PREFIXES = ((1.0, ""), (1e-3, "m"), (1e-6, "µ"), (1e-9, "n"))


def plot_simulation(sim: Simulation, case: Case, *, zoom_periods: int = 3) -> Figure:
    """Forces and displacement against time: the whole cut at the left, its last tooth periods at the right.

    The whole cut is drawn as a band from the smallest to the largest value in each tooth period, with the mean in it.

    **Arguments:**

    - `sim`, `case`: a simulation and the case it came from.
    - `zoom_periods`: tooth periods at the right, >= 1.
    """
    steps, periods = case.settings.steps_per_tooth, min(zoom_periods, case.settings.periods)
    time, last = np.asarray(sim.time), slice(-periods * steps, None)
    forces = {axis: f for axis, f in zip(AXES, np.asarray(sim.force).T, strict=True) if np.any(f)}
    moves = dict(zip(sim.axes, np.asarray(sim.displacement).T, strict=True))

    figure = Figure(figsize=(10, 6 if moves else 3), layout="constrained")
    grid = figure.subplots(2 if moves else 1, 2, sharex="col", squeeze=False)
    for axes in grid.flat:
        tidy(axes)
    grid[0, 0].set_title("whole cut: mean and range of every tooth period", loc="left", fontsize="medium")
    grid[0, 1].set_title(f"last {periods} tooth periods", loc="left", fontsize="medium")
    grid[-1, 0].set_xlabel("time [s]")
    grid[-1, 1].set_xlabel("time [ms]")

    for axis, force in forces.items():
        draw_band(grid[0, 0], time, force, steps, colour=COLOURS[axis], label=f"$F_{axis}$")
        grid[0, 1].plot(1e3 * time[last], force[last], color=COLOURS[axis])
    grid[0, 0].set_ylabel("force on the tool [N]")
    grid[0, 0].legend(frameon=False)
    if moves:
        # At the end the static displacement hides the vibration.
        vibrations = {axis: u[last] - u[last].mean() for axis, u in moves.items()}
        scale, prefix = si_prefix(moves.values())
        zoom_scale, zoom_prefix = si_prefix(vibrations.values())
        for axis, u in moves.items():
            draw_band(grid[1, 0], time, u / scale, steps, colour=COLOURS[axis], label=f"${axis}$")
            grid[1, 1].plot(1e3 * time[last], vibrations[axis] / zoom_scale, color=COLOURS[axis])
        grid[1, 0].set_ylabel(f"displacement [{prefix}m]")
        grid[1, 1].set_ylabel(f"displacement less its mean [{zoom_prefix}m]")
        grid[1, 0].legend(frameon=False)
    return figure


def draw_band(
    axes: Axes, time: Float[np.ndarray, " n"], trace: Float[np.ndarray, " n"], period: int, *, colour: str, label: str
) -> None:
    """Draw a long trace by its mean and its range over every `period` samples."""
    whole = len(trace) // period * period
    parts = np.asarray(trace)[:whole].reshape(-1, period)
    middle = np.asarray(time)[:whole].reshape(-1, period).mean(axis=1)
    axes.fill_between(middle, parts.min(axis=1), parts.max(axis=1), color=colour, alpha=0.25, linewidth=0)
    axes.plot(middle, parts.mean(axis=1), color=colour, linewidth=1.2, label=label)


def tidy(axes: Axes) -> None:
    """Take the frame away at the top and right, and draw a faint grid."""
    axes.spines[["top", "right"]].set_visible(False)
    axes.grid(alpha=0.25, linewidth=0.6)


def si_prefix(traces: Iterable[Float[np.ndarray, " n"]]) -> tuple[float, str]:
    """The SI prefix in which the largest number of `traces` has one to three digits before the point: (1e-6, "µ")."""
    largest = max(float(np.max(np.abs(trace))) for trace in traces)
    for scale, prefix in _PREFIXES:
        if largest >= scale:
            return scale, prefix
    return _PREFIXES[0] if largest == 0 else _PREFIXES[-1]
