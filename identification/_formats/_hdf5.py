"""HDF5, MATLAB's v7.3 files included: a column is a dataset, by its path; its unit is its attribute `units` or `unit`."""

from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from .._measured import TraceError
from ._arrays import Array, unreadable, with_arrays
from ._raw import Raw


def read(path: Path) -> Raw:
    """The columns of an HDF5 file. Raises `TraceError`, which begins with the path."""
    import h5py

    arrays: list[Array] = []

    def visit(link: str | bytes, item: Any) -> None:
        name = link.decode("utf-8", errors="replace") if isinstance(link, bytes) else link  # h5py's way with other encodings
        # MATLAB keeps texts as integers, and the size of an empty array in its place.
        texts = item.attrs.get("MATLAB_class") == b"char" or item.attrs.get("MATLAB_empty", 0)
        if isinstance(item, h5py.Dataset) and item.dtype.kind in "iuf" and item.shape and not texts and name[0] != "#":
            unit = _words(item.attrs.get("units", item.attrs.get("unit")))
            arrays.append(Array(name, item.shape, partial(_dataset, path, link), unit))

    try:
        with h5py.File(path, "r") as file:
            file.visititems(visit)
    except Exception as error:
        raise unreadable(path, "an HDF5 file", error) from None
    return with_arrays(path, arrays)


def _dataset(path: Path, link: str | bytes) -> np.ndarray:
    import h5py

    try:
        with h5py.File(path, "r") as file:
            dataset: Any = file[link]
            packed = {"scale_factor", "add_offset"} & set(dataset.attrs)
            values, name = dataset[()], dataset.name
    except Exception as error:
        raise unreadable(path, "an HDF5 file", error) from None
    if packed:
        raise TraceError(f'{path}: column "{name}" is packed: it has the attribute {min(packed)}; write it unpacked')
    return values


def _words(attribute: Any) -> str | None:
    """A text attribute, which libraries write as text, bytes or an array of one."""
    if isinstance(attribute, np.ndarray) and attribute.size == 1:
        attribute = attribute.item()
    if isinstance(attribute, bytes):
        attribute = attribute.decode("utf-8", errors="replace")
    return attribute.strip() or None if isinstance(attribute, str) else None
