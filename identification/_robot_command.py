"""`millax robot`: from a case file to what the tool feels of the robot that holds it."""

import json
import os
import time
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from rich.markup import escape
from rich.table import Table

from millax import CaseError, CaseFile
from millax._types import AXES
from millax.robot import Arm, robot_at_tool, stiffness_map

from ._output import console, staged

if TYPE_CHECKING:
    import xarray

WORDS = {"x": "x (feed)", "y": "y", "z": "z (spindle)"}
"""Directions of the workpiece frame."""

ALONG = tuple(WORDS.values())

SEEN = 5e-5
"""Parts of the largest number of a table that are worth printing."""

PICTURED = ("receptance", "outline")
"""What is in the pictures and in robot.nc, but not in robot.json."""


def run_robot(case_path: str | os.PathLike, out: str | os.PathLike, *, maps: Sequence[str] = ()) -> int:
    """Look at the robot of a case file at its pose, and over two of its joints; write robot.json, robot.nc, robot.png and
    stiffness_map.png into `out`.

    `maps` holds texts like "robot.joints.joint_2=-120:-20:41 deg", two or none. Returns the exit code 0. Raises
    `CaseError`, also for a case without a robot, or `OSError` where nothing can be written; no file is then left.
    """
    from millax.robot.plots import plot_robot, plot_stiffness_map

    case = CaseFile.read(case_path).case
    if case.robot is None:
        raise CaseError(
            f"{case_path}: no table [robot], so no robot to look at; give one in place of [structure]: model, joints, "
            "compliance and damping_ratio (docs/cases/kr270_slot.toml explains every key)"
        )
    start = time.perf_counter()
    with staged(out) as folder:
        with console.status("looking at the robot"):
            try:
                grid = _grid(maps)
                felt, over = robot_at_tool(case.robot), stiffness_map(case.robot, grid)
            except ValueError as error:
                raise CaseError(f"{case_path}: {error}") from None
        text = json.dumps(records(felt), indent=2, ensure_ascii=False, allow_nan=False)
        (folder / "robot.json").write_text(text + "\n", encoding="utf-8")
        both = felt.merge(over.drop_vars("outline").rename({name: f"map_{name}" for name in over if name != "outline"}))
        both.attrs = {"title": "a robot, as the tool feels it", "case": os.fspath(case_path)}
        both.to_netcdf(folder / "robot.nc", engine="h5netcdf")
        plot_robot(felt).savefig(folder / "robot.png", dpi=150)
        plot_stiffness_map(over).savefig(folder / "stiffness_map.png", dpi=150)
        names = ", ".join(sorted(file.name for file in folder.iterdir()))
    _show(felt, case.robot)
    _show_map(over, time.perf_counter() - start)
    console.print(f"{out}: {names}", markup=False)
    return 0


def records(felt: "xarray.Dataset") -> dict[str, dict[str, Any]]:
    """A dataset as a dictionary: `{"free_stiffness": {"value": {"x": ...}, "unit": "N/m", "definition": "..."}}`, the
    numbers by the labels of their dimensions, one within the other. What is not finite is None."""

    def values(array: "xarray.DataArray") -> Any:
        if not array.dims:
            return float(array) if np.isfinite(array) else None
        dim = array.dims[0]
        return {str(label): values(array.isel({dim: i})) for i, label in enumerate(array[dim].to_numpy())}

    return {
        str(name): {"value": values(v), "unit": v.attrs["units"], "definition": v.attrs["long_name"]}
        for name, v in felt.data_vars.items()
        if name not in PICTURED
    }


def _grid(maps: Sequence[str]) -> dict[str, str] | None:
    if not maps:
        return None
    if len(maps) != 2:
        raise ValueError("--map: given once; a map is over two joints, so give two of them, or none for joints 2 and 3")
    grid = {}
    for text in maps:
        name, _, values = (part.strip() for part in text.partition("="))
        if not name or not values:
            raise ValueError(f'--map "{text}": it must be NAME=VALUES, such as "robot.joints.joint_2=-120:-20:41 deg"')
        if name in grid:
            raise ValueError(f"--map {name}: given twice; a map is over two different joints")
        grid[name] = values
    return grid


