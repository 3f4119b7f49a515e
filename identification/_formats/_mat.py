"""MATLAB's MAT files: a column is a variable, or a field of a structure: "cut1/forces/Fx". Up to v7 read by SciPy; v7.3 is
HDF5."""

import warnings
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ._arrays import Array, unreadable, with_arrays
from ._raw import Raw


def read(path: Path) -> Raw:
    """The columns of a MAT file. Raises `TraceError`, which begins with the path."""
    import h5py

    if h5py.is_hdf5(path):
        from . import _hdf5

        return _hdf5.read(path)
    from scipy.io import loadmat

    try:
        with warnings.catch_warnings():
            # Of two variables of one name SciPy would take the second. What it cannot read it calls None, each time.
            warnings.filterwarnings("error", message='Duplicate variable name "(?!None")')
            variables = loadmat(path, simplify_cells=True, appendmat=False)
    except Exception as error:
        raise unreadable(path, "a MAT file", error) from None
    return with_arrays(path, _arrays({name: value for name, value in variables.items() if not name.startswith("__")}))


def _arrays(variables: Mapping[str, Any], above: str = "") -> Iterator[Array]:
    for name, value in variables.items():
        if isinstance(value, Mapping):
            yield from _arrays(value, f"{above}{name}/")
        elif isinstance(value, np.ndarray) and value.dtype.kind in "iuf":
            yield Array(f"{above}{name}", value.shape, value.view)
