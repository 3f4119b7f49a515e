"""Pictures of an arm and of its stiffness. Needs matplotlib, which nothing else in the package imports."""

from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from .._types import AXES
from ..plots import COLOURS, tidy

if TYPE_CHECKING:
    import xarray

WORDS = {"x": "x (feed)", "y": "y", "z": "z (spindle)"}
"""Directions of the workpiece frame."""

BEHIND = {"boxstyle": "square,pad=0.1", "facecolor": "white", "edgecolor": "none", "alpha": 0.8}
"""What stands behind a letter, so that it can be read on a line."""

LARGEST = 0.15
"""Half axis of the ellipsoid, as it is drawn, over the size of the arm."""

WIDE = 8.0
"""Largest over smallest number from which a map is coloured by the logarithm."""

FEW = 1e-2
"""A map whose numbers differ by less than this part of them has one colour."""

FLAT = 1e-6
"""A line or a plane: what leaves it is so much smaller than what lies in it."""


def plot_robot(dataset: "xarray.Dataset") -> Figure:
    """What `millax.robot.robot_at_tool` found: the arm from the side and from above, with the compliance ellipsoid at the
    tool, what each joint has to do with it, and how the tool answers to vibrating forces."""
    figure = Figure(figsize=(11, 8.6), layout="constrained")
    grid = figure.subplots(2, 2)
    along = _along(dataset["outline"].to_numpy())
    up = np.array([0.0, 0.0, 1.0])
    enlarged = _enlargement(dataset)
    _view(grid[0, 0], dataset, along, up, enlarged)
    grid[0, 0].set(xlabel="distance from the base, towards the tool [m]", ylabel="height [m]")
    grid[0, 0].set_title("from the side", loc="left", fontsize="medium")
    _view(grid[0, 1], dataset, along, np.cross(up, along), enlarged)
    grid[0, 1].set(xlabel="distance from the base, towards the tool [m]", ylabel="sideways [m]")
    grid[0, 1].set_title("from above", loc="left", fontsize="medium")
    handles, labels = grid[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=len(labels), frameon=False)
    _bars(grid[1, 0], dataset)
    _receptance(grid[1, 1], dataset)
    return figure


def plot_stiffness_map(dataset: "xarray.Dataset") -> Figure:
    """The map of `millax.robot.stiffness_map`: free stiffness along x, y and z, and the lowest natural frequency.

    Drawn over the place of the tool where the two joints move it in a vertical plane and every place is reached in one way
    only; else over the joints, out of the limits grey. The outermost hundredth of the numbers is beyond the colours.
    """
    dims = [str(dim) for dim in dataset["lowest_frequency"].dims]
    place = _in_a_plane(dataset)
    if place is None:
        x, y = np.meshgrid(*(dataset[dim].to_numpy() for dim in dims), indexing="ij")
        arm = np.array([[dataset[dim].attrs["pose"] for dim in dims]])
        labels = [f"{dim} [{dataset[dim].attrs['units']}]" for dim in dims]
    else:
        along, x, y = place
        outline = dataset["outline"].to_numpy()
        arm = np.stack([(outline - outline[0]) @ along, outline[:, 2]], axis=1)
        labels = ["distance from the base, in the plane of the arm [m]", "height [m]"]
    figure = Figure(figsize=(11, 8.6), layout="constrained")
    grid = figure.subplots(2, 2, sharex=True, sharey=True)
    parts = [
        (1e-6 * dataset["free_stiffness"].sel(axis=axis).to_numpy(), f"free stiffness along {WORDS[axis]} [N/µm]")
        for axis in AXES
    ]
    parts.append((dataset["lowest_frequency"].to_numpy(), "lowest natural frequency [Hz]"))
    for axes, (values, words) in zip(grid.flat, parts, strict=True):
        image = axes.contourf(x, y, np.ma.masked_invalid(values), extend="both", **_colours(values))
        figure.colorbar(image, ax=axes, ticks=image.levels, format="%.4g")
        axes.plot(*arm.T, "-o", color="0.35", linewidth=2, markersize=4)
        axes.plot(*arm[-1], "o", mfc="white", mec="black", zorder=3)
        axes.set_title(words, loc="left", fontsize="medium")
        if place is None:
            axes.set(xlim=(x.min(), x.max()), ylim=(y.min(), y.max()), facecolor="0.85")
        else:
            axes.set_aspect("equal")
            tidy(axes)
    for axes in grid[-1]:
        axes.set_xlabel(labels[0])
    for axes in grid[:, 0]:
        axes.set_ylabel(labels[1])
    spread = " and ".join(_span(dataset, dim) for dim in dims)
    figure.suptitle(f"{spread}; x, y and z turn with the tool. White: the pose of the case", fontsize="medium")
    return figure


