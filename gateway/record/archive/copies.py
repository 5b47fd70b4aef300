"""Copies the logs of a folder into a bucket, and single logs back.  Nothing is deleted in either.

Rule 1: a log is copied when the catalogue knows it as it is now: it has rested, and its sessions are known.
Rule 2: only the bucket decides what is archived: it stores SHA-256 and time of change with each log.
Rule 3: the rows of the catalogue are copied first, as NAME.sessions.jsonl, so each log in the bucket can be found.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Callable, Mapping
from pathlib import Path, PurePosixPath
from typing import Any, NamedTuple

from gateway.record.archive.bucket import Bucket, Stored
from gateway.record.catalogue.store import known_logs, learn, mark, rows_of, update
from protocol.errors import DataError, UsageError
from protocol.files import parse_json, writing

SESSIONS = ".sessions.jsonl"
_SHA256, _CHANGED = "sha256", "changed-ns"


class Tally(NamedTuple):
    """The result of one pass."""

    copied: int
    bytes: int
    archived: int  # logs in the bucket, without those that have changed in the folder since
    waiting: int  # logs that are being written, have changed meanwhile or cannot be read


class _Log(NamedTuple):
    """A log as the catalogue has read it."""

    name: str
    size: int
    changed_ns: int


class Archiver:
    """Brings a bucket up to date with a folder, and the folder's catalogue with the bucket."""

    def __init__(self, folder: Path, bucket: Bucket, progress: Callable[[str], None]) -> None:
        self._folder, self._bucket, self._progress = folder, bucket, progress
        self._same = set[tuple[_Log, Stored]]()  # found equal before: not compared again

    def copy(self) -> Tally:
        """Copy what is new or has changed.

        Raises:
            UsageError: the folder does not exist.
            ServiceError: the server, the network or the catalogue failed; what was copied so far stays.
        """
        listing = self._bucket.listing()
        stored = {name: item for name, item in listing.items() if name.endswith(".mcap")}
        unfinished = set(update(self._folder, self._progress).unfinished)
        known = known_logs(self._folder)
        local = {name for name in known if (self._folder / name).exists()} | unfinished
        logs = [_Log(name, *known[name]) for name in sorted(local - unfinished)]
        missing = [log for log in logs if not self._has_copy(log, stored.get(log.name))]
        copied, skipped = list[_Log](), set(unfinished)
        for number, log in enumerate(missing, 1):
            self._progress(f"[{number}/{len(missing)}] {log.name}, {log.size / 1e6:.1f} MB, to {self._bucket.address}")
            if self._copy_log(log):
                copied.append(log)
            else:
                skipped.add(log.name)
        away = [name for name in sorted(stored.keys() - local) if known.get(name, (-1,))[0] != stored[name].size]
        learn(self._folder, {name: (stored[name].size, self._rows(f"{name}{SESSIONS}", listing)) for name in away})
        archived = (stored.keys() | {log.name for log in copied}) - skipped
        mark(self._folder, {name: f"{self._bucket.address}/{name}" for name in archived})
        return Tally(len(copied), sum(log.size for log in copied), len(archived), len(skipped))

    def _has_copy(self, log: _Log, stored: Stored | None) -> bool:
        """Return whether the bucket has a log as it is in the folder."""
        if stored is None or stored.size != log.size:
            return False
        if (log, stored) not in self._same:
            attributes = self._bucket.attributes(log.name)
            try:
                is_same = attributes.get(_CHANGED) == str(log.changed_ns) or (
                    attributes.get(_SHA256) == _digest(self._folder / log.name)
                )
            except OSError:  # deleted meanwhile, or not readable: copying says so
                is_same = False
            if not is_same:
                return False
            self._same.add((log, stored))
        return True

    def _copy_log(self, log: _Log) -> bool:
        """Copy a log; return whether it was still as the catalogue knows it."""
        path = self._folder / log.name
        try:
            with path.open("rb") as file:
                status = os.fstat(file.fileno())
                if (status.st_size, status.st_mtime_ns) != log[1:]:
                    return False
                attributes = {_SHA256: hashlib.file_digest(file, "sha256").hexdigest(), _CHANGED: str(log.changed_ns)}
                file.seek(0)
                rows = "".join(f"{json.dumps(row)}\n" for row in rows_of(self._folder, log.name))
                self._bucket.put(f"{log.name}{SESSIONS}", rows.encode(), {})
                self._bucket.put(log.name, file, attributes)
        except OSError as error:  # deleted meanwhile, or not readable: the others go on
            self._progress(f"{path} is left out: {error.strerror}")
            return False
        return True

    def _rows(self, name: str, listing: Mapping[str, Stored]) -> list[dict[str, Any]]:
        """Return the rows of a log that only the bucket has; none if another program put it there."""
        self._progress(f"{self._bucket.address}/{name}")
        if name not in listing:
            return []
        lines = b"".join(self._bucket.get(name)[1]).decode(errors="replace").split("\n")
        try:
            rows = [parse_json(line, where=f"{self._bucket.address}/{name}") for line in lines if line]
        except DataError as error:
            self._progress(str(error))
            return []
        return [row for row in rows if isinstance(row, dict)]


def fetch(bucket: Bucket, name: str, out: Path) -> Path:
    """Copy a log from the bucket into a folder, whole and compared with its SHA-256; return its path.

    Raises:
        UsageError: another file of that name exists, or the folder cannot be written.
        DataError: the content is not what was archived.
        ServiceError: the server or the network failed, or there is no such log.
    """
    path, digest = out / PurePosixPath(name).name, hashlib.sha256()
    part = path.with_name(f".{path.name}.part")
    with writing(path):
        if path.exists():
            if bucket.attributes(name).get(_SHA256) == _digest(path):
                return path
            raise UsageError(f"{path} exists, with another content", remedy="Give another folder with --out")
        attributes, pieces = bucket.get(name)
        try:
            with part.open("wb") as file:
                for piece in pieces:
                    digest.update(piece)
                    file.write(piece)
                file.flush()
                os.fsync(file.fileno())
            if attributes.get(_SHA256, digest.hexdigest()) != digest.hexdigest():
                raise DataError(f"{bucket.address}/{name} is not what was archived", remedy="Look at the server's disk")
            if (changed_ns := attributes.get(_CHANGED, "")).isdigit():
                os.utime(part, ns=(int(changed_ns),) * 2)
            part.replace(path)
        finally:
            part.unlink(missing_ok=True)
    return path


def _digest(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
