"""CSV: a row of names, with units in them or in a row below, then numbers.

Commas between the columns and points in the numbers; or semicolons or tabs, and then points or commas in the numbers, the
same throughout. UTF-8, or UTF-16 that begins with a byte order mark.
"""

from itertools import islice
from pathlib import Path

from .._measured import TraceError
from ._raw import Raw, RawColumn, shown, split_label
from ._text import Sheet, decoded, is_number


def read(path: Path) -> Raw:
    """The columns of a CSV file. Raises `TraceError`, which begins with the path."""
    try:
        text = decoded(path.read_bytes())
    except UnicodeDecodeError:
        raise TraceError(f"{path}: not a text file in UTF-8; save it as one. For another format, say format = ...") from None
    first = text.partition("\n")[0]
    # Commas may stand in names; semicolons and tabs hardly do.
    sheet = Sheet.of(path, text, next((mark for mark in ";\t" if mark in first), ","))
    return with_header(sheet, 0)


def with_header(sheet: Sheet, above: int) -> Raw:
    """The columns of a sheet, with `above` rows above that of the names. Raises `TraceError`."""
    header, below = [*islice(sheet.rows(), above, above + 2), [], []][:2]
    units = below if any(cell.strip() for cell in below) and not any(map(is_number, below)) else []
    columns = tuple(_column(sheet.path, i, label, units[i] if i < len(units) else "") for i, label in enumerate(header))
    head = above + (2 if units else 1)
    return Raw(columns, lambda used: sheet.numbers(head, len(header), used), "row", text=True)


def _column(path: Path, index: int, label: str, below: str) -> RawColumn:
    name, unit = split_label(label)
    below = below.strip().strip("[]()-").strip()
    where = f'column {index + 1} "{shown(label)}"'
    if unit and below and unit != below:
        raise TraceError(f"{path}: {where}: the row of units says {shown(below)}; keep one of them")
    return RawColumn(name, unit or below or None, where)
