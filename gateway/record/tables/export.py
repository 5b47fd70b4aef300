"""Exports a topic of a log as columns to CSV, MATLAB or Parquet.  Numbers are exact; absent values stay absent.

Columns are the fields of the message, nested ones joined with `_` (x_m_error), `t_s` first.  Absent numbers are an
empty cell in CSV, null in Parquet, NaN in MATLAB.  A capture has one row per sample, t_s counted from the step.

Rule: a table with a column for each field of State is an export of the topic state, and `exported_states` reads it
      back.  Ticks, sessions, modes, flags and times are then those of the rig, to the bit, and nothing is concluded
      from the times of the rows.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
import numpy.typing as npt
from google.protobuf.descriptor import FieldDescriptor
from google.protobuf.json_format import MessageToJson

from gateway.record.tables.table import Table
from gateway.record.writer import LogError
from protocol.bus import board51_pb2 as pb
from protocol.bus import topics
from protocol.errors import DataError, quoted
from protocol.log.reader import LogReader, LogRecord

Format = Literal["csv", "mat", "parquet"]
Cell = float | int | str | None
_FIELDS: tuple[Any, ...] = tuple(pb.State.DESCRIPTOR.fields)  # two classes, by protobuf's backend
_FLOATS = (FieldDescriptor.TYPE_DOUBLE, FieldDescriptor.TYPE_FLOAT)
Kind = Literal["text", "message", "optional", "plain"]


@dataclass(slots=True)
class Columns:
    """Rows of cells of one topic of one board."""

    names: list[str]
    rows: list[list[Cell]]


def export(
    logs: Path | Sequence[Path],
    out: Path,
    *,
    form: Format,
    topic: str = "state",
    boards: Sequence[str] | None = None,
    start_s: float = 0.0,
    end_s: float | None = None,
) -> list[tuple[Path, int]]:
    """Write one file per board; with several boards the name becomes `<stem>-<board><suffix>`.

    Returns:
        Files and their numbers of rows.

    Raises:
        DataError: the log is absent, damaged, or has no messages of the topic.
        LogError: a file exists or cannot be written.
    """
    reader = LogReader(logs)
    last_ns = None
    tables: dict[str, Columns] = {}
    sources = dict(_sources(topics.TOPIC_OF_NAME[topic].message.DESCRIPTOR))
    for record in reader.records(topics_=[topic], boards=boards, start_s=start_s, end_s=end_s):
        last_ns = record.time_ns
        columns = tables.get(record.board)
        if columns is None:
            columns = tables[record.board] = Columns(_names(record, sources), [])
        columns.rows += _rows(record, sources, start_ns=reader.start_ns)
    reader.check(last_ns=last_ns)
    if not tables:
        present = sorted({c.topic for scan in reader.scans for c in scan.channels.values()})
        raise DataError(f"Log {reader.name} has no {topic} to export", remedy=f"It has: {', '.join(present)}")
    files = []
    for board, columns in tables.items():
        path = out if len(tables) == 1 else out.with_name(f"{out.stem}-{board}{out.suffix}")
        try:
            path.open("x").close()  # never overwrite an existing file
        except OSError as error:
            raise LogError(path, error) from None
        try:
            _WRITERS[form](path, columns)
        except OSError as error:
            path.unlink()
            raise LogError(path, error) from None
        files.append((path, len(columns.rows)))
    return files


def _names(record: LogRecord, sources: dict[str, _Source]) -> list[str]:
    if isinstance(record.message, pb.CaptureRecord):
        return ["t_s", "i_c_a", "u_c_v", "session", "capture_tick"]
    return ["t_s", *(name for name in sources if name != "t_s")]


def _rows(record: LogRecord, sources: dict[str, _Source], *, start_ns: int) -> Iterator[list[Cell]]:
    message = record.message
    if isinstance(message, pb.CaptureRecord):
        for index, i_c_a in enumerate(message.i_c_a):
            before = index < message.step_index
            u_c_v = message.u_from_v if before else message.u_to_v
            t_s = (index - message.step_index) * message.sample_time_s
            yield [t_s, i_c_a, u_c_v, message.session, message.tick]
        return
    time_s = _cell(message, sources["t_s"]) if "t_s" in sources else (record.time_ns - start_ns) / 1e9
    yield [time_s, *(_cell(message, source) for name, source in sources.items() if name != "t_s")]


class _Source(NamedTuple):
    """The field of a message that gives a column."""

    above: tuple[str, ...]  # the messages around the field, from the outermost
    name: str
    kind: Kind


def _sources(descriptor: Any, above: tuple[str, ...] = ()) -> Iterator[tuple[str, _Source]]:
    """Yield the name and the source of each column of a message."""
    for field in descriptor.fields:
        kind: Kind = "optional" if field.has_presence else "plain"
        if field.is_repeated or field.type == FieldDescriptor.TYPE_BYTES:
            kind = "text"
        elif field.message_type is not None and field.containing_oneof is None:
            yield from _sources(field.message_type, (*above, field.name))
            continue
        elif field.message_type is not None:
            kind = "message"
        yield "_".join((*above, field.name)), _Source(above, field.name, kind)


def _cell(message: Any, source: _Source) -> Cell:
    for name in source.above:
        if not message.HasField(name):
            return "" if source.kind == "text" else None
        message = getattr(message, name)
    if source.kind in ("message", "optional") and not message.HasField(source.name):
        return None
    value: Any = getattr(message, source.name)
    match source.kind:
        case "text" if isinstance(value, bytes):
            return value.hex()
        case "text" if hasattr(value, "items"):
            return " ".join(f"{key}={item}" for key, item in sorted(value.items()))
        case "text":
            return " ".join(repr(item) for item in value)
        case "message":
            return MessageToJson(value, indent=None)
    return int(value) if isinstance(value, bool) else value


def _write_csv(path: Path, columns: Columns) -> None:
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(columns.names)
        writer.writerows(columns.rows)  # a float as the shortest text that reads back as the same double, None as ""


def _write_mat(path: Path, columns: Columns) -> None:
    from scipy.io import savemat

    arrays: dict[str, npt.NDArray[Any]] = {}
    for name, cells in zip(columns.names, zip(*columns.rows, strict=True), strict=True):
        if any(isinstance(cell, str) for cell in cells):
            arrays[name] = np.array(["" if cell is None else str(cell) for cell in cells], dtype=object)
        elif all(isinstance(cell, int) for cell in cells):
            arrays[name] = np.array(cells, dtype=np.uint64 if max(cells) >= 2**53 else np.float64)
        else:
            arrays[name] = np.array([np.nan if cell is None else cell for cell in cells], dtype=float)
    named = {name.replace(".", "_").replace("/", "_"): values for name, values in arrays.items()}
    savemat(path, named, oned_as="column")


def _write_parquet(path: Path, columns: Columns) -> None:
    import pyarrow
    import pyarrow.parquet

    cells = zip(*columns.rows, strict=True)
    table = pyarrow.table({name: pyarrow.array(list(cell)) for name, cell in zip(columns.names, cells, strict=True)})
    pyarrow.parquet.write_table(table, path)


_WRITERS: dict[Format, Callable[[Path, Columns], None]] = {
    "csv": _write_csv,
    "mat": _write_mat,
    "parquet": _write_parquet,
}


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