def _view(axes: Axes, dataset: "xarray.Dataset", right, up, enlarged: float) -> None:
    """The arm as seen with `right` to the right and `up` up."""
    view = np.stack([right, up])
    outline = dataset["outline"].to_numpy()
    line = (outline - outline[0] * [1, 1, 0]) @ view.T
    axes.plot(*line[:-1].T, "-", color="0.35", linewidth=4, solid_capstyle="round")
    axes.plot(*line[1:-2].T, "o", color="white", markeredgecolor="0.35", markersize=7, label="joint")
    axes.plot(*line[-2:].T, "-", color="0.6", linewidth=3)
    turn, tool = dataset["workpiece_axes"].to_numpy(), line[-1]
    compliance = turn @ dataset["compliance"].to_numpy()[:3, :3] @ turn.T
    value, axis = np.linalg.eigh(view @ compliance @ compliance.T @ view.T)
    angle = np.linspace(0, 2 * np.pi, 200)
    half = enlarged * 1e3 * np.sqrt(np.maximum(value, 0))
    edge = tool[:, None] + axis @ (half[:, None] * np.array([np.cos(angle), np.sin(angle)]))
    words = f"where 1 kN in any direction moves the tool, enlarged {enlarged:.6g} times"
    axes.fill(*edge, color="#E69F00", alpha=0.45, linewidth=0, label=words)
    axes.plot(*edge, color="#E69F00", linewidth=1)
    length = 1.2 * LARGEST * _size(outline)
    ends: list[tuple[str, np.ndarray]] = []
    for name, direction in zip(AXES, length * (view @ turn).T, strict=True):
        if np.linalg.norm(direction) < 0.1 * length:
            continue
        axes.annotate("", tool + direction, tool, arrowprops={"arrowstyle": "->", "color": COLOURS[name], "linewidth": 1.6})
        same = [i for i, (_, end) in enumerate(ends) if np.linalg.norm(end - direction) < 0.2 * length]
        if same:  # seen from here they are one
            ends[same[0]] = (f"{ends[same[0]][0]}, {name}", direction)
        else:
            ends.append((name, direction))
    for name, direction in ends:
        x, y = tool + direction * (1 + 0.2 * length / np.linalg.norm(direction))
        axes.text(x, y, name, color=COLOURS.get(name, "0.2"), ha="center", va="center", bbox=BEHIND)
    axes.update_datalim([tool - 1.3 * length, tool + 1.3 * length])
    axes.set_aspect("equal", adjustable="datalim")
    tidy(axes)


def _bars(axes: Axes, dataset: "xarray.Dataset") -> None:
    part = dataset["contribution"]
    springs = [str(name) for name in part["spring"].to_numpy()]
    place = np.arange(len(springs))
    for i, axis in enumerate(AXES):
        axes.barh(place + 0.26 * (i - 1), 100 * part.sel(axis=axis), 0.26, color=COLOURS[axis], label=WORDS[axis])
    axes.set_yticks(place, springs)
    axes.invert_yaxis()
    axes.set(xlabel="part of the compliance along that direction [%]")
    axes.set_title("which joint gives way", loc="left", fontsize="medium")
    tidy(axes)
    axes.grid(visible=False, axis="y")
    axes.legend(frameon=False)


