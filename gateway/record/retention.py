"""Deletes the logs of a folder that are too old or too many.  `expired` decides, and is pure.

Rule 1: only files with a recorder's names are deleted: an import, or a log that somebody renamed, stays.
Rule 2: what is recorded now stays, here or by another process: a log that has grown within RECENT_S.
"""

from __future__ import annotations

import re
import time
from collections.abc import Iterator, Sequence
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

from protocol.errors import ServiceError

RECENT_S = 60.0  # a gateway writes at least its status every second
DAY_S = 86400.0


class Log(NamedTuple):
    """A part of a log on the disk."""

    path: Path
    modified_s: float  # Unix time
    size: int  # bytes


def delete_expired(
    folder: Path, prefix: str, keep_days: float, keep_gb: float, keep_unarchived: bool = False
) -> Iterator[tuple[str, str]]:
    """Delete what `expired` names; yield severity and text of an event for each log."""
    if not (keep_days or keep_gb):
        return
    logs = expired(logs_in(folder, prefix), time.time(), keep_days=keep_days, keep_gb=keep_gb)
    retained, archived = 0, set[tuple[str, int, int]]()
    if logs and keep_unarchived:
        from gateway.record.catalogue.store import archived_logs  # a gateway starts without it

        try:
            archived = archived_logs(folder)
        except ServiceError as error:
            yield "warning", f"no log is deleted, as the catalogue does not say which are archived: {error}"
            return
    for path, reason in logs:
        try:
            if keep_unarchived and (path.name, path.stat().st_size, path.stat().st_mtime_ns) not in archived:
                retained += 1
                continue
            path.unlink(missing_ok=True)
            yield "info", f"{path.name} deleted: {reason}"
        except OSError as error:
            yield "warning", f"{path.name} cannot be deleted: {error.strerror}"
    if retained:
        yield "warning", f"logs kept beyond the bound, as they are not archived yet: {retained}"


def logs_in(folder: Path, prefix: str) -> list[Log]:
    """Return the parts of all logs with this prefix."""
    name, parts = re.compile(re.escape(prefix) + r"-\d{8}T\d{6}Z-\d{3,}\.mcap"), []
    for path in folder.iterdir():
        if name.fullmatch(path.name):
            with suppress(OSError):  # deleted meanwhile
                status = path.stat()
                parts.append(Log(path, status.st_mtime, status.st_size))
    return parts


def expired(logs: Sequence[Log], now_s: float, *, keep_days: float, keep_gb: float) -> list[tuple[Path, str]]:
    """Return the logs to delete, oldest first, each with the reason.

    Both bounds are none if they are 0; `keep_gb` is in 10^9 bytes, for all logs together.
    """
    total, result = sum(log.size for log in logs), []
    for log in sorted(logs, key=lambda log: log.modified_s):
        age_s = now_s - log.modified_s
        if age_s < RECENT_S:
            break
        if keep_days and age_s > keep_days * DAY_S:
            reason = f"older than {keep_days:g} days"
        elif keep_gb and total > keep_gb * 1e9:
            reason = f"the logs have more than {keep_gb:g} GB"
        else:
            continue
        total -= log.size
        result.append((log.path, reason))
    return result
