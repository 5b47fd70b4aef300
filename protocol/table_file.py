"""Reads recordings in tables (CSV, also .gz; MATLAB) within fixed bounds.

A cell of a channel that is not a finite number is a missing reading: it is left out, and counted in a warning.

Rule: the size is checked during decompression: a compressed kilobyte may expand to a gigabyte.  A packed file unpacks
      to LARGEST_RATIO times its size at most, and to FREE_BYTES in any case.
"""

from __future__ import annotations

import csv
import gzip
import io
import os
import zlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, BinaryIO

from protocol.errors import DataError
from protocol.files import open_regular
from protocol.mat_file import BrokenMatError, MatTooLargeError, Numbers, Variable, byte_order, parse_mat

LARGEST_TABLE = 500_000_000  # bytes, unpacked: four hours at 500 Hz
LARGEST_RATIO = 100  # samples pack ten times; equal rows, which are not a recording, a thousand times
FREE_BYTES = 4_000_000
LONGEST_LINE = 100_000  # bytes; below the largest cell of Python's csv
REMEDY = "Name a CSV file (also .gz), a MATLAB or an MCAP file"
_GZIP = b"\x1f\x8b"
_PIECE = 1 << 16  # below LONGEST_LINE: a line within one piece is short enough


def read_csv_bytes(path: Path) -> bytes:
    """Return the content of a CSV file, decompressed, without a byte order mark.

    Raises:
        DataError: the file is absent, not a regular file, badly compressed, not text, or beyond the bounds.
    """
    with open_regular(path, remedy=REMEDY) as file:
        packed = file.read(2) == _GZIP
        file.seek(0)
        if not packed:
            if path.suffix == ".gz":
                raise DataError(f"{path} is named .gz but is not compressed", remedy="Rename it, or fetch it again")
            return _within_bounds(path, file, LARGEST_TABLE)
        try:
            with gzip.GzipFile(fileobj=file) as unpacked:
                return _within_bounds(path, unpacked, _largest(file))
        except (EOFError, OSError, zlib.error) as error:
            raise DataError(f"{path} is damaged or cut off: {error}", remedy="Fetch it again") from None


def read_header(path: Path, line: str, row: str, number: int = 1) -> tuple[tuple[str, ...], str]:
    """Return the names of the columns of a CSV file, and the character that separates its cells.

    `row` is the first line of data.  The error does not quote the content: a wrong path may name any private file of
    the user.

    Raises:
        DataError: the file cannot be a recording, has no line of names, or a name twice.
    """
    # The most frequent one: in a table with semicolons, a name may contain a comma.
    separator = max(",;\t", key=line.count)
    names = tuple(cell.strip() for cell in split(line, separator))
    if len(names) < 2 or not any(is_number(cell) for cell in split(row, separator)):
        raise DataError(
            f"{path} is not a recording: it has no line of two or more column names and a line of numbers after it",
            remedy=REMEDY,
        )
    if all(is_number(name) for name in names):
        raise DataError(
            f"{path}, line {number} holds numbers where the names of the columns belong",
            remedy=f"Write a line of {len(names)} names above it, such as t,u_c,i_c,x",
        )
    if len(set(names)) != len(names):
        twice = next(name for name in names if names.count(name) > 1)
        raise DataError(f"{path}, line {number}: column {twice!r} is there twice", remedy="Give each its own name")
    return names, separator


def split(line: str, separator: str) -> list[str]:
    """Return the cells of a line."""
    # A carriage return within a line does not end it here, and Python's csv reader would refuse it.
    return next(csv.reader([line.replace("\r", " ")], delimiter=separator, skipinitialspace=True), [])


def is_number(cell: str) -> bool:
    """Return whether a cell of a table is a number; nan and inf count as numbers."""
    try:
        float(cell)
    except ValueError:
        return False
    return True


def read_mat(path: Path) -> tuple[dict[str, Sequence[float]], dict[str, str]]:
    """Return the vectors of a .mat file up to version 7, and why its other variables are not columns.

    A variable is a vector, or a scalar struct of vectors (`run.x`).  A scalar beside vectors is not a column.

    Raises:
        DataError: the file is absent, too large, not a MATLAB file, of version 7.3, or without vectors.
    """
    columns: dict[str, Sequence[float]] = {}
    unusable: dict[str, str] = {}
    for name, value in _variables(path).items():
        _collect(name, value, columns, unusable)
    if not columns:
        reasons = "".join(f"; {name}: {why}" for name, why in unusable.items())
        raise DataError(f"{path} holds no numeric vectors{reasons}", remedy="Save t, x, ... as vectors of equal length")
    return {name: column for name, column in columns.items() if len(column) > 1} or columns, unusable


