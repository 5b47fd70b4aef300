"""Opens and parses untrusted files within fixed bounds.

Rule 1: only regular files are opened.  A pipe may block for ever, a device may never end or react to being opened.
Rule 2: a small file (configuration, campaign, model) has at most LARGEST_SMALL bytes and DEEPEST levels of tables.
Rule 3: every error of a parser becomes one line that names the file.  The content of the file is not quoted.
Rule 4: a file without a size is empty.  What the kernel shows under such a name (/proc) may block, fail or never end.
"""

from __future__ import annotations

import errno
import json
import os
import re
import stat
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, BinaryIO

from protocol.errors import ConfigError, DataError, UsageError

LARGEST_SMALL = 4_000_000  # bytes; the largest model that the bus carries
DEEPEST = 50
_INTEGER = 1 << 63  # TOML's integers have 64 bits
_PART = r"""(?:[\w-]++|"[^"\n]*+"|'[^'\n]*+')"""
_DOTTED = re.compile(rf"(?<![\w-])(?:{_PART}[ \t]*+\.[ \t]*+){{{DEEPEST}}}")  # a key of more than DEEPEST parts
_KINDS = (
    (stat.S_ISDIR, "it is a folder"),
    (stat.S_ISFIFO, "it is a pipe"),
    (stat.S_ISCHR, "it is a device"),
    (stat.S_ISBLK, "it is a device"),
    (stat.S_ISSOCK, "it is a socket"),
)
OTHERS = 0o077 if os.name == "posix" else 0  # bits of a mode: open to others; Windows keeps lists of access instead
Refusal = type[ConfigError] | type[DataError]


def open_regular(path: Path, *, remedy: str, what: str = "", error: Refusal = DataError) -> BinaryIO:
    """Open a regular file to read bytes; never blocks.

    An error says `what` kind of file it is ("Log ") and ends with `remedy`.

    Raises:
        DataError, ConfigError: the file is absent, not readable, or not a regular file.
    """
    try:
        problem = _not_regular(path.stat().st_mode)
        if not problem:
            # Not blocking: a pipe that took the place of the file since would wait for a writer.
            descriptor = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0))
            file = os.fdopen(descriptor, "rb")
            status = os.fstat(descriptor)
            problem = _not_regular(status.st_mode)  # it may have been replaced since the first check
            if not problem and status.st_size:
                return file
            file.close()
            if not problem:
                return open(os.devnull, "rb")
    except (OSError, ValueError) as failed:  # ValueError: a NUL in the name
        problem = getattr(failed, "strerror", None) or "this is not a valid file name"
    else:
        if "folder" not in problem:
            remedy = "Save its content to a regular file, and name that file"
    raise error(f"{what}{path} cannot be read: {problem}", remedy=remedy)


def read_small(path: Path, *, remedy: str, what: str = "", error: Refusal = DataError) -> str:
    """Return the text of a small file.

    Arguments and errors are those of `open_regular`; a file that is too large or not UTF-8 is an error, too.
    """
    with open_regular(path, remedy=remedy, what=what, error=error) as file:
        # One byte beyond the bound, whatever size was stated: the file may grow while it is read.
        data = file.read(LARGEST_SMALL + 1)
    if len(data) > LARGEST_SMALL:
        raise error(f"{what}{path} has more than {LARGEST_SMALL} bytes", remedy=remedy)
    try:
        return data.decode("utf-8")
    except UnicodeDecodeError:
        raise error(f"{what}{path} is not UTF-8 text", remedy=remedy) from None


@contextmanager
def writing(path: Path) -> Iterator[None]:
    """A context manager around code that creates the file or folder `path`.

    Raises:
        UsageError: the operating system refused to create it.
    """
    try:
        yield
    except OSError as failed:
        remedy = "Give a path in a folder that exists and that you may write to"
        if failed.errno in (errno.ENOSPC, errno.EDQUOT):
            remedy = "Free space there, or give a path on another file system"
        raise UsageError(f"{path} cannot be written: {failed.strerror or failed}", remedy=remedy) from None


def replace_text(path: Path, text: str) -> None:
    """Write a text file so that it is the old one or the new one at any time; raises OSError."""
    part = path.with_name(f".{path.name}.part")
    with part.open("w", encoding="utf-8") as file:
        file.write(text)
        # On the disk before the name changes: after a power cut the name must not lead to an empty file.
        file.flush()
        os.fsync(file.fileno())
    part.replace(path)


def make_folder(path: Path, *, mode: int = 0o777) -> None:
    """Create the folder `path` and its parents if absent; raise UsageError if that is impossible."""
    with writing(path):
        path.mkdir(mode=mode, parents=True, exist_ok=True)


def parse_toml(text: str, *, where: str, remedy: str = "Correct that line") -> dict[str, Any]:
    """Parse TOML into a table; `where` names the source in the ConfigError."""
    import tomllib  # not by a command that reads no file: a STOP shall not wait for it

    try:
        if _DOTTED.search(text):
            raise RecursionError  # before parsing: the parser's memory grows with the square of the number of parts
        table = tomllib.loads(text)
        _check_depth(table)
    except tomllib.TOMLDecodeError as wrong:
        raise ConfigError(f"{where} is not TOML: {wrong}", remedy=remedy) from None
    except (RecursionError, ValueError) as wrong:
        raise ConfigError(f"{where} is not usable TOML: {_excess(wrong)}", remedy="Correct the file") from None
    return table


def parse_json(text: str, *, where: str, remedy: str = "Correct that line") -> Any:
    """Parse JSON; `where` names the source in the DataError.  An integer of 19 or more digits becomes a float."""
    try:
        value = json.loads(text, parse_int=lambda digits: int(digits) if len(digits) < 19 else float(digits))
        _check_depth(value)
    except json.JSONDecodeError as wrong:
        raise DataError(f"{where}, line {wrong.lineno}: not JSON ({wrong.msg})", remedy=remedy) from None
    except (RecursionError, ValueError) as wrong:
        raise DataError(f"{where} is not usable JSON: {_excess(wrong)}", remedy="Correct the file") from None
    return value


def _not_regular(mode: int) -> str:
    return next((problem for is_kind, problem in _KINDS if is_kind(mode)), "")


def _excess(wrong: Exception) -> str:
    if isinstance(wrong, RecursionError):
        return "it is nested too deeply"
    return "an integer has more than 64 bits" if "digits" in str(wrong) else str(wrong)


def _check_depth(value: object) -> None:
    """Check depth and integers level by level: dotted keys of TOML nest without recursion in the parser."""
    level: list[object] = [value]
    for _ in range(DEEPEST):
        inner: list[object] = []
        for container in level:
            items: Iterable[object] = (
                container.values() if isinstance(container, dict) else container if isinstance(container, list) else ()
            )
            inner += items
            if isinstance(container, int) and not -_INTEGER <= container < _INTEGER:
                raise ValueError("an integer has more than 64 bits")
        if not inner:
            return
        level = inner
    raise RecursionError
