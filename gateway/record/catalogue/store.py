"""The database of a folder of logs: kept in step with the files, and asked in SQL.

SQLite, not Parquet and DuckDB: it comes with Python, a changed log changes its own rows alone, and Grafana and every
language read it.  Questions come from people and from pages, so SQLite itself refuses whatever is not a SELECT.

The rows of logs that lie in an archive stay when the logs are deleted on this machine.
"""

from __future__ import annotations

import sqlite3
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any, NamedTuple, get_type_hints

from gateway.record.catalogue.sessions import Session, sessions_of
from protocol.errors import DataError, ServiceError, UsageError

NAME = "catalogue.sqlite"
COLUMNS = ("file", "bytes", *(column.name for column in fields(Session)), "problem", "archived")
RECENT_S = 5.0  # a log that has changed since is being written
LIMIT_S = 10.0  # for the answer to a question
MAX_ROWS = 100_000
MAX_TEXT = 1_000_000  # bytes of a value: no question fills the memory
_VERSION = 2
_READS = (sqlite3.SQLITE_SELECT, sqlite3.SQLITE_READ, sqlite3.SQLITE_FUNCTION)


class Update(NamedTuple):
    """The result of bringing the catalogue up to date."""

    read: int  # logs that are new or have changed
    forgotten: int  # logs that are gone
    unfinished: tuple[str, ...]  # logs that are being written: in the catalogue once they rest
    unreadable: tuple[str, ...]


class Answer(NamedTuple):
    """The rows that a question found."""

    columns: tuple[str, ...]
    rows: list[tuple[Any, ...]]


def update(folder: Path, progress: Callable[[str], None] = lambda text: None) -> Update:
    """Read the logs below a folder that the catalogue does not know, or not as they are now.

    Raises:
        UsageError: the folder does not exist.
        ServiceError: the catalogue cannot be written, or is not a database.
    """
    if not folder.is_dir():
        raise UsageError(f"{folder} is not a folder", remedy="Give the folder of the logs")
    with _opened(folder, "rwc") as database:
        _prepare(database)
        known = {name: (size, changed) for name, size, changed, _ in database.execute("SELECT * FROM seen")}
        present, unfinished, unreadable, read = set[str](), [], [], 0
        paths = sorted(folder.rglob("*.mcap"))
        for number, path in enumerate(paths, 1):
            name = path.relative_to(folder).as_posix()
            try:
                status = path.stat()
            except OSError:  # deleted meanwhile
                continue
            present.add(name)
            if known.get(name) == (status.st_size, status.st_mtime_ns):
                continue
            if time.time() - status.st_mtime < RECENT_S:
                unfinished.append(name)
                continue
            progress(f"[{number}/{len(paths)}] {name}")
            try:
                rows, problem = sessions_of(path)
            except DataError as error:
                rows, problem = [], str(error)
                unreadable.append(f"{name}: {error.problem}")
            size = status.st_size
            values = [{"file": name, "bytes": size, **asdict(row), "problem": problem, "archived": ""} for row in rows]
            with database:  # one transaction per log: an interrupted update keeps the logs read so far
                _insert(database, name, (size, status.st_mtime_ns), values)
            read += 1
        stays = present | {name for (name,) in database.execute("SELECT file FROM seen WHERE archived != ''")}
        deleted = [name for name in known if name not in stays]
        with database:
            _forget(database, deleted)
    return Update(read, len(deleted), tuple(unfinished), tuple(unreadable))


def query(folder: Path, sql: str, *, limit_s: float = LIMIT_S) -> Answer:
    """Return the rows that one SELECT finds in the table `logs`; it can neither write nor read anything else.

    Raises:
        UsageError: there is no catalogue, the question is not one SELECT over `logs`, or it takes too long.
    """
    if not (folder / NAME).is_file():
        raise UsageError(f"{folder} has no catalogue", remedy="Run board51 logs query without --no-update first")
    with _opened(folder, "ro") as database:
        deadline = time.monotonic() + limit_s
        database.set_progress_handler(lambda: time.monotonic() > deadline, 10_000)
        database.set_authorizer(lambda action, *_: sqlite3.SQLITE_OK if action in _READS else sqlite3.SQLITE_DENY)
        database.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, MAX_TEXT)
        try:
            cursor = database.execute(sql)
            rows = cursor.fetchmany(MAX_ROWS + 1)
        except (sqlite3.Error, sqlite3.Warning) as error:
            problem = f"The question cannot be answered: {error}"
            if time.monotonic() > deadline:
                problem = f"The question took more than {limit_s:g} s"
            raise UsageError(problem, remedy=f"Use SQL over these columns: {', '.join(COLUMNS)}") from None
        if len(rows) > MAX_ROWS:
            raise UsageError(f"The question finds more than {MAX_ROWS} rows", remedy="Ask for fewer, or for sums")
        return Answer(tuple(name for name, *_ in cursor.description or ()), rows)


