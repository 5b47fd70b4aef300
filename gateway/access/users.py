"""The users of OPC UA and the web page: names, roles and hashed passwords in users.toml.

    [users.ana]
    role = "operator"
    password = "scrypt$16384$8$1$...$..."

Rule 1: only the owner may read the file (mode 0600); a file open to others is refused.
Rule 2: a wrong name takes as long as a wrong password and gets the same answer.
Rule 3: a changed file is read at the next use; an invalid one is reported and has no effect.

tries.py limits the rate of password attempts.
"""

from __future__ import annotations

import logging
import re
import threading
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from gateway.access.passwords import NOBODY, hash_password, is_line, matches
from gateway.access.private import read_private, write_private
from gateway.access.roles import ROLE_WORDS, Role, parse_role
from protocol.bus.topics import check_name
from protocol.errors import ConfigError
from protocol.files import parse_toml

_logger = logging.getLogger("gateway.access")


@dataclass(frozen=True, slots=True, kw_only=True)
class User:
    """An authenticated user: by password, or by an identity that the bus has checked."""

    name: str
    role: Role


@dataclass(frozen=True, slots=True, kw_only=True)
class _Entry:
    role: Role
    password: str


class Users:
    """The users of one file.  Thread-safe."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._lock = threading.Lock()
        self._entries = _read(path)
        self._stamp = self._file_stamp()

    @classmethod
    def load(cls, path: Path) -> Users:
        """Read the file.

        Raises:
            ConfigError: the file is missing, open to others or not valid; the message names the line.
        """
        return cls(path)

    def check(self, name: str, password: str) -> User | None:
        """The user, or None for a wrong name or password; slow on purpose."""
        with self._lock:
            self._refresh()
            entry = self._entries.get(name)
        right = matches(password, entry.password if entry is not None else NOBODY)  # outside the lock
        return User(name=name, role=entry.role) if right and entry is not None else None

    def find(self, name: str) -> User | None:
        """The user of that name in the current file, or None; sessions use it to notice a change of role."""
        with self._lock:
            self._refresh()
            entry = self._entries.get(name)
        return None if entry is None else User(name=name, role=entry.role)

    def names(self) -> Mapping[str, Role]:
        """The role of each user, by name."""
        with self._lock:
            self._refresh()
            return {name: entry.role for name, entry in self._entries.items()}

    def _refresh(self) -> None:
        stamp = self._file_stamp()
        if stamp == self._stamp:
            return
        self._stamp = stamp
        try:
            self._entries = _read(self._path)
        except ConfigError as error:
            _logger.error("the users stay as they were: %s", error)
        else:
            _logger.info("%s has changed: %d users", self._path, len(self._entries))

    def _file_stamp(self) -> tuple[int, int, int] | None:
        try:
            status = self._path.stat()
        except OSError:
            return None
        return status.st_mtime_ns, status.st_size, status.st_ino


def set_user(path: Path, user: User, password: str) -> None:
    """Add a user, or give an existing one a new role and password.

    Raises:
        UsageError: the password is too short or too long.
        ConfigError: the file or the name is not valid.
    """
    check_name(user.name, what="user")
    entries = _read(path) if path.exists() else {}
    entries[user.name] = _Entry(role=user.role, password=hash_password(password))
    _write(path, entries)


def remove_user(path: Path, name: str) -> bool:
    """Remove a user; returns whether there was one.  Raises ConfigError if the file is not valid."""
    entries = _read(path)
    if entries.pop(name, None) is None:
        return False
    _write(path, entries)
    return True


def _write(path: Path, entries: Mapping[str, _Entry]) -> None:
    lines = ["# Logins of OPC UA and the web page; `board51 security add-user` writes this file.\n"]
    lines += [
        f'[users.{name}]\nrole = "{entry.role.word}"\npassword = "{entry.password}"\n'
        for name, entry in sorted(entries.items())
    ]
    write_private(path, "\n".join(lines).encode())


def _read(path: Path) -> dict[str, _Entry]:
    data = read_private(path, what="The user file")
    try:
        text = data.decode()
    except UnicodeDecodeError:
        raise ConfigError(f"{path} is not UTF-8 text", remedy="Correct the file") from None
    table = parse_toml(text, where=str(path), remedy="Correct the file")
    unknown = next((key for key in table if key != "users"), None)
    if unknown is not None:
        raise ConfigError(
            f"{path} line {_line(text, unknown)}: unknown key {unknown!r}", remedy="Write each user as [users.NAME]"
        )
    users = table.get("users", {})
    if not isinstance(users, dict):
        raise ConfigError(f"{path}: users is not a table", remedy="Write each user as [users.NAME]")
    return {name: _entry(path, text, name, fields) for name, fields in users.items()}


def _entry(path: Path, text: str, name: str, fields: object) -> _Entry:
    where = f"{path} line {_line(text, name)}: user {name}"
    check_name(name, what=f"{path} line {_line(text, name)}: user")
    if not isinstance(fields, dict):
        raise ConfigError(f"{where} is not a table", remedy=f"Write it as [users.{name}]")
    for key in fields:
        if key not in ("role", "password"):
            raise ConfigError(
                f"{path} line {_line(text, name, key)}: user {name}: unknown key {key!r}",
                remedy="Known: role, password",
            )
    role, password = fields.get("role"), fields.get("password")
    if not isinstance(role, str):
        raise ConfigError(f"{where} has no role", remedy=f'Write role = "..." with one of {", ".join(ROLE_WORDS)}')
    if not isinstance(password, str) or not is_line(password):
        raise ConfigError(
            f"{where} has no usable password", remedy="Set one with `board51 security add-user DIR NAME:ROLE`"
        )
    return _Entry(
        role=parse_role(role, where=f"{path} line {_line(text, name, 'role')}: user {name}"), password=password
    )


def _line(text: str, name: str, key: str = "") -> int:
    """The line number of `[users.name]`, or of a key in it, which the TOML parser does not give."""
    lines = text.splitlines()
    header = re.compile(rf"""\[\s*(users\s*\.\s*)?["']?{re.escape(name)}["']?\s*\]|{re.escape(name)}\s*=""")
    start = next((n for n, line in enumerate(lines) if header.match(line.strip())), 0)
    if key:
        for n in range(start + 1, len(lines)):
            if re.match(rf"{re.escape(key)}\s*=", lines[n].strip()):
                return n + 1
            if lines[n].lstrip().startswith("["):
                break
    return start + 1
