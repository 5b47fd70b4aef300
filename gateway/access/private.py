"""Files that only their owner may read: keys, passwords.  One rule for writing them and one for refusing others."""

from __future__ import annotations

import os
import stat
import sys
from pathlib import Path

from protocol.errors import ConfigError
from protocol.files import open_regular, writing

_REMEDY = "Give the folder that `board51 security init` made, as its owner"


def write_private(path: Path, data: bytes) -> None:
    """Write `data` with mode 0600, all of it or nothing; never for a moment readable by others.

    Raises:
        UsageError: it cannot be written there.
    """
    fresh = path.with_name(f".{path.name}.new")
    with writing(path):
        fresh.unlink(missing_ok=True)
        descriptor = os.open(fresh, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
        with os.fdopen(descriptor, "wb") as file:
            file.write(data)
        fresh.replace(path)


def read_private(path: Path, *, what: str) -> bytes:
    """What is in a file that nobody else may read.

    Args:
        path: of the file.
        what: it is, for the error.

    Raises:
        ConfigError: it is absent, or others may read or change it.
    """
    check_private(path, what=what)
    with open_regular(path, remedy=_REMEDY, what=f"{what} ", error=ConfigError) as file:
        return file.read()


def check_private(path: Path, *, what: str) -> None:
    """Refuse a file that is absent or open to others.

    Raises:
        ConfigError: see above.
    """
    try:
        mode = stat.S_IMODE(path.stat().st_mode)
    except OSError as error:
        raise ConfigError(f"{what} {path} cannot be read: {error.strerror}", remedy=_REMEDY) from None
    if mode & 0o077:
        raise ConfigError(f"{what} {path} is open to others (mode {mode:04o})", remedy=f"chmod 600 {path}")


def open_output() -> str:
    """The mode of standard output where it is a file that others may read (`> FILE` makes such a one), else ""."""
    try:
        mode = os.fstat(sys.stdout.fileno()).st_mode
    except (OSError, ValueError):  # there is no standard output, or it is no file of the system
        return ""
    return f"{stat.S_IMODE(mode):04o}" if stat.S_ISREG(mode) and mode & 0o077 else ""
