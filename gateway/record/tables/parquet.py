"""Reads columns of a Parquet file, as `export` and pandas write them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from gateway.record.tables.table import Table
from protocol.errors import DataError, missing_extra
from protocol.files import open_regular
from protocol.table_file import LARGEST_TABLE, REMEDY

_BYTES_PER_CELL = 8


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
        path=path,
        names=names,
        rows=rows,
        label=lambda row: f"row {row + 1}",
        cell=lambda column, row: _cell(columns[column][row]),
    )


def _cell(value: object) -> str | float:
    """Return a number, or the text of anything else; null is an empty cell, as in CSV."""
    return "" if value is None else value if isinstance(value, int | float) else str(value)
