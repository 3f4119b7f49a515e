"""Make the synthetic traces of this directory: python data_synthetic/generate.py [--out DIR]

Everything is said by the fit case: the cut, the truth ([fit.truth]), and of the trace its file, channels and noise. The
truth is simulated with time steps finer by `FINER` than those with which it will be fitted, and averaged over each of the
fit's steps as a sensor with that sampling time would: the fit meets a discretisation error besides the noise. The same
file comes out every time.
"""

import argparse
import tomllib
from pathlib import Path
from typing import Any

import jax
import numpy as np

from millax import load_case, simulate
from millax._units import express, parse

SEED = 20120701
FINER = 4
CASES = ("kr240_slot.toml",)
DECIMALS = {"N": ("N", 2), "m": ("um", 2)}
"""How forces and displacements are written: the unit, and decimals well below the noise."""

HERE = Path(__file__).parent


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition(":")[0])
    parser.add_argument("--out", metavar="DIR", type=Path, default=HERE, help="directory for the traces (default: here)")
    out = parser.parse_args().out
    jax.config.update("jax_enable_x64", True)
    out.mkdir(parents=True, exist_ok=True)
    for name in CASES:
        tables = tomllib.loads((HERE / name).read_text(encoding="utf-8"))
        (trace,) = tables["trace"]
        write(out / trace["file"], *measure(truth(tables), trace["noise"]))


def truth(tables: dict[str, Any]) -> dict[str, Any]:
    """The case with the true numbers in it."""
    axes = tables["structure"]["axes"]
    for section, numbers in tables["fit"]["truth"].items():
        for key, value in numbers.items():
            if isinstance(value, dict):  # one number per axis
                for axis, number in value.items():
                    tables[section][key][axes.index(axis)] = number
            else:
                tables[section][key] = value
    return tables


def measure(tables: dict[str, Any], noise: dict[str, str]) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Times [s] and noisy channels [N, m] of a case; the noise is white and normal."""
    settings = tables["simulation"]
    coarse = load_case(tables).settings
    # Finer, and converged far below the last digit: the same bytes however the sweeps come to their end.
    finer = settings | {"steps_per_tooth": FINER * coarse.steps_per_tooth, "sweeps": 12, "tolerance": 1e-12}
    sim = simulate(load_case(tables | {"simulation": finer}))
    columns = {f"F{axis}": sim.force[:, i] for i, axis in enumerate("xyz")}
    columns |= dict(zip(sim.axes, np.asarray(sim.displacement).T, strict=True))
    random = np.random.default_rng(SEED)
    channels = {
        name: averaged(columns[name]) + parse(name, sigma, "N" if name[0] == "F" else "m") * random.normal(size=coarse.steps)
        for name, sigma in noise.items()
    }
    return averaged(sim.time), channels


def averaged(samples) -> np.ndarray:
    """Means over `FINER` samples. Their middle is the middle of a step of the fit, to which its samples belong."""
    return np.asarray(samples).reshape(-1, FINER).mean(axis=1)


def write(path: Path, time: np.ndarray, channels: dict[str, np.ndarray]) -> None:
    """Write a trace as CSV."""
    header, formats, columns = ["time [s]"], ["%.8f"], [time]
    for name, values in channels.items():
        unit, decimals = DECIMALS["N" if name[0] == "F" else "m"]
        header.append(f"{name} [{unit}]")
        formats.append(f"%.{decimals}f")
        columns.append(express(values, unit))
    np.savetxt(path, np.column_stack(columns), formats, ",", header=",".join(header), comments="")


if __name__ == "__main__":
    main()
