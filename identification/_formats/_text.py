"""Numbers in text files: encodings, what stands between columns, decimal marks."""

import codecs
import csv
import io
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

import numpy as np

from .._measured import TraceError

_NUMBER = re.compile(r"\s*[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?\s*", re.ASCII)

_MARKED = re.compile(r"[\s\d.,eE+-]+", re.ASCII)
"""A cell in which a point or a comma is part of a number."""

_NO_THOUSANDS = re.compile(r"(?<!\d)0+,\d|\d{4},\d|,(?!\d{3}(?!\d))", re.ASCII)
"""A comma that cannot stand between thousands: after a zero or four digits, or not before three."""


def decoded(content: bytes, errors: str = "strict") -> str:
    """UTF-8, or UTF-16 that begins with a byte order mark."""
    wide = content.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE))
    return content.decode("utf-16" if wide else "utf-8-sig", errors)


@dataclass(frozen=True)
class Sheet:
    """A text file of rows of cells, with `delimiter` between them. Raises `TraceError`, which begins with the path."""

    path: Path
    text: str
    delimiter: str

    @classmethod
    def of(cls, path: Path, text: str, delimiter: str) -> "Sheet":
        """With one kind of line end."""
        if "\0" in text:
            raise TraceError(f"{path}: not a text file in UTF-8: it has zero bytes; for another format, say format = ...")
        return cls(path, text.replace("\r\n", "\n").replace("\r", "\n"), delimiter)

    def rows(self) -> Iterator[list[str]]:
        """Row by row."""
        try:
            yield from csv.reader(io.StringIO(self.text), delimiter=self.delimiter, strict=True)
        except csv.Error as error:
            raise TraceError(f"{self.path}: not a CSV file: {error}") from None

    def numbers(self, head: int, width: int, used: Sequence[int]) -> tuple[np.ndarray, np.ndarray]:
        """The columns `used` of what follows the first `head` rows, all of `width` cells: numbers, shape (rows, columns),
        NaN where a cell is no number; and the number of each row in the file, from 1."""
        table = self._at_once(head, width)
        if table is not None:
            return table[:, list(used)], np.arange(head + 1, head + 1 + len(table))
        return self._row_by_row(head, width, used)

    def _at_once(self, head: int, width: int) -> np.ndarray | None:
        """All numbers, where there is nothing else and no doubt about any of them."""
        body = "".join(self.text.split("\n", head)[head:]).rstrip("\n")
        if not body or '"' in body:
            return None
        if self.delimiter != "," and "," in body:
            if "." in body or not _NO_THOUSANDS.search(body):
                return None
            body = body.replace(",", ".")
        try:
            table = np.loadtxt(io.StringIO(body), delimiter=self.delimiter, comments=None, ndmin=2)
        except ValueError:
            return None
        return table if table.shape == (body.count("\n") + 1, width) else None

    def _row_by_row(self, head: int, width: int, used: Sequence[int]) -> tuple[np.ndarray, np.ndarray]:
        """Slower by far, but it can name the row that is wrong."""
        lines, cells = [], []
        for number, row in enumerate(islice(self.rows(), head, None), start=head + 1):
            if not any(cell.strip() for cell in row):
                continue
            if len(row) != width:
                raise TraceError(
                    f"{self.path}: row {number} has {len(row)} cells, the header has {width}; is the file cut short?"
                )
            lines.append(number)
            cells.append([row[i] for i in used])
        comma = self.delimiter != "," and self._decimal_comma(lines, cells)
        table = np.array([[_number(cell.replace(",", ".") if comma else cell) for cell in row] for row in cells])
        return table.reshape(-1, len(used)), np.array(lines, dtype=int)

    def _decimal_comma(self, lines: Sequence[int], cells: Sequence[Sequence[str]]) -> bool:
        """Whether the decimal mark is a comma. Raises `TraceError` where it is now a comma and now a point."""
        first: dict[str, tuple[int, str]] = {}
        clear = False
        for number, row in zip(lines, cells, strict=True):
            for cell in row:
                for mark in ".,":
                    if mark in cell and _MARKED.fullmatch(cell):
                        first.setdefault(mark, (number, cell))
                clear = clear or bool(_NO_THOUSANDS.search(cell))
            if len(first) == 2:
                (one, a), (other, b) = first.values()
                raise TraceError(
                    f'{self.path}: row {other} has "{b.strip()}", row {one} "{a.strip()}": points and commas. Write every '
                    "number with the same decimal mark, and nothing between thousands"
                )
        if "," in first and not clear:
            number, cell = first[","]
            raise TraceError(
                f'{self.path}: row {number} has "{cell.strip()}": the commas of the file may be decimal marks or stand '
                "between thousands. Write points as decimal marks"
            )
        return "," in first


def is_number(cell: str) -> bool:
    """Whether a cell holds a number in any locale, or says that there is none."""
    return bool(re.search(r"\d", cell) and _MARKED.fullmatch(cell)) or cell.strip().lower().lstrip("+-") in ("nan", "inf")


def _number(cell: str) -> float:
    return float(cell) if _NUMBER.fullmatch(cell) else np.nan
