"""The numbers in a MATLAB file of version 5 to 7, by its published layout (MathWorks, *MAT-File Format*, chapter 1).

A reader of our own: that of scipy ends the whole process (a segmentation fault) on some damaged files.

Rule 1: no bytes do more than raise `BrokenMatError`.
Rule 2: for a variable that is neither an array of real numbers nor a struct of arrays, the reason is returned.
"""

from __future__ import annotations

import math
import struct
import sys
import zlib
from array import array
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

HEAD = 128  # bytes before the first element
_DEEPEST = 20  # structs within structs
_MATRIX, _COMPRESSED = 14, 15
_CODES = {1: "b", 2: "B", 3: "h", 4: "H", 5: "i", 6: "I", 7: "f", 9: "d", 12: "q", 13: "Q"}  # of Python's array
_CELL, _STRUCT, _OBJECT, _TEXT, _SPARSE, _FIRST_NUMBER, _LAST_NUMBER = 1, 2, 3, 4, 5, 6, 15
_COMPLEX = 0x0800


class Numbers(NamedTuple):
    """An array of real numbers, column after column."""

    shape: tuple[int, ...]
    values: Sequence[float]


Variable = Numbers | dict[str, Any] | str  # numbers; a struct's fields; why it is neither


class BrokenMatError(ValueError):
    """The bytes are not a whole MATLAB file."""


class MatTooLargeError(ValueError):
    """The file expands beyond the bound."""


def byte_order(head: bytes) -> str:
    """Return "<" or ">" for the first bytes of a file of version 5 to 7, "" for any other file."""
    return {b"\x00\x01IM": "<", b"\x01\x00MI": ">"}.get(head[HEAD - 4 : HEAD], "")


def parse_mat(data: bytes, largest: int) -> dict[str, Variable]:
    """Return the variables of a file by name; its compressed parts may unpack to `largest` bytes together.

    Raises:
        BrokenMatError: it is none, or is cut off or damaged.
        MatTooLargeError: it expands to more.
    """
    order = byte_order(data)
    if not order:
        raise BrokenMatError("it does not begin as one")
    variables: dict[str, Variable] = {}
    try:
        for kind, content in _elements(memoryview(data)[HEAD:], order):
            if kind == _COMPRESSED:
                # One byte beyond the bound shows a part that is too large, without unpacking all of it.
                content = memoryview(zlib.decompressobj().decompress(content, largest + 1))
                if len(content) > largest:
                    raise MatTooLargeError
                largest -= len(content)
            for inner, matrix in _elements(content, order) if kind == _COMPRESSED else [(kind, content)]:
                if inner == _MATRIX and len(matrix):
                    name, value = _variable(matrix, order, 0)
                    variables[name] = value
    except (struct.error, zlib.error, StopIteration, UnicodeDecodeError) as error:
        raise BrokenMatError(str(error) or "a part is missing") from None
    variables.pop("", None)  # what MATLAB keeps for itself has no name
    return variables


def _elements(data: memoryview, order: str) -> Iterator[tuple[int, memoryview]]:
    """Yield type and content of each element."""
    at = 0
    while at < len(data):
        kind, size = struct.unpack_from(f"{order}II", data, at)
        begin, padded = at + 8, True
        if kind >> 16:  # a short one, whose content is in its tag
            kind, size, begin, padded = kind & 0xFFFF, kind >> 16, at + 4, False
        end = begin + size
        if end > (len(data) if padded else at + 8):
            raise BrokenMatError(f"an element of {size} bytes is cut off")
        yield kind, data[begin:end]
        # Elements are padded to eight bytes, compressed ones are not.
        at = end if kind == _COMPRESSED else end + -size % 8 if padded else at + 8


def _variable(matrix: memoryview, order: str, depth: int) -> tuple[str, Variable]:
    parts = _elements(matrix, order)
    flags, *_ = struct.unpack_from(f"{order}I", next(parts)[1])
    dimensions = next(parts)[1]
    shape = struct.unpack(f"{order}{len(dimensions) // 4}i", dimensions)
    name = bytes(next(parts)[1]).decode("utf-8")
    if len(shape) < 2 or min(shape) < 0:
        raise BrokenMatError(f"{name or 'a variable'} has the shape {shape}")
    kind = flags & 0xFF
    if kind in range(_FIRST_NUMBER, _LAST_NUMBER + 1) and not flags & _COMPLEX:
        return name, _numbers(name, shape, *next(parts), order)
    if kind == _STRUCT and math.prod(shape) == 1:
        if depth == _DEEPEST:
            raise BrokenMatError(f"{name} is nested too deeply")
        return name, _struct(parts, order, depth)
    return name, _why_not(kind, flags, shape)


def _numbers(name: str, shape: tuple[int, ...], kind: int, content: memoryview, order: str) -> Numbers:
    if kind not in _CODES:
        raise BrokenMatError(f"{name} holds numbers of type {kind}")
    values = array(_CODES[kind])
    # Before the array is filled: a damaged shape must not decide how much is read.
    if len(content) != math.prod(shape) * values.itemsize:
        raise BrokenMatError(f"{name} has {len(content)} bytes for a shape of {shape}")
    values.frombytes(content)
    if order != {"little": "<", "big": ">"}[sys.byteorder]:
        values.byteswap()
    return Numbers(shape, values)


def _struct(parts: Iterator[tuple[int, memoryview]], order: str, depth: int) -> dict[str, Variable]:
    (length,) = struct.unpack_from(f"{order}i", next(parts)[1])
    names = bytes(next(parts)[1])
    if length < 1 or len(names) % length:
        raise BrokenMatError("the names of a struct's fields are damaged")
    fields: dict[str, Variable] = {}
    for at in range(0, len(names), length):
        field = names[at : at + length].partition(b"\0")[0].decode("utf-8")
        _, content = next(parts)
        fields[field] = _variable(content, order, depth + 1)[1] if len(content) else "it is empty"
    return fields


def _why_not(kind: int, flags: int, shape: tuple[int, ...]) -> str:
    if kind in (_CELL, _STRUCT, _OBJECT):
        return f"it is a cell or struct array of {' x '.join(map(str, shape))}; save vectors of numbers"
    if kind == _TEXT:
        return "it is text"
    if kind == _SPARSE:
        return "it is sparse; save it with full()"
    return "it is complex" if flags & _COMPLEX else f"its type is not supported ({kind})"
