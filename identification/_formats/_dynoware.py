"""CSV as Kistler's DynoWare exports it: rows about the recording, a row of names that begins with Time, one of units, then
numbers."""

import re
from itertools import islice
from pathlib import Path

from .._measured import TraceError
from ._csv import with_header
from ._raw import Raw
from ._text import Sheet, decoded

PREAMBLE = 200
"""Rows in which the names must have come; DynoWare writes 18 above them."""


def read(path: Path) -> Raw:
    """The columns of a DynoWare export. Raises `TraceError`, which begins with the path."""
    content = path.read_bytes()
    try:
        text = decoded(content)
    except UnicodeDecodeError:
        # A Windows program: paths with accents, and µ, come in the code page of Western Europe.
        text = content.decode("cp1252", errors="replace")
    begin = re.match(r'"?DynoWare"?([,;\t])', text)
    if not begin:
        raise TraceError(f"{path}: not a DynoWare export: it does not begin with DynoWare and its version")
    if not text.endswith(("\n", "\r")):
        raise TraceError(f"{path}: the file is cut short: its last row has no end. Export it again")
    sheet = Sheet.of(path, text, begin[1])
    for above, row in enumerate(islice(sheet.rows(), PREAMBLE)):
        if row and row[0].strip() == "Time":
            return with_header(sheet, above)
    raise TraceError(f"{path}: no row of names, which begins with Time, below what DynoWare says about the recording")
