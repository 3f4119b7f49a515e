"""Files of measurements, one format in each module. All of them give the same `Raw`: named columns of numbers, on which
channels, units and windows are found once, in `_table.py`."""

import difflib
import importlib
from pathlib import Path

from .._measured import TraceError
from ._raw import Raw
from ._text import decoded

FORMATS = ("csv", "dynoware", "mat", "hdf5", "tdms")
"""Every format, each read by the module of its name."""

_SUFFIXES = {".mat": "mat", ".h5": "hdf5", ".hdf5": "hdf5", ".nc": "hdf5", ".tdms": "tdms"}

_HDF5 = b"\x89HDF\r\n\x1a\n"


def read_raw(path: Path, kind: str, format: str | None = None) -> Raw:
    """The columns of a file; their numbers are read when asked for.

    **Arguments:**

    - `kind`: of measurement, for messages ("trace").
    - `format`: one of `FORMATS`. None: found from how the file begins, then from its extension; otherwise CSV.

    Raises `TraceError`, which begins with the path, for a file that is not there or not in its format.
    """
    if format is not None and format not in FORMATS:
        near = difflib.get_close_matches(str(format), FORMATS, n=1)
        hint = f" Did you mean {near[0]}?" if near else ""
        raise TraceError(f"{path}: format {format!r} is unknown.{hint} Known are {', '.join(FORMATS)}")
    try:
        with path.open("rb") as file:
            head = file.read(1024)
    except OSError as error:
        raise TraceError(f"{path}: the {kind} cannot be read: {error.strerror}") from None
    # A format is imported only for a file in it: h5py, npTDMS and SciPy's readers take their time.
    module = importlib.import_module(f"._{format or _found(path, head)}", __name__)
    return module.read(path)


def _found(path: Path, head: bytes) -> str:
    suffix = path.suffix.lower()
    if head.startswith(b"MATLAB"):
        return "mat"
    if head.startswith(_HDF5):
        return "mat" if suffix == ".mat" else "hdf5"
    if head.startswith(b"TDSm"):
        return "tdms"
    if decoded(head, errors="ignore").lstrip('"').startswith("DynoWare"):
        return "dynoware"
    return _SUFFIXES.get(suffix, "csv")
