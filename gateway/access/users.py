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
import threading
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from gateway.access.passwords import NOBODY, hash_password, is_line, matches
from gateway.access.private import read_private, write_private
from gateway.access.roles import ROLE_WORDS, Role, parse_role
from protocol.bus.topics import check_name
from protocol.errors import ConfigError
from protocol.files import parse_toml

_logger = logging.getLogger("gateway.access")
_KEYS = {"extra": "forbid"}  # `checked.KEYS`, without waiting for pydantic
_REMEDY = (
    f"Write each user as [users.NAME] with role = {' | '.join(ROLE_WORDS)}, and set the password with"
    " `board51 security add-user DIR NAME:ROLE`"
)


@dataclass(frozen=True, slots=True, kw_only=True)
class User:
    """An authenticated user: by password, or by an identity that the bus has checked."""

    name: str
    role: Role


@dataclass(frozen=True, slots=True, kw_only=True)
class _Entry:
    __pydantic_config__ = _KEYS

    role: str
    password: str


@dataclass(frozen=True, slots=True, kw_only=True)
class _File:
    __pydantic_config__ = _KEYS

    users: dict[str, _Entry] = field(default_factory=dict)


class Users:
    """The users of one file.  Thread-safe.

    Raises:
        ConfigError: the file is missing, open to others or not valid; the message names the key.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._lock = threading.Lock()
        self._entries = _read(path)
        self._stamp = self._file_stamp()

    def check(self, name: str, password: str) -> User | None:
        """Return the user, or None for a wrong name or password; slow on purpose."""
        entry = self._current().get(name)
        right = matches(password, entry.password if entry is not None else NOBODY)  # outside the lock
        return _user(name, entry) if right and entry is not None else None

    def find(self, name: str) -> User | None:
        """Return the user of that name in the current file, or None; sessions notice a change of role by it."""
        entry = self._current().get(name)
        return None if entry is None else _user(name, entry)

    def names(self) -> Mapping[str, Role]:
        """Return the role of each user, by name."""
        return {name: _user(name, entry).role for name, entry in self._current().items()}

    def _current(self) -> dict[str, _Entry]:
        with self._lock:
            stamp = self._file_stamp()
            if stamp != self._stamp:
                self._stamp = stamp
                try:
                    self._entries = _read(self._path)
                    _logger.info("%s has changed: %d users", self._path, len(self._entries))
                except ConfigError as error:
                    _logger.error("the users do not change: %s", error)
            return self._entries

    def _file_stamp(self) -> tuple[int, int, int] | None:
        try:
            status = self._path.stat()
        except OSError:
            return None
        return status.st_mtime_ns, status.st_size, status.st_ino


def _user(name: str, entry: _Entry) -> User:
    return User(name=name, role=Role[entry.role.upper()])


def set_user(path: Path, user: User, password: str) -> None:
    """Add a user, or give an existing one a new role and password.

    Raises:
        UsageError: the password is too short or too long.
        ConfigError: the file or the name is not valid.
    """
    check_name(user.name, what="user")
    entries = _read(path) if path.exists() else {}
    entries[user.name] = _Entry(role=user.role.word, password=hash_password(password))
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
        f'[users.{name}]\nrole = "{entry.role}"\npassword = "{entry.password}"\n'
        for name, entry in sorted(entries.items())
    ]
    write_private(path, "\n".join(lines).encode())


def _read(path: Path) -> dict[str, _Entry]:
    from protocol.checked import checked

    data = read_private(path, what="The user file")
    try:
        text = data.decode()
    except UnicodeDecodeError:
        raise ConfigError(f"{path} is not UTF-8 text", remedy="Correct the file") from None
    table = parse_toml(text, where=str(path), remedy="Correct the file")
    entries: dict[str, _Entry] = checked(_File, table, where=str(path), remedy=_REMEDY, quote=lambda value: "...").users
    for name, entry in entries.items():
        check_name(name, what=f"{path}: user")
        parse_role(entry.role, where=f"{path}: user {name}")
        if not is_line(entry.password):
            raise ConfigError(f"{path}: user {name} has no usable password", remedy=_REMEDY)
    return entries
