"""Reads back what `export` wrote of the topic state: each row becomes the State that it was.

Rule: a table is an export if it has a column for each field of State.  Ticks, sessions, modes, flags and times are then
those of the rig, to the bit, and nothing is concluded from the times of the rows.
"""

from __future__ import annotations

import math
from typing import Any

from google.protobuf.descriptor import FieldDescriptor

from gateway.record.tables.table import Table
from protocol.bus import board51_pb2 as pb
from protocol.errors import DataError, quoted

_FIELDS: tuple[Any, ...] = tuple(pb.State.DESCRIPTOR.fields)  # two classes, by protobuf's backend
_FLOATS = (FieldDescriptor.TYPE_DOUBLE, FieldDescriptor.TYPE_FLOAT)


def is_export(table: Table) -> bool:
    """Return whether the table was written by `export`."""
    return all(field.name in table.names for field in _FIELDS)


def exported_states(table: Table) -> list[pb.State]:
    """Return the rows as messages.

    Raises:
        DataError: a cell is not a value of its field; the message names file, line, column and value.
    """
    return [_state(table, row) for row in range(table.rows)]


def _state(table: Table, row: int) -> pb.State:
    state = pb.State()
    for field in _FIELDS:
        cell = table.cell(field.name, row)
        if field.has_presence and (cell == "" or (isinstance(cell, float) and math.isnan(cell))):
            continue  # absent: an empty cell of CSV, NaN of MATLAB
        try:
            value = float(cell) if field.type in _FLOATS else _whole(cell)
            if not math.isfinite(value):
                raise ValueError
            setattr(state, field.name, value)
        except (ValueError, OverflowError):
            raise DataError(
                f"{table.path}, {table.label(row)}: {field.name} = {quoted(cell)} is not a value of an exported log",
                remedy="Export the log again, or name the columns with --map",
            ) from None
    return state


def _whole(cell: str | float) -> int:
    if isinstance(cell, float) and not cell.is_integer():
        raise ValueError
    return int(cell)
