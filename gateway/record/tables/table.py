"""Reads columns of numbers from a CSV file (also .gz), with errors that name file, line, column and value.

Only requested columns are converted to numbers, so that a file may have text columns.
"""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import numpy.typing as npt

from protocol.errors import DataError, quoted
from protocol.table_file import check_table, is_number, read_csv_bytes

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
        """Return a column of finite numbers, shape (rows,).

        Raises:
            DataError: the column does not exist, or a cell is not a finite number.
        """
        if column not in self.names:
            why = f": {self.unusable[column]}" if column in self.unusable else ""
            raise DataError(
                f"{self.path} has no column {column!r}{why}",
                remedy=f"Map another one; its columns are: {', '.join(self.names)}",
            )
        values = np.empty(self.rows)
        for row in range(self.rows):
            cell = self.cell(column, row)
            try:
                value = float(cell)
            except ValueError:
                raise self._bad(column, row, cell) from None
            if not math.isfinite(value):
                raise self._bad(column, row, cell)
            values[row] = value
        return values

    def _bad(self, column: str, row: int, cell: str | float) -> DataError:
        what = "is empty" if isinstance(cell, str) and not cell.strip() else f"= {quoted(cell)} is not a finite number"
        remedy = "Correct the cell, or leave that row out"
        if isinstance(cell, str) and "," in cell:
            remedy = "Write decimals with a point"
        return DataError(f"{self.path}, {self.label(row)}: {column} {what}", remedy=remedy)


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
    separator = max(",;\t", key=retained[0][1].count)
    names = tuple(cell.strip() for cell in _split(retained[0][1], separator))
    where = f"{path}, line {retained[0][0]}"
    if len(retained) > 1:
        check_table(path, names, _split(retained[1][1], separator))
    if any(is_number(name) for name in names):
        raise DataError(f"{where} holds numbers instead of column names", remedy="Put the names into the first line")
    if len(set(names)) != len(names) or "" in names:
        twice = next((name for name in names if names.count(name) > 1 or not name), "")
        raise DataError(f"{where}: column name {twice!r} is empty or appears twice", remedy="Give each its own name")
    rows = [_split(line, separator) for _, line in retained[1:]]
    numbers = [number for number, _ in retained[1:]]
    if not rows:
        raise DataError(f"{path} has column names but no rows", remedy="Name a file with data")
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


def _split(line: str, separator: str) -> Sequence[str]:
    return next(csv.reader(io.StringIO(line), delimiter=separator))