def _show(felt: "xarray.Dataset", arm: Arm) -> None:
    """Print what the tool feels: tables on a terminal, else plain lines."""

    def of(name: str, scale: float = 1.0) -> np.ndarray:
        return scale * felt[name].to_numpy()

    turned = np.array([kind == "revolute" for kind in arm.robot.kinds])
    units = ["deg" if turns else "m" for turns in turned]
    pose = np.where(turned, np.rad2deg(of("pose")), of("pose"))
    joints = [f"{name} {_number(q)} {unit}" for name, q, unit in zip(arm.robot.names, pose, units, strict=True)]
    console.print(f"pose: {', '.join(joints)}", markup=False)
    frame = [("tool centre point [m]", of("tool_position")), *zip(WORDS.values(), of("workpiece_axes").T, strict=True)]
    _table("in the frame of the base", AXES, [(name, _settled(row)) for name, row in frame])
    for title, matrix in (
        ("stiffness [N/µm]: force on the tool by its motion; it does not turn", of("stiffness", 1e-6)),
        ("compliance [µm/kN]: motion of the tool by a force; it may turn", of("compliance", 1e9)),
    ):
        _table(title, AXES, zip(ALONG, _settled(matrix[:3, :3]), strict=True))
    along = [
        ("locked stiffness [N/µm]", of("locked_stiffness", 1e-6)),
        ("free stiffness [N/µm]", of("free_stiffness", 1e-6)),
        ("locked mass [kg]", of("locked_mass")),
        ("free mass [kg]", of("free_mass")),
    ]
    if arm.loads is not None:
        along.append(("moved by the loads [µm]", of("static_deflection", 1e6)))
    _table("the tool along a direction; locked: it moves that way only, free: it is pulled that way", ALONG, along)
    ellipsoid = zip(of("principal_compliance", 1e9), _settled(of("principal_direction")).T, strict=True)
    _table(
        "compliance ellipsoid: how far 1 kN moves the tool, and its direction",
        ("µm", *AXES),
        [(f"half axis {i + 1}", (size, *direction)) for i, (size, direction) in enumerate(ellipsoid)],
    )
    shapes = _settled(of("mode_shape")).T
    modes = zip(of("natural_frequency"), of("damping_ratio"), of("modal_stiffness", 1e-6), shapes, strict=True)
    _table(
        "modes: frequency, damping ratio, stiffness along the motion of the tool, and its direction",
        ("Hz", "zeta", "N/µm", *AXES),
        [(f"mode {i + 1}", (*numbers, *shape)) for i, (*numbers, shape) in enumerate(modes)],
    )
    springs, part = [str(name) for name in felt["spring"].to_numpy()], _settled(of("contribution", 100))
    _table("which joint gives way: its part of the compliance along a direction [%]", ALONG, zip(springs, part, strict=True))
    most = [
        f"{WORDS[axis]} {springs[i]} {part[i, j]:.0f} %"
        for j, (axis, i) in enumerate(zip(AXES, part.argmax(0), strict=True))
    ]
    console.print(f"gives way most: {', '.join(most)}", markup=False)


def _show_map(over: "xarray.Dataset", seconds: float) -> None:
    least, lowest = 1e-6 * over["least_stiffness"].to_numpy(), over["lowest_frequency"].to_numpy()
    dims = [str(dim) for dim in over["least_stiffness"].dims]
    console.print(
        f"map over {' and '.join(dims)}, {np.isfinite(lowest).sum()} poses: least stiffness in the plane x, y from "
        f"{_number(np.nanmin(least))} to {_number(np.nanmax(least))} N/µm, lowest natural frequency from "
        f"{_number(np.nanmin(lowest))} to {_number(np.nanmax(lowest))} Hz; {seconds:.1f} s",
        markup=False,
    )


def _table(title: str, columns: Sequence[str], rows: Iterable[tuple[str, Any]]) -> None:
    shown = [(name, [_number(value) for value in values]) for name, values in rows]
    if not console.is_terminal:
        console.print(title, markup=False)
        for name, values in shown:
            words = ", ".join(f"{column} {value}" for column, value in zip(columns, values, strict=True))
            console.print(f"  {name}: {words}", markup=False)
        return
    table = Table("", box=None, pad_edge=False)
    for column in columns:
        table.add_column(column, justify="right")
    for name, values in shown:
        table.add_row(escape(name), *values)
    console.print(f"\n[bold]{escape(title)}[/]")
    console.print(table)


def _settled(numbers: np.ndarray) -> np.ndarray:
    """Numbers of one unit; 0 where they are too small to be seen beside the largest."""
    return np.where(np.abs(numbers) < SEEN * np.abs(numbers).max(), 0.0, numbers)


def _number(value: float) -> str:
    return "-" if not np.isfinite(value) else f"{value:.4g}"
