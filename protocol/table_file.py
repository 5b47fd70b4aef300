"""Reads recordings in tables (CSV, also .gz; MATLAB) within fixed bounds.

Rule: the size is checked during decompression: a compressed kilobyte may expand to a gigabyte.  A packed file unpacks
      to LARGEST_RATIO times its size at most, and to FREE_BYTES in any case.
"""

from __future__ import annotations

import gzip
import os
import struct
import zlib
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, BinaryIO, TypeVar

from protocol.errors import DataError
from protocol.files import open_regular

T = TypeVar("T")
LARGEST_TABLE = 500_000_000  # bytes, unpacked: four hours at 500 Hz
LARGEST_RATIO = 100  # samples pack ten times; equal rows, which are not a recording, a thousand times
FREE_BYTES = 4_000_000
LONGEST_LINE = 100_000  # bytes; below the largest cell of Python's csv
REMEDY = "Name a CSV file (also .gz), a MATLAB or an MCAP file"
_GZIP = b"\x1f\x8b"
_PIECE = 1 << 16  # below LONGEST_LINE: a line within one piece is short enough
_MAT_HEAD = 128
_COMPRESSED = 15  # miCOMPRESSED of the MAT-file format, level 5


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


def check_table(path: Path, head: Sequence[str], row: Sequence[str]) -> None:
    """Refuse a file that cannot be a recording.

    The error does not quote the content: a wrong path may name any private file of the user.

    Args:
        path: Path for the error.
        head: Cells of the first line.
        row: Cells of the first line of data.

    Raises:
        DataError: fewer than two columns, or no cell of the row is a number.
    """
    if len(head) < 2 or not any(is_number(cell) for cell in row):
        raise DataError(
            f"{path} is not a recording: it has no line of two or more column names and a line of numbers after it",
            remedy=REMEDY,
        )


def is_number(cell: str) -> bool:
    """Return whether a cell of a table is a number; nan and inf count as numbers."""
    try:
        float(cell)
    except ValueError:
        return False
    return True


def read_mat(
    path: Path, collect: Callable[[str, Any, dict[str, T], dict[str, str]], None], *, squeeze: bool
) -> tuple[dict[str, T], dict[str, str]]:
    """Return the columns of a .mat file up to version 7, and why its other variables are not columns.

    Args:
        path: Path of the file.
        collect: Takes the name and value of a variable, and puts it into the columns or the others.
        squeeze: Whether arrays lose their dimensions of length 1.

    Raises:
        DataError: the file is absent, too large, not a MATLAB file, of version 7.3, or without vectors.
    """
    from scipy.io import loadmat

    check_mat(path)
    try:
        content = loadmat(path, squeeze_me=squeeze, struct_as_record=False)
    except NotImplementedError:
        raise DataError(f"{path} is a MATLAB 7.3 file", remedy="Save it again with: save(name, '-v7')") from None
    except Exception as error:  # scipy raises many types for a damaged file, KeyError and zlib.error among them
        raise DataError(f"{path} is not a MATLAB file, or is cut off: {error}", remedy="Save it again") from None
    columns: dict[str, T] = {}
    unusable: dict[str, str] = {}
    for name, value in content.items():
        if not name.startswith("__"):
            collect(name, value, columns, unusable)
    if not columns:
        reasons = "".join(f"; {name}: {why}" for name, why in unusable.items())
        raise DataError(f"{path} holds no numeric vectors{reasons}", remedy="Save t, x, ... as vectors of equal length")
    return columns, unusable


def check_mat(path: Path) -> None:
    """Refuse a MATLAB file that expands beyond the bounds; its reader reports all other faults.

    Raises:
        DataError: the file is absent, not a regular file, or too large.
    """
    with open_regular(path, remedy=REMEDY) as file:
        file.seek(_MAT_HEAD - 2)
        order = "<" if file.read(2) == b"IM" else ">"
        total, largest = 0, _largest(file)
        while len(tag := file.read(8)) == 8:
            kind, size = struct.unpack(f"{order}II", tag)
            if kind != _COMPRESSED:
                file.seek(size, 1)
                continue
            unpack = zlib.decompressobj()
            while size > 0 and (piece := file.read(min(size, _PIECE))):
                size -= len(piece)
                try:
                    while piece:
                        total += len(unpack.decompress(piece, LARGEST_TABLE // 100))
                        piece = unpack.unconsumed_tail
                        if total > largest:
                            raise _too_large(path, largest)
                except zlib.error:
                    return


def _largest(packed: BinaryIO) -> int:
    return min(LARGEST_TABLE, FREE_BYTES + LARGEST_RATIO * os.fstat(packed.fileno()).st_size)


def _within_bounds(path: Path, file: BinaryIO | gzip.GzipFile, largest: int) -> bytes:
    pieces: list[bytes] = []
    total = lines = unfinished = 0  # `unfinished`: bytes so far of a line that the last piece does not complete
    while piece := file.read(_PIECE):
        total += len(piece)
        if total > largest:
            raise _too_large(path, largest)
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
