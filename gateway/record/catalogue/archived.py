"""The logs of a catalogue that lie in an archive.  Their rows stay when the logs are deleted on this machine."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from gateway.record.catalogue.store import COLUMNS, insert, opened


def known_logs(folder: Path) -> dict[str, tuple[int, int]]:
    """Return (size, time of change in ns) of each log that the catalogue has read, by its name."""
    with opened(folder, "ro") as database:
        return {name: (size, changed_ns) for name, size, changed_ns, _ in database.execute("SELECT * FROM seen")}


def archived_logs(folder: Path) -> set[tuple[str, int, int]]:
    """Return (name, size, time of change in ns) of the logs that lie in the archive."""
    with opened(folder, "ro") as database:
        return set(database.execute("SELECT file, bytes, changed_ns FROM seen WHERE archived != ''"))


def rows_of(folder: Path, name: str) -> list[dict[str, Any]]:
    """Return the rows of one log by column, as they are archived with it."""
    columns = [column for column in COLUMNS if column != "archived"]
    with opened(folder, "ro") as database:
        rows = database.execute(f"SELECT {', '.join(columns)} FROM logs WHERE file = ? ORDER BY began", (name,))
        return [dict(zip(columns, row, strict=True)) for row in rows]


def learn(folder: Path, logs: Mapping[str, tuple[int, Sequence[Mapping[str, Any]]]]) -> None:
    """Take size and rows of logs that lie in an archive alone.  A copy of one here will be read like any other log."""
    with opened(folder, "rw") as database, database:
        for name, (size, rows) in logs.items():
            values = [{column: _scalar(row.get(column)) for column in COLUMNS} for row in rows]
            insert(database, name, (size, 0), [{**row, "file": name, "archived": ""} for row in values])


def _scalar(value: Any) -> Any:
    return str(value) if isinstance(value, list | dict) else value


def mark(folder: Path, addresses: Mapping[str, str]) -> None:
    """Note the addresses of all logs that lie in the archive, and that no others do."""
    with opened(folder, "rw") as database, database:
        noted = dict(database.execute("SELECT file, archived FROM seen"))
        changed = [(addresses.get(name, ""), name) for name in noted if noted[name] != addresses.get(name, "")]
        for table in ("seen", "logs"):
            database.executemany(f"UPDATE {table} SET archived = ? WHERE file = ?", changed)
