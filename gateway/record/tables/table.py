"""Reads columns of numbers from a CSV file (also .gz), a MATLAB or a Parquet file.

Only requested columns are converted to numbers, so that a file may have text columns.  An error names file, line,
column and value.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from protocol import table_file
from protocol.errors import DataError, missing_extra, quoted
from protocol.files import open_regular
from protocol.table_file import LARGEST_TABLE, REMEDY, read_csv_bytes, read_header, split

FloatArray = npt.NDArray[np.float64]
_BYTES_PER_CELL = 8  # of Parquet


@dataclass(frozen=True, slots=True, kw_only=True)
class Table:
    """A file with named columns of equal length."""

    path: Path
    names: tuple[str, ...]
    rows: int
    label: Callable[[int], str]  # row -> "line 7" or "sample 6"
    cell: Callable[[str, int], str | float]
    unusable: Mapping[str, str] = field(default_factory=dict)  # other variables: why they are not columns

    def numbers(self, column: str) -> FloatArray:
        """Return a column, shape (rows,), with NaN where a cell is not a finite number.

        Raises:
            DataError: the column does not exist, or no cell is a finite number.
        """
        if column not in self.names:
            why = f": {self.unusable[column]}" if column in self.unusable else ""
            problem = f"{self.path} has no column {column!r}{why}"
            raise DataError(problem, remedy=f"Map another one; its columns are: {', '.join(self.names)}")
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
            problem = f"{path}, line {number} has {len(row)} cells, the first line {len(names)}"
            raise DataError(problem, remedy="Complete the line, or remove it (is the file cut off?)")
    index = {name: position for position, name in enumerate(names)}
    return Table(
        path=path, names=names, rows=len(rows), label=lambda row: f"line {numbers[row]}",
        cell=lambda column, row: rows[row][index[column]],
    )  # fmt: skip


def read_mat(path: Path) -> Table:
    """Read the numeric vectors of a .mat file up to version 7.

    Raises:
        DataError: the file is absent, not a MATLAB file, of version 7.3, without vectors, or with vectors of different
            lengths.
    """
    columns, unusable = table_file.read_mat(path)
    lengths = {name: len(column) for name, column in columns.items()}
    if len(set(lengths.values())) > 1:
        listed = ", ".join(f"{name} {length}" for name, length in lengths.items())
        raise DataError(f"{path}: vectors differ in length: {listed}", remedy="Save vectors of equal length")
    return Table(
        path=path,
        names=tuple(columns),
        rows=next(iter(lengths.values())),
        label=lambda row: f"sample {row + 1}",
        cell=lambda column, row: columns[column][row],  # whole numbers stay exact: times in ns have 61 bits
        unusable=unusable,
    )


def read_parquet(path: Path) -> Table:
    """Read a Parquet file; cells of columns that hold no numbers are refused where they are used.

    The bound is checked with the numbers of rows and columns, before anything is unpacked: equal rows take no space.

    Raises:
        DataError: the file is absent, not Parquet, without rows, or too large.
        InstallError: pyarrow is not installed.
    """
    try:
        import pyarrow
        import pyarrow.parquet
    except ImportError:
        raise missing_extra("export", "pyarrow") from None
    with open_regular(path, remedy=REMEDY) as file:
        try:
            source = pyarrow.parquet.ParquetFile(file)
            rows, names = source.metadata.num_rows, tuple(source.schema_arrow.names)
            groups = [source.metadata.row_group(n).total_byte_size for n in range(source.metadata.num_row_groups)]
            if max(rows * len(names) * _BYTES_PER_CELL, sum(groups)) > LARGEST_TABLE:
                raise DataError(f"{path} holds more than {LARGEST_TABLE // 1_000_000} MB", remedy="Split it")
            columns: dict[str, list[Any]] = {name: source.read([name])[name].to_pylist() for name in names}
        except (pyarrow.ArrowException, OSError, KeyError) as error:
            raise DataError(f"{path} is not a Parquet file, or is cut off: {error}", remedy=REMEDY) from None
    if not rows:
        raise DataError(f"{path} has no rows", remedy="Name a file with data")
    return Table(
        path=path, names=names, rows=rows, label=lambda row: f"row {row + 1}",
        cell=lambda column, row: _cell(columns[column][row]),
    )  # fmt: skip


def _cell(value: object) -> str | float:
    """Return a number, or the text of anything else; null is an empty cell, as in CSV."""
    return "" if value is None else value if isinstance(value, int | float) else str(value)
