"""The labelled result of a sweep: chunks put together, with names, units and definitions."""

import json
import os
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ._manifest import Manifest
from ._members import Members
from ._reductions import Reduction
from ._simulate import STATUS
from ._sweepfile import ATTRIBUTE, Chunk, save, whole
from ._types import AXES

if TYPE_CHECKING:
    import xarray

Chunks = Callable[[tuple[str, ...]], Iterable[Chunk]]
"""All chunks, with some of their variables."""

_OWN = {
    "status": (
        "",
        "0 where the simulation can be trusted: " + "; ".join(f"{code} = {words}" for code, words in STATUS.items()),
    ),
    "residual": ("", "error of the force that the sweeps leave, estimated, over the largest force"),
    "simulated_time": ("s", "length of the simulated cut"),
}


@dataclass(frozen=True)
class Variable:
    """A variable of the result: its dimensions after those of the sweep, their lengths, type, unit and definition."""

    dims: tuple[str, ...]
    shape: tuple[int, ...]
    dtype: type
    unit: str
    definition: str

    @property
    def attributes(self) -> dict[str, str]:
        """As the CF conventions name them."""
        return {"units": self.unit, "long_name": self.definition}


def variables_of(shapes: Mapping[str, tuple[int, ...]], reductions: Mapping[str, Reduction]) -> dict[str, Variable]:
    """Every variable of the result, from the shapes that one simulation gives them."""
    found = {}
    for name, shape in shapes.items():
        reduction = reductions[max((r for r in reductions if name == r or name.startswith(f"{r}.")), key=len)]
        dims = reduction.dims or tuple(f"{name}_{i}" for i in range(len(shape)))
        found[name] = Variable(dims, shape, np.float64, reduction.unit, reduction.definition)
    for name, (unit, definition) in _OWN.items():
        found[name] = Variable((), (), np.int8 if name == "status" else np.float64, unit, definition)
    return found


def bytes_of(variable: Variable, members: int) -> int:
    """Memory of a variable of so many members."""
    return members * int(np.prod(variable.shape, dtype=float)) * np.dtype(variable.dtype).itemsize


def assemble(chunks: Chunks, members: Members, variables: Mapping[str, Variable], manifest: Manifest) -> "xarray.Dataset":
    """The result in memory. A member that is in no chunk is NaN; so is the end of an array that is shorter than others."""
    import xarray

    dims = tuple(members.dims)
    filled = {}
    for name, variable in variables.items():
        array = np.full((len(members), *variable.shape), np.nan if variable.dtype == np.float64 else -1, variable.dtype)
        for chunk in chunks((name,)):
            array[chunk["member"], *(slice(n) for n in chunk[name].shape[1:])] = chunk[name]
        filled[name] = ((*dims, *variable.dims), array.reshape(*members.shape, *variable.shape), variable.attributes)
    return xarray.Dataset(filled, _coordinates(members, variables), _attributes(manifest))


def write(
    path: Path, chunks: Chunks, members: Members, variables: Mapping[str, Variable], manifest: Manifest, *, memory: float
) -> None:
    """Write the result to a file, whole or not at all. Variables of more than `memory` bytes are never in memory whole."""
    import h5netcdf

    large = {name: v for name, v in variables.items() if bytes_of(v, len(members)) > memory}
    small = {name: v for name, v in variables.items() if name not in large}
    dataset = assemble(chunks, members, small, manifest)
    with whole(path) as temporary:
        save(dataset, temporary)
        if large:
            with h5netcdf.File(temporary, "a") as file:
                for name, variable in large.items():
                    _append(file, name, variable, chunks, members)
        with open(temporary, "rb+") as file:
            os.fsync(file.fileno())


def _append(file, name: str, variable: Variable, chunks: Chunks, members: Members) -> None:
    for dim, length in zip(variable.dims, variable.shape, strict=True):
        if dim not in file.dimensions:
            file.dimensions[dim] = length
    place = file.create_variable(name, (*members.dims, *variable.dims), variable.dtype, fillvalue=np.nan)
    place.attrs.update(variable.attributes)
    for chunk in chunks((name,)):
        for i, row in zip(chunk["member"], chunk[name], strict=True):
            place[*(int(k) for k in np.unravel_index(i, members.shape)), *(slice(n) for n in row.shape)] = row


def _coordinates(members: Members, variables: Mapping[str, Variable]) -> dict[str, Any]:
    found: dict[str, Any] = {
        name: (() if dim is None else (dim,), numbers, {"units": members.units[name]})
        for name, (dim, numbers) in members.coordinates.items()
    }
    if any("axis" in variable.dims for variable in variables.values()):
        found["axis"] = list(AXES)
    return found


def _attributes(manifest: Manifest) -> dict[str, str]:
    return {
        "title": "sweep of a milling simulation",
        "source": f"millax {manifest['millax']}",
        ATTRIBUTE: json.dumps(manifest, ensure_ascii=False),
    }
