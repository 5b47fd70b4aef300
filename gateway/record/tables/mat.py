"""Reads and writes columns in MATLAB files.  A variable is a vector, or a scalar struct of vectors (`run.x`)."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

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
        cell=lambda column, row: columns[column][row].item(),  # whole numbers stay exact: times in ns have 61 bits
        unusable=unusable,
    )


def write_mat(path: Path, columns: Mapping[str, npt.NDArray[Any]]) -> None:
    """Write column vectors under their names (a `.` or `/` in a name becomes `_`)."""
    from scipy.io import savemat

    savemat(
        path, {name.replace(".", "_").replace("/", "_"): values for name, values in columns.items()}, oned_as="column"
    )
