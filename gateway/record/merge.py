"""Merges the parts of a folder, recorded and filled in at any time, into one log: in order, each record once.

SQLite sorts, on disk: the memory does not depend on the length of the log.
"""

from __future__ import annotations

import sqlite3
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from gateway.record.blocks import locate
from gateway.record.writer import LogWriter
from protocol.errors import DataError, UsageError
from protocol.log.reader import LogReader

_TABLE = """
CREATE TABLE record (stream TEXT, session INTEGER, id INTEGER, key TEXT, time_ns INTEGER, data BLOB,
PRIMARY KEY (stream, session, id)) WITHOUT ROWID
"""
_HALF = 1 << 63


@dataclass(slots=True)
class Merged:
    """The result of a merge."""

    parts: int = 0
    records: int = 0
    twice: int = 0  # records that several parts had; one of each is in the log
    unreadable: tuple[str, ...] = ()  # parts, and what is wrong with them


def merge(
    folder: Path, out: Path, *, boards: Sequence[str] | None = None, report: Callable[[str], None] = lambda line: None
) -> Merged:
    """Write all records of the parts of a folder into the new file `out`.

    Samples are in the order of their ticks within each session, and all records in the order of their log time.

    Raises:
        UsageError: there are no logs in the folder.
        DataError: no part can be read.
        LogError: `out` exists or cannot be written.
    """
    paths = [path for path in sorted(folder.glob("*.mcap")) if path.resolve() != out.resolve()]
    if not paths:
        raise UsageError(f"{folder} has no logs", remedy="Give the folder of the parts: *.mcap")
    result = Merged()
    with (
        LogWriter(out, metadata={"merge": {"parts": str(len(paths))}}) as writer,
        tempfile.TemporaryDirectory(dir=out.parent, prefix=".merge-") as work,
        closing(sqlite3.connect(Path(work) / "sorted.sqlite")) as database,
    ):
        for pragma in ("journal_mode = OFF", "synchronous = OFF", "temp_store = FILE", "cache_size = -65536"):
            database.execute(f"PRAGMA {pragma}")
        database.execute(_TABLE)
        for path in paths:
            report(f"{path.name} ({result.parts + 1} of {len(paths)})")
            _take(database, path, boards, result)
        if result.parts == len(result.unreadable):
            raise DataError(f"No log of {folder} can be read: {result.unreadable[0]}", remedy="Use another folder")
        database.execute("CREATE INDEX in_order ON record (time_ns, session, id)")
        for key, time_ns, data in database.execute(
            "SELECT key, time_ns, data FROM record ORDER BY time_ns, session, id"
        ):
            writer.write(key, data, time_ns)
            result.records += 1
    return result


def _take(database: sqlite3.Connection, path: Path, boards: Sequence[str] | None, result: Merged) -> None:
    result.parts += 1
    before = database.total_changes
    read = 0

    def rows(reader: LogReader) -> Iterator[tuple[Any, ...]]:
        nonlocal read
        for record in reader.raw(boards=boards):
            located, read = locate(record), read + 1
            stream, session, number = (*located.block[:2], located.id) if located else ("", result.parts, read)
            signed = number - 2 * _HALF if number >= _HALF else number
            yield stream, session, signed, record.key, min(record.time_ns, _HALF - 1), record.data

    try:
        reader = LogReader(path)
        database.executemany("INSERT OR IGNORE INTO record VALUES (?, ?, ?, ?, ?, ?)", rows(reader))
        reader.check_damage(last_ns=None, cut_is_damage=False)
    except DataError as error:
        result.unreadable += (str(error),)
    database.commit()
    result.twice += read - (database.total_changes - before)
