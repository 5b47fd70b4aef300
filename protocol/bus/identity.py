"""Identity of a process on a guarded bus: a folder with its name, role, password and certificate.

`board51 security init` makes one folder for each person and service, `identities/NAME/`:

    identity.toml     name, role, site, password of the bus, valid_until; mode 0600
    certificate.pem   signed by the plant's authority, key.pem (mode 0600) beside it
    ca.pem            certificate of the authority, which verifies the router

The folder may be copied to the machine that needs it.  `--identity FOLDER` names it, or BOARD51_IDENTITY.
"""

from __future__ import annotations

import getpass
import os
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

from protocol.errors import ConfigError
from protocol.files import OTHERS, open_regular, parse_toml, read_small

VARIABLE = "BOARD51_IDENTITY"
HELP = f"identity on a guarded bus: DIR/identities/NAME of `board51 security init` (default ${VARIABLE})"  # --identity
SETTINGS, CERTIFICATE, KEY, AUTHORITY = FILES = ("identity.toml", "certificate.pem", "key.pem", "ca.pem")
_PRIVATE = (SETTINGS, KEY)
_REMEDY = "Give a folder that `board51 security init` made: DIR/identities/NAME"


@dataclass(frozen=True, slots=True, kw_only=True)
class Identity:
    """The credentials for a guarded bus, and the name and role under which commands are sent."""

    name: str
    role: str  # viewer | operator | engineer, or the name of a service
    password: str
    folder: Path
    valid_until: datetime

    def __repr__(self) -> str:
        return f"Identity({self.name}, {self.role})"  # no password in a traceback

    def check_valid(self, now: datetime) -> None:
        """Raise ConfigError if the certificate has expired; zenoh itself would only time out."""
        if now >= self.valid_until:
            raise ConfigError(
                f"The identity {self.folder} expired on {self.valid_until:%Y-%m-%d}",
                remedy="Renew it with `board51 security renew DIR`, and copy the folder again",
            )


def login_name(otherwise: str = "unknown") -> str:
    """Return the name of the user who runs this process; the user of a container may have none."""
    try:
        return getpass.getuser()
    except (KeyError, OSError, ImportError):  # ImportError: on Windows without a name in the environment
        return otherwise


def find_identity(folder: Path | str | None, environment: Mapping[str, str] = os.environ) -> Identity | None:
    """Return the identity in `folder`, else in BOARD51_IDENTITY, else None for an unguarded bus.

    Raises:
        ConfigError: the folder is not an identity, or other users can read it.
    """
    named = folder or environment.get(VARIABLE)
    return load_identity(Path(named)) if named else None


def load_identity(folder: Path) -> Identity:
    """Read the identity in a folder.

    Raises:
        ConfigError: a file is missing, readable by other users, or malformed.
    """
    folder = folder.absolute()
    for name in FILES:
        with open_regular(folder / name, remedy=_REMEDY, error=ConfigError) as file:
            # Of the open file, not of its name, which may lead to another file by now.
            mode = os.fstat(file.fileno()).st_mode
        if name in _PRIVATE and mode & OTHERS:
            raise ConfigError(
                f"{folder / name} is open to others (mode {mode & 0o777:04o})", remedy=f"chmod 600 {folder / name}"
            )
    where = str(folder / SETTINGS)
    text = read_small(folder / SETTINGS, remedy=_REMEDY, error=ConfigError)
    table = parse_toml(text, where=where, remedy=_REMEDY)
    try:
        name, role, password = (str(table[key]) for key in ("name", "role", "password"))
        valid_until = table["valid_until"]
        if not isinstance(valid_until, datetime) or valid_until.tzinfo is None:
            raise KeyError("valid_until")
    except KeyError as error:
        raise ConfigError(f"{where} has no {error.args[0]}", remedy=_REMEDY) from None
    return Identity(name=name, role=role, password=password, folder=folder, valid_until=valid_until)
