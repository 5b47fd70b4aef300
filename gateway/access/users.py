"""The users of OPC UA and the web page: names, roles and hashed passwords in users.toml; and tokens of programs.

    [users.ana]
    role = "operator"
    password = "scrypt$16384$8$1$...$..."

    [tokens.matlab]
    user = "ana"
    role = "viewer"
    sha256 = "..."

Rule 1: only the owner may read the file (mode 0600); a file open to others is refused.
Rule 2: a wrong name takes as long as a wrong password and gets the same answer.
Rule 3: a changed file is read at the next use; an invalid one is reported and has no effect.

tries.py limits the rate of password attempts; tokens.py says why tokens need no limit.
"""

from __future__ import annotations

import logging
import threading
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path

from gateway.access.passwords import NOBODY, hash_password, is_line, matches
from gateway.access.private import read_private, write_private
from gateway.access.roles import ROLE_WORDS, Role, parse_role
from gateway.access.tokens import digest_of, is_digest, new_token
from protocol.bus.topics import check_name
from protocol.errors import ConfigError, UsageError
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
class _Token:
    __pydantic_config__ = _KEYS

    user: str
    role: str
    sha256: str


@dataclass(frozen=True, slots=True, kw_only=True)
class _File:
    __pydantic_config__ = _KEYS

    users: dict[str, _Entry] = field(default_factory=dict)
    tokens: dict[str, _Token] = field(default_factory=dict)


class Users:
    """The users of one file.  Thread-safe.

    Raises:
        ConfigError: the file is missing, open to others or not valid; the message names the key.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._lock = threading.Lock()
        self._file = _read(path)
        self._stamp = self._file_stamp()

    def check(self, name: str, password: str) -> User | None:
        """Return the user, or None for a wrong name or password; slow on purpose."""
        entry = self._current().users.get(name)
        right = matches(password, entry.password if entry is not None else NOBODY)  # outside the lock
        return _user(name, entry) if right and entry is not None else None

    def find(self, name: str) -> User | None:
        """Return the user of that name in the current file, or None; sessions notice a change of role by it."""
        entry = self._current().users.get(name)
        return None if entry is None else _user(name, entry)

    def bearer(self, digest: str) -> User | None:
        """Return the user for whom the token of this digest acts, with the lower of both roles; None: no such token."""
        content = self._current()
        token = next((token for token in content.tokens.values() if token.sha256 == digest), None)
        entry = content.users.get(token.user) if token is not None else None
        if token is None or entry is None:
            return None
        return User(name=token.user, role=min(Role[entry.role.upper()], Role[token.role.upper()]))

    def names(self) -> Mapping[str, Role]:
        """Return the role of each user, by name."""
        return {name: _user(name, entry).role for name, entry in self._current().users.items()}

    def _current(self) -> _File:
        with self._lock:
            stamp = self._file_stamp()
            if stamp != self._stamp:
                self._stamp = stamp
                try:
                    self._file = _read(self._path)
                    _logger.info("%s has changed: %d users", self._path, len(self._file.users))
                except ConfigError as error:
                    _logger.error("the users do not change: %s", error)
            return self._file

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
    content = _read(path) if path.exists() else _File()
    content.users[user.name] = _Entry(role=user.role.word, password=hash_password(password))
    _write(path, content)


def remove_user(path: Path, name: str) -> bool:
    """Remove a user with all tokens; returns whether there was one.  Raises ConfigError if the file is not valid."""
    content = _read(path)
    if content.users.pop(name, None) is None:
        return False
    _write(path, _File(users=content.users, tokens={n: t for n, t in content.tokens.items() if t.user != name}))
    return True


def set_token(path: Path, name: str, user: User) -> str:
    """Add a token for a user with this role at most, or replace it; returns it, as nothing else can.

    Raises:
        UsageError: there is no such user, or the user's role is lower.
        ConfigError: the file or the name is not valid.
    """
    check_name(name, what="token")
    content = _read(path)
    entry = content.users.get(user.name)
    if entry is None:
        raise UsageError(f"{user.name} is not a user", remedy=f"There are {', '.join(content.users) or 'none'}")
    if _user(user.name, entry).role < user.role:
        problem = f"{user.name} is {entry.role}, so a token cannot be {user.role.word}"
        raise UsageError(problem, remedy=f"Give --role {entry.role}")
    token = new_token()
    content.tokens[name] = _Token(user=user.name, role=user.role.word, sha256=digest_of(token))
    _write(path, content)
    return token


def remove_token(path: Path, name: str) -> None:
    """Remove a token.

    Raises:
        UsageError: there is none of that name.
        ConfigError: the file is not valid.
    """
    content = _read(path)
    if content.tokens.pop(name, None) is None:
        raise UsageError(f"{name} is not a token", remedy=f"There are {', '.join(content.tokens) or 'none'}")
    _write(path, content)


def _write(path: Path, content: _File) -> None:
    lines = ["# Logins of OPC UA and the web page; `board51 security add-user` and `add-token` write this file.\n"]
    for section, tables in asdict(content).items():
        for name, table in sorted(tables.items()):
            lines += [f"[{section}.{name}]", *(f'{key} = "{value}"' for key, value in table.items()), ""]
    write_private(path, "\n".join(lines).encode())


def _read(path: Path) -> _File:
    from protocol.checked import checked

    data = read_private(path, what="The user file")
    try:
        text = data.decode()
    except UnicodeDecodeError:
        raise ConfigError(f"{path} is not UTF-8 text", remedy="Correct the file") from None
    table = parse_toml(text, where=str(path), remedy="Correct the file")
    content: _File = checked(_File, table, where=str(path), remedy=_REMEDY, quote=lambda value: "...")
    for name, entry in content.users.items():
        check_name(name, what=f"{path}: user")
        parse_role(entry.role, where=f"{path}: user {name}")
        if not is_line(entry.password):
            raise ConfigError(f"{path}: user {name} has no usable password", remedy=_REMEDY)
    for name, token in content.tokens.items():
        check_name(name, what=f"{path}: token")
        check_name(token.user, what=f"{path}: token {name}: user")
        parse_role(token.role, where=f"{path}: token {name}")
        if not is_digest(token.sha256):
            problem = f"{path}: token {name} has no SHA-256"
            raise ConfigError(problem, remedy="Make a new one: board51 security add-token")
    return content
