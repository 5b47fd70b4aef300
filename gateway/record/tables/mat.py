"""Reads and writes columns in MATLAB files.  A variable is a vector, or a scalar struct of vectors (`run.x`)."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from gateway.record.tables.table import Table
from protocol import table_file
from protocol.errors import DataError


def read_mat(path: Path) -> Table:
    """Read the numeric vectors of a .mat file up to version 7.

    Raises:
        DataError: the file is absent, not a MATLAB file, of version 7.3, without vectors, or with vectors of different
            lengths.
    """
    columns: dict[str, npt.NDArray[Any]]
    columns, unusable = table_file.read_mat(path, _collect, squeeze=False)
    # A scalar beside vectors (a sample time, a mass) is not a column.
    columns = {name: column for name, column in columns.items() if len(column) > 1} or columns
    lengths = {name: len(column) for name, column in columns.items()}
    if len(set(lengths.values())) > 1:
        listed = ", ".join(f"{name} {length}" for name, length in lengths.items())
        raise DataError(f"{path}: vectors differ in length: {listed}", remedy="Save vectors of equal length")
    return Table(
        path=path,
        names=tuple(columns),
        rows=next(iter(lengths.values())),
        label=lambda row: f"sample {row + 1}",
        cell=lambda column, row: columns[column][row].item(),  # whole numbers stay exact: times in ns have 61 bits
        unusable=unusable,
    )


def _collect(name: str, value: Any, columns: dict[str, npt.NDArray[Any]], unusable: dict[str, str]) -> None:
    if (
        isinstance(value, np.ndarray)
        and value.dtype == object
        and value.size == 1
        and hasattr(value.item(), "_fieldnames")
    ):
        record = value.item()
        for field in record._fieldnames:  # noqa: SLF001  # scipy's documented way into a struct
            _collect(f"{name}.{field}", getattr(record, field), columns, unusable)
    elif isinstance(value, np.ndarray) and value.dtype.kind in "fiub" and 0 < value.size == max(value.shape):
        columns[name] = value.ravel()
    else:
        unusable[name] = _why(value)


def _why(value: Any) -> str:
    """Return why a variable cannot be used as a column."""
    if not isinstance(value, np.ndarray):
        return f"its type is not supported ({type(value).__name__})"
    shape = " x ".join(str(size) for size in value.shape)
    if value.size == 0:
        return "it is empty"
    if value.dtype.kind in "fiub":
        return f"it is a matrix of {shape}; save each of its columns as a vector"
    if value.dtype.kind == "c":
        return "it is complex"
    if value.dtype.kind in "US":
        return "it is text"
    return f"it is a cell or struct array of {shape}; save vectors of numbers"


def write_mat(path: Path, columns: Mapping[str, npt.NDArray[Any]]) -> None:
    """Write column vectors under their names (a `.` or `/` in a name becomes `_`)."""
    from scipy.io import savemat

    savemat(
        path, {name.replace(".", "_").replace("/", "_"): values for name, values in columns.items()}, oned_as="column"
    )
