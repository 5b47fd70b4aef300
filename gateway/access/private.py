"""Private files (keys, passwords): write them with mode 0600, and refuse files that are open to others."""

from __future__ import annotations

import os
import stat
import sys
from pathlib import Path

from protocol.errors import ConfigError
from protocol.files import OTHERS, open_regular, writing

_REMEDY = "Give the folder that `board51 security init` made, as its owner"


def write_private(path: Path, data: bytes) -> None:
    """Write `data` atomically with mode 0600; it is never readable by others.

    Raises:
        UsageError: the file cannot be written.
    """
    fresh = path.with_name(f".{path.name}.new")
    with writing(path):
        fresh.unlink(missing_ok=True)
        descriptor = os.open(fresh, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
        with os.fdopen(descriptor, "wb") as file:
            file.write(data)
        fresh.replace(path)


def read_private(path: Path, *, what: str) -> bytes:
    """Read a private file; `what` describes it in errors.

    Raises:
        ConfigError: the file is missing or open to others.
    """
    check_private(path, what=what)
    with open_regular(path, remedy=_REMEDY, what=f"{what} ", error=ConfigError) as file:
        return file.read()


def check_private(path: Path, *, what: str) -> None:
    """Check that a file exists and is private.

    Raises:
        ConfigError: the file is missing or open to others.
    """
    try:
        mode = stat.S_IMODE(path.stat().st_mode)
    except OSError as error:
        raise ConfigError(f"{what} {path} cannot be read: {error.strerror}", remedy=_REMEDY) from None
    if mode & OTHERS:
        raise ConfigError(f"{what} {path} is open to others (mode {mode:04o})", remedy=f"chmod 600 {path}")


def open_output() -> str:
    """The mode of standard output if it is a file that others may read (as with `> FILE`), otherwise ""."""
    try:
        mode = os.fstat(sys.stdout.fileno()).st_mode
    except (OSError, ValueError):  # there is no standard output, or it has no file descriptor
        return ""
    return f"{stat.S_IMODE(mode):04o}" if stat.S_ISREG(mode) and mode & OTHERS else ""
