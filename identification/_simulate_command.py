"""`millax simulate`: from a case file to traces, a summary and a picture."""

import json
import os
import time
from pathlib import Path
from typing import Any

import jax
import numpy as np
from rich.table import Table

from millax import Simulation, load_case, simulate, summarize, wall_profile, walls
from millax._types import AXES
from millax._units import express

from ._output import console, staged


def run_simulate(case_path: str | os.PathLike, out_dir: str | os.PathLike, *, chip_thickness: bool = False) -> int:
    """Simulate a case file into the directory `out_dir`: trace.csv, summary.json, trace.png, and
    surface.png where it leaves a wall. Returns the exit code 0.

    `chip_thickness` adds a column per tooth to the traces. Raises `CaseError`, `SimulationError`, or `OSError` where
    nothing can be written; no file is then left.
    """
    from millax.plots import plot_simulation, plot_wall

    case = load_case(case_path)
    with staged(out_dir) as folder:
        start = time.perf_counter()
        with console.status("simulating"):
            sim = jax.block_until_ready(simulate(case))
        seconds = time.perf_counter() - start
        summary = summarize(sim, case)
        write_trace(folder / "trace.csv", sim, chip_thickness=chip_thickness)
        text = json.dumps(summary, indent=2, ensure_ascii=False, allow_nan=False)
        (folder / "summary.json").write_text(text + "\n", encoding="utf-8")
        plot_simulation(sim, case).savefig(folder / "trace.png", dpi=150)
        if left := [wall for side in walls(case) if np.isfinite((wall := wall_profile(case, sim, side)).y).any()]:
            plot_wall(left, case).savefig(folder / "surface.png", dpi=150)
        names = ", ".join(sorted(file.name for file in folder.iterdir()))
    console.print(f"{case_path}: {sim.time.size} time steps in {seconds:.1f} s", markup=False)
    _show(summary)
    console.print(f"{out_dir}: {names}", markup=False)
    return 0


def write_trace(path: Path, sim: Simulation, *, chip_thickness: bool = False) -> None:
    """Write traces as CSV, with units in the header: `time [s],Fx [N],...,x [m],...,h1 [m],...`."""
    names = ["time [s]", *(f"F{axis} [N]" for axis in AXES), *(f"{axis} [m]" for axis in sim.axes)]
    columns = [sim.time[:, None], sim.force, sim.displacement]
    if chip_thickness:
        names += [f"h{i + 1} [m]" for i in range(sim.chip_thickness.shape[1])]
        columns.append(sim.chip_thickness)
    table = np.concatenate([np.asarray(column) for column in columns], axis=1)
    np.savetxt(path, table, fmt="%.10g", delimiter=",", header=",".join(names), comments="", encoding="utf-8")


def _show(summary: dict[str, dict[str, Any]]) -> None:
    """Print a summary: a table on a terminal, else one line per quantity."""
    table = Table("quantity", "value", box=None, pad_edge=False)
    for name, entry in summary.items():
        if entry["value"] is None:
            value = f"not defined: {entry['reason']}"
        elif entry["unit"] == "m":
            value = f"{express(entry['value'], 'mm'):.4g} mm"
        else:
            value = f"{entry['value']:.4g} {entry['unit']}"
        table.add_row(name, value)
        if not console.is_terminal:
            console.print(f"{name}: {value}", markup=False)
    if console.is_terminal:
        console.print(table)