def _receptance(axes: Axes, dataset: "xarray.Dataset") -> None:
    frequency = dataset["frequency"].to_numpy()
    for axis in AXES:
        axes.loglog(frequency, 1e9 * dataset["receptance"].sel(axis=axis), color=COLOURS[axis], label=WORDS[axis])
    for natural in dataset["natural_frequency"].to_numpy():
        axes.axvline(natural, color="0.5", linewidth=0.8, linestyle=":")
        axes.annotate(
            f"{natural:.3g}",
            (natural, 1),
            xycoords=("data", "axes fraction"),
            xytext=(0, 2),
            textcoords="offset points",
            ha="center",
            va="bottom",
            fontsize="x-small",
            color="0.35",
            rotation=60,
        )
    axes.set(xlabel="frequency [Hz]", ylabel="vibration along a force, over it [µm/kN]")
    axes.set_title("receptance; dotted: natural frequencies [Hz]", loc="left", fontsize="medium", pad=22)
    tidy(axes)
    axes.legend(frameon=False)


def _along(outline: Float[np.ndarray, "points 3"]) -> Float[np.ndarray, " 3"]:
    """The horizontal direction from the base to the tool; x where the tool is above the base."""
    across = (outline[-1] - outline[0]) * [1, 1, 0]
    length = np.linalg.norm(across)
    return across / length if length > FLAT * _size(outline) else np.array([1.0, 0.0, 0.0])


def _size(outline: Float[np.ndarray, "points 3"]) -> float:
    return float(np.linalg.norm(np.ptp(outline, axis=0)))


def _enlargement(dataset: "xarray.Dataset") -> float:
    """1, 2 or 5 times a power of ten, such that the ellipsoid can be seen beside the arm."""
    wanted = LARGEST * _size(dataset["outline"].to_numpy()) / (1e3 * float(dataset["principal_compliance"][0]))
    ten = 10.0 ** np.floor(np.log10(wanted))
    return float(max(step * ten for step in (1, 2, 5) if step * ten <= wanted))


def _in_a_plane(dataset: "xarray.Dataset"):
    """A horizontal direction, and distance from the base along it and height of every place of the tool; None where the
    tool does not stay in a vertical plane, or comes to places in two ways."""
    position, outline = dataset["tool_position"].to_numpy(), dataset["outline"].to_numpy()
    across = position[..., :2].reshape(-1, 2)
    _, size, directions = np.linalg.svd(across - across.mean(axis=0), full_matrices=False)
    if size[1] > FLAT * size[0]:
        return None
    along = np.append(directions[0], 0.0)
    along *= 1.0 if (outline[-1] - outline[0]) @ along >= 0 else -1.0
    distance, height = (position - outline[0]) @ along, position[..., 2]
    inside = np.isfinite(dataset["lowest_frequency"].to_numpy())
    cell = inside[:-1, :-1] & inside[1:, :-1] & inside[:-1, 1:] & inside[1:, 1:]
    by_first, by_second = (np.diff(np.stack([distance, height]), axis=axis) for axis in (1, 2))
    area = (by_first[0, :, :-1] * by_second[1, :-1] - by_first[1, :, :-1] * by_second[0, :-1])[cell]
    if area.size == 0 or area.min() <= 0 <= area.max():
        return None
    return along, distance, height


def _colours(values: np.ndarray) -> dict[str, Any]:
    """Levels at round numbers for nearly all values, by their logarithm where they spread widely."""
    low, high = np.percentile(values[np.isfinite(values)], [1, 99])
    if high - low < FEW * abs(high):
        low, high = low - FEW * abs(high), high + FEW * abs(high)
    if not 0 < WIDE * low < high:
        return {"levels": MaxNLocator(14, steps=[1, 2, 2.5, 5, 10]).tick_values(low, high)}
    tens = 10.0 ** np.arange(np.floor(np.log10(low)), np.ceil(np.log10(high)) + 1)
    round_ones = np.outer(tens, [1, 1.5, 2, 3, 5, 7]).ravel()
    first, last = np.searchsorted(round_ones, low, "right") - 1, np.searchsorted(round_ones, high)
    levels = round_ones[first : last + 1]
    return {"levels": levels, "norm": LogNorm(levels[0], levels[-1])}


def _span(dataset: "xarray.Dataset", dim: str) -> str:
    v = dataset[dim].to_numpy()
    return f"{dim.rpartition('.')[2].replace('_', ' ')} from {v.min():.4g} to {v.max():.4g} {dataset[dim].attrs['units']}"