def _variables(path: Path) -> Mapping[str, Variable]:
    with open_regular(path, remedy=REMEDY) as file:
        largest = _largest(file)
        data = file.read(LARGEST_TABLE + 1)
    if len(data) > LARGEST_TABLE:
        raise _too_large(path, LARGEST_TABLE)
    if data[124:128] in (b"\x00\x02IM", b"\x02\x00MI"):
        raise DataError(f"{path} is a MATLAB 7.3 file", remedy="Save it again with: save(name, '-v7')")
    try:
        return parse_mat(data, largest) if byte_order(data) else _version_4(data)
    except MatTooLargeError:
        raise _too_large(path, largest) from None
    except BrokenMatError as error:
        raise DataError(f"{path} is not a MATLAB file, or is cut off: {error}", remedy="Save it again") from None


def _version_4(data: bytes) -> Mapping[str, Variable]:
    """Read a file of version 4, for which scipy uses Python code only: damaged bytes cannot crash the process."""
    from scipy.io import loadmat

    if 0 not in data[:4]:  # scipy recognises the version by this
        raise BrokenMatError("it does not begin as one")
    file: Any = io.BytesIO(data)  # the stub knows files by their paths alone
    try:
        content = loadmat(file)
    except Exception as error:  # scipy raises many types for a damaged file, KeyError among them
        raise BrokenMatError(str(error)) from None
    return {name: _of_version_4(value) for name, value in content.items() if not name.startswith("__")}


def _of_version_4(value: Any) -> Variable:
    if not hasattr(value, "ravel") or value.dtype.kind not in "fiub":
        return "it is text, complex or sparse"
    return Numbers(value.shape, value.ravel(order="F").tolist())


def _collect(name: str, value: Variable, columns: dict[str, Sequence[float]], unusable: dict[str, str]) -> None:
    if isinstance(value, dict):
        for field, inner in value.items():
            _collect(f"{name}.{field}", inner, columns, unusable)
    elif isinstance(value, str):
        unusable[name] = value
    elif 0 < len(value.values) == max(value.shape):
        columns[name] = value.values
    elif not value.values:
        unusable[name] = "it is empty"
    else:
        shape = " x ".join(map(str, value.shape))
        unusable[name] = f"it is a matrix of {shape}; save each of its columns as a vector"


def _largest(packed: BinaryIO) -> int:
    return min(LARGEST_TABLE, FREE_BYTES + LARGEST_RATIO * os.fstat(packed.fileno()).st_size)


def _within_bounds(path: Path, file: BinaryIO | gzip.GzipFile, largest: int) -> bytes:
    pieces: list[bytes] = []
    total = lines = unfinished = 0  # `unfinished`: bytes so far of a line that the last piece does not complete
    while piece := file.read(_PIECE):
        total += len(piece)
        if total > largest:
            raise _too_large(path, largest)
        # No text has a NUL: a picture or an archive is refused with its first piece.
        if not pieces and b"\0" in piece:
            raise DataError(f"{path} is not text", remedy="Name a CSV file in UTF-8, or a MATLAB file with .mat")
        first = piece.find(b"\n")
        if unfinished + (first if first >= 0 else len(piece)) > LONGEST_LINE:
            raise DataError(
                f"{path}, line {lines + 1} is longer than {LONGEST_LINE} bytes",
                remedy="Name a file with a line of column names and a line for each sample",
            )
        lines += piece.count(b"\n")
        unfinished = len(piece) - piece.rfind(b"\n") - 1 if first >= 0 else unfinished + len(piece)
        pieces.append(piece)
    return b"".join(pieces).removeprefix(b"\xef\xbb\xbf")


def _too_large(path: Path, largest: int) -> DataError:
    if largest < LARGEST_TABLE:
        problem = f"{path} unpacks to more than {LARGEST_RATIO} times its size, as no recording does"
        return DataError(problem, remedy="Unpack it, look at it, and name the unpacked file")
    return DataError(f"{path} holds more than {LARGEST_TABLE // 1_000_000} MB", remedy="Split it")
