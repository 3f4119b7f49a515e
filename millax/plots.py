"""Pictures of simulated cuts and of sweeps. Needs matplotlib, which nothing else in the package imports."""

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure

from ._case import Case
from ._simulate import Simulation
from ._stability import STABILITY_METHODS
from ._surface import Wall, phases
from ._types import AXES
from ._units import si_scale

if TYPE_CHECKING:
    import xarray

COLOURS = {"x": "#0072B2", "y": "#D55E00", "z": "#009E73"}
"""Colours of the axes, told apart by colour-blind readers too (Okabe and Ito)."""

WALL_COLOURS = {"left": "#CC79A7", "right": "#009E73"}

_PREFIXES = ((1.0, ""), (1e-3, "m"), (1e-6, "µ"), (1e-9, "n"))


def plot_simulation(sim: Simulation, case: Case, *, zoom_periods: int = 3) -> Figure:
    """Forces and displacement against time: the whole cut at the left, its last tooth periods at the right.

    The whole cut is drawn as a band from the smallest to the largest value in each tooth period, with the mean in it. Grey
    behind it: phases Ia and Ib of the entry.

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
    grid[0, 1].set_title(f"last {periods} tooth periods", loc="left", fontsize="medium")
    grid[-1, 0].set_xlabel("time [s]")
    grid[-1, 1].set_xlabel("time [ms]")

    entry = {name: between for name, between in phases(case, sim).items() if between and name != "II"}
    for between, shade in zip(entry.values(), (0.2, 0.1), strict=False):
        for axes in grid[:, 0]:
            axes.axvspan(*between, color="0.4", alpha=shade, linewidth=0)
    words = f"; grey: phase {', '.join(entry)}" if entry else ""
    grid[0, 0].set_title(f"mean and range of every tooth period{words}", loc="left", fontsize="medium")
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


def plot_wall(walls: Sequence[Wall], case: Case, *, zoom_turns: int = 3) -> Figure:
    """How far the walls of a cut lie from their nominal place: the whole cut at the left, its last turns at the right.

    The whole wall is drawn as a band from the smallest to the largest deviation in each turn of the tool, with the mean in
    it; at the right the mean is taken out. Up is material left.

    **Arguments:**

    - `walls`: one or both walls, `millax.wall_profile` along the whole path, and `case`, the case they came from.
    - `zoom_turns`: turns of the tool at the right, >= 1.

    Raises `ValueError` where no wall has a point.
    """
    there = [np.isfinite(np.asarray(wall.y)) for wall in walls]
    if not any(map(np.any, there)):
        raise ValueError("there is nothing to draw: none of the walls has a point")
    turn = case.tool.teeth * float(case.cut.feed_per_tooth(case.tool))
    figure = Figure(figsize=(10, 3.4), layout="constrained")
    whole, zoom = figure.subplots(1, 2)
    parts = {
        wall.side: (np.asarray(wall.x)[inside], np.asarray(wall.deviation)[inside])
        for wall, inside in zip(walls, there, strict=True)
        if inside.any()
    }
    ends = {side: x > x[-1] - zoom_turns * turn for side, (x, _) in parts.items()}
    marks = {side: z[ends[side]] - z[ends[side]].mean() for side, (_, z) in parts.items()}
    scale, prefix = si_prefix(z for _, z in parts.values())
    zoom_scale, zoom_prefix = si_prefix(marks.values())
    for side, (x, z) in parts.items():
        words = f"{side}: {'up' if side == 'left' else 'down'}-milling"
        per_turn = max(1, round(turn / float(np.median(np.diff(x)))) if x.size > 1 else 1)
        draw_band(whole, 1e3 * x, z / scale, min(per_turn, x.size), colour=WALL_COLOURS[side], label=words)
        # The two may coincide: one line is wider than the other.
        width = 3.0 if side == "left" else 1.2
        zoom.plot(1e3 * x[ends[side]], marks[side] / zoom_scale, color=WALL_COLOURS[side], linewidth=width)
    whole.axhline(0, color="0.4", linewidth=0.8)
    whole.set_title("whole wall: mean and range of every turn", loc="left", fontsize="medium")
    zoom.set_title(f"last {zoom_turns} turns, less their mean", loc="left", fontsize="medium")
    for axes in (whole, zoom):
        tidy(axes)
        axes.set_xlabel("x [mm]")
    whole.set_ylabel(f"material left [{prefix}m]")
    zoom.set_ylabel(f"material left [{zoom_prefix}m]")
    whole.legend(frameon=False)
    return figure


def plot_sweep(dataset: "xarray.Dataset", quantities: str | Sequence[str] | None = None) -> Figure:
    """The results of `millax.sweep`: curves over one varied number, maps over two, histograms of samples.

    Each quantity has a row; in maps each axis of the workpiece has a column. Members whose status is not 0 are crossed
    out. Of a third varied number, and those after it, the middle value is drawn.

    **Arguments:**

    - `dataset`: what `millax.sweep` returned.
    - `quantities`: names of variables with one number, or one per axis, for every member; None: mean force and vibration,
      or whatever there is.

    Raises `ValueError` for a name that is none of these.
    """
    varied = [str(dim) for dim in dataset["status"].dims]
    can = [
        str(name)
        for name, v in dataset.data_vars.items()
        if set(v.dims) - set(varied) <= {"axis"} and name not in ("status", "residual", "simulated_time")
    ]
    chosen = [quantities] if isinstance(quantities, str) else list(quantities or _usual(can))
    for name in chosen:
        if name not in can:
            raise ValueError(f"{name}: it cannot be drawn; choose from {', '.join(can)}")
    if not chosen:
        raise ValueError("there is nothing to draw: no variable has one number, or one per axis, for every member")
    middle = {dim: dataset.sizes[dim] // 2 for dim in varied[2:]}
    part, varied = dataset.isel(middle), varied[:2]
    if varied == ["sample"] or not varied:
        figure = _histograms(part, chosen)
    else:
        figure = _curves(part, chosen, varied[0]) if len(varied) == 1 else _maps(part, chosen, varied)
    if middle:
        figure.suptitle("at " + ", ".join(_value(part, dim) for dim in middle), fontsize="medium")
    return figure


def plot_stability(dataset: "xarray.Dataset") -> Figure:
    """The stability lobe diagram of `millax.stability`: limit depth over spindle speed.

    The first method is drawn as a line, unstable above it, the others as marks; with depths, the colours are the spectral
    radius.
    """
    figure = Figure(figsize=(8, 4.2), layout="constrained")
    axes = figure.subplots()
    tidy(axes)
    speed = dataset["cut.spindle_speed"].to_numpy()
    known = dataset["limit_depth"].to_numpy()
    known = known[np.isfinite(known)]
    if "spectral_radius" in dataset:
        depth = dataset["cut.depth"].to_numpy() * (1e3 * si_scale(dataset["cut.depth"].attrs["units"]))
        radius = dataset["spectral_radius"].to_numpy().T
        image = axes.pcolormesh(speed, depth, radius, cmap="RdBu_r", vmin=0.5, vmax=1.5, shading="nearest")
        figure.colorbar(image, label="spectral radius [-]: stable below 1", extend="both")
    styles: tuple[dict[str, Any], ...] = (
        {"color": "black", "linewidth": 1.4},
        {"marker": "o", "color": "#D55E00"},
        {"marker": "x", "color": "#0072B2"},
    )
    for i, (method, limits) in enumerate(zip(dataset["analysis"].to_numpy(), dataset["limit_depth"], strict=True)):
        limit = 1e3 * limits.to_numpy()
        style: dict[str, Any] = styles[i % 3] | ({"linestyle": "none", "markersize": 5, "fillstyle": "none"} if i else {})
        axes.plot(speed, limit, label=STABILITY_METHODS[str(method)], **style)
        if i == 0 and "spectral_radius" not in dataset and known.size:
            top = 1.05e3 * known.max()
            axes.fill_between(speed, np.where(np.isfinite(limit), limit, top), top, color="0.9", linewidth=0)
            axes.set_ylim(0, top)
    axes.set(xlabel=f"spindle speed [{dataset['cut.spindle_speed'].attrs['units']}]", ylabel="axial depth of cut [mm]")
    axes.set_title("limit of stability: unstable above", loc="left", fontsize="medium")
    figure.legend(frameon=False, fontsize="x-small", loc="outside lower center", ncols=3, columnspacing=1.2)
    return figure


def _usual(can: Sequence[str]) -> list[str]:
    return [name for name in ("mean_force", "std_displacement") if name in can] or list(can[:2])


def _by_axis(v: "xarray.DataArray") -> "dict[str, xarray.DataArray]":
    """A quantity along every axis where it is not zero throughout."""
    if "axis" not in v.dims:
        return {"": v}
    parts = {str(axis): v.sel(axis=axis) for axis in v["axis"].to_numpy()}
    moving = {axis: part for axis, part in parts.items() if np.any(np.nan_to_num(part.to_numpy()))}
    return moving or {"x": parts["x"]}


def _curves(dataset: "xarray.Dataset", names: Sequence[str], dim: str) -> Figure:
    figure = Figure(figsize=(7, 2.8 * len(names)), layout="constrained")
    failed = dataset["status"].to_numpy() != 0
    x = dataset[dim].to_numpy()
    grid = figure.subplots(len(names), 1, sharex=True, squeeze=False)[:, 0]
    for axes, name in zip(grid, names, strict=True):
        tidy(axes)
        parts = _by_axis(dataset[name])
        scale, unit = _scaled_unit(dataset[name])
        for axis, part in parts.items():
            axes.plot(x, part.to_numpy() / scale, ".-", color=COLOURS.get(axis, "0.2"), label=axis)
        if failed.any():
            bottom = np.zeros(failed.sum())
            axes.plot(
                x[failed], bottom, "x", color="0.4", transform=axes.get_xaxis_transform(), clip_on=False, label="failed"
            )
        axes.set_ylabel(f"{_words(name)}{unit}")
        if len(parts) > 1 or failed.any():
            axes.legend(frameon=False)
    grid[-1].set_xlabel(_label(dataset, dim))
    return figure


def _maps(dataset: "xarray.Dataset", names: Sequence[str], dims: Sequence[str]) -> Figure:
    rows = {name: _by_axis(dataset[name]) for name in names}
    columns = max(map(len, rows.values()))
    figure = Figure(figsize=(4.6 * columns + 0.6, 3.3 * len(names)), layout="constrained")
    grid = figure.subplots(len(names), columns, sharex=True, sharey=True, squeeze=False)
    x, y = (dataset[dim].to_numpy() for dim in dims)
    failed = (dataset["status"].transpose(*dims).to_numpy() != 0).T
    for row, (name, parts) in zip(grid, rows.items(), strict=True):
        scale, unit = _scaled_unit(dataset[name])
        for axes in row[len(parts) :]:
            axes.set_axis_off()
        for axes, (axis, part) in zip(row, parts.items(), strict=False):
            values = part.transpose(*dims).to_numpy().T / scale
            image = axes.pcolormesh(x, y, np.ma.masked_invalid(values), shading="nearest", norm=_norm(values))
            axes.set_facecolor("0.85")
            if failed.any():
                axes.plot(*_points(x, y, failed), "x", color="0.4", markersize=4, linestyle="none")
            figure.colorbar(image, ax=axes, label=f"{_words(name)}{f' {axis}' if axis else ''}{unit}")
    for axes in grid[-1]:
        axes.set_xlabel(_label(dataset, dims[0]))
    for axes in grid[:, 0]:
        axes.set_ylabel(_label(dataset, dims[1]))
    if failed.any():
        figure.supxlabel("grey and crossed out: could not be simulated, see the status", fontsize="small")
    return figure


def _histograms(dataset: "xarray.Dataset", names: Sequence[str]) -> Figure:
    figure = Figure(figsize=(7, 2.8 * len(names)), layout="constrained")
    for axes, name in zip(figure.subplots(len(names), 1, squeeze=False).flat, names, strict=True):
        tidy(axes)
        scale, unit = _scaled_unit(dataset[name])
        for axis, part in _by_axis(dataset[name]).items():
            values = part.to_numpy().ravel() / scale
            values = values[np.isfinite(values)]
            label = f"{axis}  {values.mean():.4g} ± {values.std():.2g}".strip()
            axes.hist(values, bins="auto", color=COLOURS.get(axis, "0.4"), alpha=0.6, label=label)
        axes.set(xlabel=f"{_words(name)}{unit}", ylabel="samples")
        axes.legend(frameon=False, title="mean ± standard deviation", title_fontsize="small")
    return figure


def _points(x: np.ndarray, y: np.ndarray, which: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    rows, columns = np.nonzero(which)
    return x[columns], y[rows]


def _norm(values: np.ndarray) -> LogNorm | None:
    """Colours by the logarithm where the numbers have one sign and span more than two decades."""
    known = values[np.isfinite(values)]
    return LogNorm(known.min(), known.max()) if known.size and 0 < 100 * known.min() < known.max() else None


def _scaled_unit(v: "xarray.DataArray") -> tuple[float, str]:
    """What to divide by, and the unit in brackets: (1e-6, " [µm]")."""
    unit, known = v.attrs.get("units", ""), v.to_numpy()[np.isfinite(v.to_numpy())]
    if unit not in ("m", "s") or known.size == 0:
        return 1.0, f" [{unit}]" if unit else ""
    scale, prefix = si_prefix([known])
    return scale, f" [{prefix}{unit}]"


def _words(name: str) -> str:
    known = {"std_displacement": "vibration (standard deviation)"}
    return known.get(name, name.replace("_", " "))


def _label(dataset: "xarray.Dataset", dim: str) -> str:
    unit = dataset[dim].attrs.get("units", "")
    return f"{dim} [{unit}]" if unit else dim


def _value(dataset: "xarray.Dataset", name: str) -> str:
    return f"{name} = {float(dataset[name]):.4g} {dataset[name].attrs.get('units', '')}".strip()


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
