"""Reads columns of numbers from a CSV file (also .gz), with errors that name file, line, column and value.

Only requested columns are converted to numbers, so that a file may have text columns.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import numpy.typing as npt

from protocol.errors import DataError, quoted
from protocol.table_file import read_csv_bytes, read_header, split

FloatArray = npt.NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True)
class Table:
    """A file with named columns of equal length."""

    path: Path
    names: tuple[str, ...]
    rows: int
    label: Callable[[int], str]  # row -> "line 7" or "sample 6"
    cell: Callable[[str, int], str | float]
    unusable: Mapping[str, str] = field(
        default_factory=dict
    )  # other variables by name, with the reason why they are not columns

    def numbers(self, column: str) -> FloatArray:
        """Return a column, shape (rows,), with NaN where a cell is not a finite number.

        Raises:
            DataError: the column does not exist, or no cell is a finite number.
        """
        if column not in self.names:
            why = f": {self.unusable[column]}" if column in self.unusable else ""
            raise DataError(
                f"{self.path} has no column {column!r}{why}",
                remedy=f"Map another one; its columns are: {', '.join(self.names)}",
            )
        values = np.array([_number(self.cell(column, row)) for row in range(self.rows)])
        if self.rows and np.isnan(values).all():
            raise self.bad(column, 0)
        return values

    def bad(self, column: str, row: int) -> DataError:
        """Return the error of a cell that is not a finite number."""
        cell = self.cell(column, row)
        what = "is empty" if isinstance(cell, str) and not cell.strip() else f"= {quoted(cell)} is not a finite number"
        remedy = "Correct the cell, or leave that row out"
        if isinstance(cell, str) and "," in cell:
            remedy = "Write decimals with a point"
        return DataError(f"{self.path}, {self.label(row)}: {column} {what}", remedy=remedy)


def _number(cell: str | float) -> float:
    try:
        value = float(cell)
    except ValueError:
        return math.nan
    return value if math.isfinite(value) else math.nan


def read_csv(path: Path) -> Table:
    """Read a CSV file with names in its first line.

    Comma, semicolon or tab separate the cells; `#` begins a comment line.

    Raises:
        DataError: the file is absent, not text, badly compressed, has no names, no rows, or lines of different lengths.
    """
    try:
        lines = read_csv_bytes(path).decode("utf-8").splitlines()
    except UnicodeDecodeError:
        raise DataError(f"{path} is not text", remedy="Name a CSV file in UTF-8, or a MATLAB file with .mat") from None
    retained = [(number, line) for number, line in enumerate(lines, 1) if line.strip() and not line.startswith("#")]
    if not retained:
        raise DataError(f"{path} is empty", remedy="Name a file with a line of column names and rows of numbers")
    if len(retained) < 2:
        raise DataError(f"{path} has column names but no rows", remedy="Name a file with data")
    numbers, lines = [number for number, _ in retained], [line for _, line in retained]
    names, separator = read_header(path, lines[0], lines[1], numbers[0])
    rows = [split(line, separator) for line in lines[1:]]
    numbers = numbers[1:]
    for number, row in zip(numbers, rows, strict=True):
        if len(row) != len(names):
            raise DataError(
                f"{path}, line {number} has {len(row)} cells, the first line {len(names)}",
                remedy="Complete the line, or remove it (is the file cut off?)",
            )
    index = {name: position for position, name in enumerate(names)}
    return Table(
        path=path,
        names=names,
        rows=len(rows),
        label=lambda row: f"line {numbers[row]}",
        cell=lambda column, row: rows[row][index[column]],
    )