def selection(condition: str, columns: Sequence[str] = COLUMNS) -> str:
    """Return the SELECT for a condition on the columns, by the time of the beginning; all rows for an empty one."""
    where = f" WHERE ({condition})" if condition else ""
    return f"SELECT {', '.join(columns)} FROM logs{where} ORDER BY began, site, board, session"


def known_logs(folder: Path) -> dict[str, tuple[int, int]]:
    """Return (size, time of change in ns) of each log that the catalogue has read, by its name."""
    with _opened(folder, "ro") as database:
        return {name: (size, changed_ns) for name, size, changed_ns, _ in database.execute("SELECT * FROM seen")}


def archived_logs(folder: Path) -> set[tuple[str, int, int]]:
    """Return (name, size, time of change in ns) of the logs that lie in the archive."""
    with _opened(folder, "ro") as database:
        return set(database.execute("SELECT file, bytes, changed_ns FROM seen WHERE archived != ''"))


def rows_of(folder: Path, name: str) -> list[dict[str, Any]]:
    """Return the rows of one log by column, as they are archived with it."""
    columns = [column for column in COLUMNS if column != "archived"]
    with _opened(folder, "ro") as database:
        rows = database.execute(f"SELECT {', '.join(columns)} FROM logs WHERE file = ? ORDER BY began", (name,))
        return [dict(zip(columns, row, strict=True)) for row in rows]


def learn(folder: Path, logs: Mapping[str, tuple[int, Sequence[Mapping[str, Any]]]]) -> None:
    """Take size and rows of logs that lie in an archive alone.  A copy of one here will be read like any other log."""
    with _opened(folder, "rw") as database, database:
        for name, (size, rows) in logs.items():
            values = [{column: _scalar(row.get(column)) for column in COLUMNS} for row in rows]
            _insert(database, name, (size, 0), [{**row, "file": name, "archived": ""} for row in values])


def _scalar(value: Any) -> Any:
    return str(value) if isinstance(value, list | dict) else value


def mark(folder: Path, addresses: Mapping[str, str]) -> None:
    """Note the addresses of all logs that lie in the archive, and that no others do."""
    with _opened(folder, "rw") as database, database:
        noted = dict(database.execute("SELECT file, archived FROM seen"))
        changed = [(addresses.get(name, ""), name) for name in noted if noted[name] != addresses.get(name, "")]
        for table in ("seen", "logs"):
            database.executemany(f"UPDATE {table} SET archived = ? WHERE file = ?", changed)


def _insert(database: sqlite3.Connection, name: str, state: tuple[int, int], rows: Sequence[dict[str, Any]]) -> None:
    """Put the rows of a log in place of those that are known; `state` is its size and its time of change in ns."""
    _forget(database, [name])
    database.execute("INSERT INTO seen VALUES (?, ?, ?, '')", (name, *state))
    places = ", ".join(f":{column}" for column in COLUMNS)
    database.executemany(f"INSERT INTO logs ({', '.join(COLUMNS)}) VALUES ({places})", rows)


@contextmanager
def _opened(folder: Path, mode: str) -> Iterator[sqlite3.Connection]:
    """Open the database of a folder: `ro`, `rw`, or `rwc` to create it.

    Raises:
        ServiceError: it cannot be opened, read or written.
    """
    try:
        with closing(sqlite3.connect(f"{(folder / NAME).resolve().as_uri()}?mode={mode}", uri=True)) as database:
            yield database
    except sqlite3.DatabaseError as error:
        where = folder / NAME
        raise ServiceError(f"{where}: {error}", remedy="Look at its rights and the disk, or delete it") from None


def _prepare(database: sqlite3.Connection) -> None:
    """Make the tables; replace those of another version, as the logs hold everything."""
    if _has_tables(database):
        return
    kinds = {int: "INTEGER", int | None: "INTEGER", float: "REAL", float | None: "REAL", str: "TEXT"}
    types = {"file": str, "bytes": int, **get_type_hints(Session), "problem": str, "archived": str}
    columns = ", ".join(f"{name} {kinds[types[name]]}" for name in COLUMNS)
    with database:
        # Python begins no transaction for a CREATE TABLE, and another process may have made the tables meanwhile.
        database.execute("BEGIN IMMEDIATE")
        if _has_tables(database):
            return
        database.execute("DROP TABLE IF EXISTS seen")
        database.execute("DROP TABLE IF EXISTS logs")
        database.execute("CREATE TABLE seen (file TEXT PRIMARY KEY, bytes INTEGER, changed_ns INTEGER, archived TEXT)")
        database.execute(f"CREATE TABLE logs ({columns})")
        database.execute("CREATE INDEX by_file ON logs (file)")
        database.execute(f"PRAGMA user_version = {_VERSION}")


def _has_tables(database: sqlite3.Connection) -> bool:
    version: int = database.execute("PRAGMA user_version").fetchone()[0]
    return version == _VERSION


def _forget(database: sqlite3.Connection, names: Sequence[str]) -> None:
    for table in ("seen", "logs"):
        database.executemany(f"DELETE FROM {table} WHERE file = ?", [(name,) for name in names])
