"""The file of a sweep, and the directory of parts beside it while the sweep is under way.

`FILE.nc.parts/` holds the manifest and one small netCDF file per finished chunk. Every file appears whole or not at all
and carries the hash of its content in its name. So whatever ends a sweep, what is there can be trusted, and the same
sweep goes on from it.
"""

import contextlib
import errno
import hashlib
import io
import json
import os
import shutil
import sys
import warnings
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Int

from ._manifest import Manifest, differences

if TYPE_CHECKING:
    import xarray

Chunk = Mapping[str, np.ndarray]
"""Variables by name, each of shape (members, ...); "member" is which they are."""

ATTRIBUTE = "millax_sweep"
"""Attribute of a result that holds the manifest."""


class SweepFile:
    """Where the results of one sweep are kept.

    - `path`: of the finished file.
    - `parts`: the directory of what is done.
    """

    def __init__(self, path: str | os.PathLike, manifest: Manifest):
        self.path = Path(path)
        self.parts = Path(f"{os.fspath(path)}.parts")
        self.manifest = manifest

    def finished(self) -> bool:
        """Whether the file holds this very sweep already. Raises `ValueError` where it holds anything else."""
        import xarray

        if self.path.is_dir():
            raise ValueError(f"{self.path}: this is a directory; give the name of a file, such as {self.path / 'sweep.nc'}")
        if not self.path.exists():
            return False
        try:
            with xarray.open_dataset(self.path, engine="h5netcdf") as dataset:
                old = json.loads(dataset.attrs[ATTRIBUTE])
        except Exception:  # whatever a file that is no netCDF file makes the readers raise
            raise ValueError(
                f"{self.path}: the file exists and is not the result of a sweep; give another name, or overwrite=True"
            ) from None
        self._require_same(old, f"{self.path}: the file holds the results of another sweep")
        if self.parts.is_dir():  # stopped just before they were removed
            shutil.rmtree(self.parts)
        return True

    def remove(self) -> None:
        """Remove the file and its parts, if there are any."""
        if self.path.is_file():
            self.path.unlink()
        if self.parts.is_dir():
            shutil.rmtree(self.parts)

    def start(self) -> None:
        """Make the directory of parts, or check that the one which is there belongs to the same sweep.

        Raises `ValueError` with the differences where it does not, and `OSError` where nothing can be written.
        """
        self.parts.mkdir(parents=True, exist_ok=True)
        for leftover in self.parts.glob("*.tmp"):
            leftover.unlink()
        manifest = self.parts / "manifest.json"
        if manifest.exists():
            try:
                old = json.loads(manifest.read_text(encoding="utf-8"))
            except ValueError:
                old = {}
            self._require_same(old, f"{self.parts}: this directory holds a part of another sweep")
        else:
            write_whole(manifest, (json.dumps(self.manifest, indent=2, ensure_ascii=False) + "\n").encode())

    def done(self, members: int) -> Int[np.ndarray, " members"]:
        """The status of every member that is done, -1 for the others. Damaged parts are removed, with a warning."""
        found = np.full(members, -1)
        for path in self._paths():
            chunk = _read(path)
            if chunk is None or chunk["member"].max() >= members:
                warnings.warn(f"{path}: this part is damaged; its members are computed again", stacklevel=3)
                path.unlink()
            else:
                found[chunk["member"]] = chunk["status"]
        return found

    def write(self, chunk: Chunk) -> None:
        """Keep a chunk. Raises `OSError`; the parts written before are then untouched."""
        data = _netcdf({name: (_dims(name, values), values) for name, values in chunk.items()})
        name = f"{chunk['member'][0]:08d}-{hashlib.sha256(data).hexdigest()[:16]}.nc"
        write_whole(self.parts / name, data)

    def chunks(self, names: tuple[str, ...] | None = None) -> Iterator[Chunk]:
        """Every chunk that is kept, one after the other; of each the variables `names` and "member", or all."""
        for path in self._paths():
            chunk = _read(path, names)
            assert chunk is not None  # checked when they were written, or by `done`
            yield chunk

    def finish(self) -> None:
        """Remove the parts: the file holds all of them."""
        shutil.rmtree(self.parts)

    def _paths(self) -> list[Path]:
        return sorted(self.parts.glob("*.nc"))

    def _require_same(self, old: Manifest, words: str) -> None:
        different = differences(old, self.manifest)
        if different:
            shown = [f"  {line}" for line in different[:12]] + (["  ..."] if len(different) > 12 else [])
            raise ValueError(
                "\n".join([f"{words}:", *shown])
                + f"\nGive back the old values to go on with it, or start anew: under another name, by removing "
                f"{self.parts if self.parts.exists() else self.path}, or with overwrite=True (--overwrite)"
            )


@contextlib.contextmanager
def whole(path: Path) -> Iterator[Path]:
    """A temporary path that takes the place of `path` when the block ends well; otherwise nothing is left."""
    temporary = path.with_name(f"{path.name}.tmp")
    try:
        yield temporary
        os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)


def write_whole(path: Path, data: bytes) -> None:
    """Write a file that is there whole, whatever ends the process or the machine, or not at all."""
    with whole(path) as temporary, open(temporary, "wb") as file:
        file.write(data)
        file.flush()
        os.fsync(file.fileno())


def save(dataset: "xarray.Dataset", target: Path | io.BytesIO) -> None:
    """Write a dataset as netCDF. While a Dask client is open, xarray would ask the cluster for a lock on the file."""
    if "dask" in sys.modules:
        import dask.config as dask_config

        local = dask_config.set(scheduler="synchronous")
    else:
        local = contextlib.nullcontext()
    with local:
        dataset.to_netcdf(target, engine="h5netcdf")


def require_space(folder: Path, size: int) -> None:
    """Raise `OSError` where the disk of `folder` has less than `size` bytes free."""
    home = next(place for place in (folder, *folder.absolute().parents) if place.is_dir())
    free = shutil.disk_usage(home).free
    if free < size:
        raise OSError(
            errno.ENOSPC,
            f"the disk has {in_words(free)} free, and the sweep needs about {in_words(size)}",
            os.fspath(folder),
        )


def in_words(size: float) -> str:
    """A number of bytes: "1.2 GB"."""
    for scale, unit in ((1e12, "TB"), (1e9, "GB"), (1e6, "MB"), (1e3, "kB")):
        if size >= scale:
            return f"{size / scale:.3g} {unit}"
    return f"{size:.0f} bytes"


def _dims(name: str, values: np.ndarray) -> tuple[str, ...]:
    return ("member", *(f"{name}_{i}" for i in range(values.ndim - 1)))


def _netcdf(variables) -> bytes:
    import xarray

    buffer = io.BytesIO()
    save(xarray.Dataset(variables), buffer)
    return buffer.getvalue()


def _read(path: Path, names: tuple[str, ...] | None = None) -> dict[str, np.ndarray] | None:
    """The variables of a part; None where it is damaged."""
    import xarray

    try:
        data = path.read_bytes()
        if hashlib.sha256(data).hexdigest()[:16] != path.stem.partition("-")[2]:
            return None
        with xarray.open_dataset(io.BytesIO(data), engine="h5netcdf") as dataset:
            wanted = [*dataset.variables] if names is None else ["member", *names]
            return {str(name): dataset[name].to_numpy() for name in wanted}
    except OSError:
        return None
