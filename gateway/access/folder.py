"""The folder that `board51 security init` makes, with the keys, passwords and users of one plant.

    security.toml              site and host names
    ca.pem, ca-key.pem         the authority; keep ca-key.pem elsewhere, it is needed for new users and renewals only
    users.toml                 logins of OPC UA and the web page
    bus/router.pem, -key.pem   of the router (or of the gateway, if that is the router)
    bus/passwords.txt          zenoh's dictionary
    bus/router.json5           for `board51 router --config` or a stock zenohd
    opcua/server.pem, -key.pem
    hmi/server.pem, -key.pem
    identities/NAME/           see protocol/bus/identity.py; one for each user and for gateway, twin and views

Rule: secret files have mode 0600; a file open to others is refused.
"""

from __future__ import annotations

import json
import secrets
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

from gateway.access.bus_rules import LARGEST_MESSAGE, ROUTER, SERVICES, access_control, size_limits
from gateway.access.certificates import DAYS, Authority, Issued, check_certificate, days_left
from gateway.access.private import check_private, read_private, write_private
from gateway.access.roles import Role
from gateway.access.users import User, Users, remove_user, set_user
from protocol.bus.endpoint import zenoh_config
from protocol.bus.identity import AUTHORITY, CERTIFICATE, KEY, SETTINGS, Identity, load_identity
from protocol.bus.topics import DEFAULT_SITE, check_name
from protocol.errors import ConfigError, UsageError
from protocol.files import make_folder, parse_toml, read_small, writing

OPCUA_URI = "urn:board51:opcua"  # the server's application URI, which its certificate must carry
ALWAYS_HOSTS = ("localhost", "127.0.0.1", "::1")
_SERVERS = {"bus/router": (), "opcua/server": (OPCUA_URI,), "hmi/server": ()}


@dataclass(frozen=True, slots=True)
class _Settings:
    site: str
    hosts: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class SecurityFolder:
    """The security folder: paths, creation, changes and checks."""

    path: Path

    @property
    def users(self) -> Path:
        """See users.py."""
        return self.path / "users.toml"

    @property
    def ca(self) -> Path:
        """The authority's certificate."""
        return self.path / "ca.pem"

    @property
    def passwords(self) -> Path:
        """The names and passwords of the bus, in zenoh's format."""
        return self.path / "bus" / "passwords.txt"

    @property
    def router_config(self) -> Path:
        """Configuration of a separate router."""
        return self.path / "bus" / "router.json5"

    def server(self, which: str) -> tuple[Path, Path]:
        """(certificate, key) of "bus", "opcua" or "hmi"."""
        stem = next(s for s in _SERVERS if s.startswith(f"{which}/"))
        return self.path / f"{stem}.pem", self.path / f"{stem}-key.pem"

    def identity_path(self, name: str) -> Path:
        """Folder of the identity of a user or service."""
        return self.path / "identities" / name

    def identity(self, name: str) -> Identity:
        """The identity of a user or service.  Raises ConfigError if it is not valid."""
        return load_identity(self.identity_path(name))

    # -- making

    def init(self, *, site: str = DEFAULT_SITE, hosts: Sequence[str] = ()) -> None:
        """Make the authority, the servers' certificates for further hosts, and the services' identities.

        Raises:
            UsageError: the folder is not empty or cannot be written.
            ConfigError: the site is not a valid name.
        """
        check_name(site, what="--site")
        now = datetime.now(UTC)
        make_folder(self.path, mode=0o700)
        with writing(self.path):
            if any(self.path.iterdir()):
                raise UsageError(
                    f"{self.path} is not empty",
                    remedy="Give a new folder; `board51 security renew` keeps passwords and people of an old one",
                )
            self.path.chmod(0o700)
        _, made = Authority.create(f"Board51 authority of {site}", now=now)
        self._write(self.ca, made)
        listed = ", ".join(json.dumps(host) for host in dict.fromkeys((*ALWAYS_HOSTS, *hosts)))
        (self.path / "security.toml").write_text(f'site = "{site}"\nhosts = [{listed}]\n', encoding="utf-8")
        write_private(self.users, b"# No users yet: `board51 security add-user`\n")
        self.renew(now=now)

    def renew(self, *, now: datetime | None = None, days: float = DAYS) -> None:
        """Issue new certificates for all servers, services and users; names, roles and passwords stay the same."""
        now = datetime.now(UTC) if now is None else now
        authority, hosts = self._authority(), self._settings().hosts
        for stem, uris in _SERVERS.items():
            issued = authority.issue(stem.replace("/", "-"), now=now, hosts=hosts, uris=uris, days=days)
            self._write(self.path / f"{stem}.pem", issued)
        for service in SERVICES:
            self._write_identity(authority, service, service, now, days)
        for name, role in self.people().items():
            self._write_identity(authority, name, role.word, now, days)
        self._write_bus()

    def add_user(self, user: User, password: str) -> Path:
        """Add a user, or change role and password; returns the folder of the identity.

        Raises:
            UsageError: the name is reserved, or the password is too short or too long.
        """
        reserved = (*SERVICES, ROUTER)
        if user.name in reserved:
            problem = f"{user.name} is the name of a service"
            raise UsageError(problem, remedy=f"Choose another than {', '.join(reserved)}")
        authority = self._authority()
        set_user(self.users, user, password)
        self._write_identity(authority, user.name, user.role.word, datetime.now(UTC), DAYS)
        self._write_bus()
        return self.identity_path(user.name)

    def remove_user(self, name: str) -> None:
        """Remove a user's login and identity.  Raises UsageError if there is no such user."""
        if not remove_user(self.users, name):
            raise UsageError(f"{name} is not a user", remedy=f"There are {', '.join(self.people()) or 'none'}")
        for file in self.identity_path(name).glob("*"):
            file.unlink()
        if self.identity_path(name).exists():
            self.identity_path(name).rmdir()
        self._write_bus()

    # -- reading

    def people(self) -> Mapping[str, Role]:
        """The role of each user, by name."""
        return Users(self.users).names()

    @property
    def site(self) -> str:
        """First chunk of the keys."""
        return self._settings().site

    def check(self, *, now: datetime | None = None) -> dict[str, float]:
        """Check the folder; returns the days for which each certificate is still valid.

        Raises:
            ConfigError: the first problem: a missing or invalid file, a file open to others, an expired certificate.
        """
        now = datetime.now(UTC) if now is None else now
        self._settings()
        people = self.people()
        check_private(self.passwords, what="The password file of the bus")
        valid = {"ca": check_certificate(self.ca, what="The authority's certificate", now=now)}
        for stem in _SERVERS:
            valid[stem] = check_certificate(self.path / f"{stem}.pem", what="The certificate", now=now)
            check_private(self.path / f"{stem}-key.pem", what="The key")
        for name in (*SERVICES, *people):
            identity = self.identity(name)
            certificate = check_certificate(identity.folder / CERTIFICATE, what="The certificate", now=now)
            valid[f"identities/{name}"] = certificate
            if name in people and identity.role != people[name].word:
                problem = f"{name} is {people[name].word} in users.toml and {identity.role} on the bus"
                raise ConfigError(problem, remedy="Run `board51 security renew` and restart the router")
        if (self.path / "ca-key.pem").exists():
            check_private(self.path / "ca-key.pem", what="The authority's key")
        return {name: days_left(certificate, now) for name, certificate in valid.items()}

    def router(self, listen: Sequence[str], connect: Sequence[str] = (), *, wait_for_router: bool = True) -> str:
        """Configuration of a router for the accounts of this folder alone, for `zenoh.Config.from_json5`."""
        certificate, key = self.server("bus")
        gateway = self.identity("gateway")
        config = json.loads(
            zenoh_config("router", listen=listen, connect=connect, wait_for_router=wait_for_router, identity=gateway)
        )
        transport = config["transport"]
        transport["auth"]["usrpwd"]["dictionary_file"] = str(self.passwords.absolute())
        transport["link"]["tls"] |= {
            "listen_certificate": str(certificate.absolute()),
            "listen_private_key": str(key.absolute()),
            "close_link_on_expiration": True,
        }
        transport["link"]["rx"] = {"max_message_size": LARGEST_MESSAGE}
        config["access_control"] = access_control(self.site, self.people(), upper=bool(connect))
        config["low_pass_filter"] = size_limits(self.site)
        return json.dumps(config, indent=2)

    def _settings(self) -> _Settings:
        from protocol.checked import checked

        path = self.path / "security.toml"
        text = read_small(path, remedy="Make the folder with `board51 security init DIR`", error=ConfigError)
        settings: _Settings = checked(_Settings, parse_toml(text, where=str(path)), where=str(path))
        return settings

    def _authority(self) -> Authority:
        key = read_private(self.path / "ca-key.pem", what="The authority's key")
        try:
            return Authority.load(self.ca.read_bytes(), key)
        except (OSError, ValueError) as error:
            problem = f"The authority in {self.path} is not usable: {error}"
            raise ConfigError(problem, remedy="Put ca.pem and ca-key.pem back") from None

    def _write(self, certificate: Path, issued: Issued) -> None:
        make_folder(certificate.parent, mode=0o700)
        write_private(certificate.with_name(f"{certificate.stem}-key.pem"), issued.key)
        with writing(certificate):
            certificate.write_bytes(issued.certificate)

    def _write_identity(self, authority: Authority, name: str, role: str, now: datetime, days: float) -> None:
        folder = self.identity_path(name)
        make_folder(folder, mode=0o700)
        password = self._bus_passwords().get(name) or secrets.token_hex(32)
        issued = authority.issue(name, now=now, uris=(f"urn:board51:user:{name}",), days=days)
        lines = [
            f'name = "{name}"',
            f'role = "{role}"',
            f'site = "{self.site}"',
            f'password = "{password}"',
            f"valid_until = {issued.valid_until:%Y-%m-%dT%H:%M:%SZ}",
        ]
        write_private(folder / SETTINGS, ("\n".join(lines) + "\n").encode())
        write_private(folder / KEY, issued.key)
        with writing(folder):
            (folder / CERTIFICATE).write_bytes(issued.certificate)
            (folder / AUTHORITY).write_bytes(self.ca.read_bytes())

    def _bus_passwords(self) -> dict[str, str]:
        if not self.passwords.exists():
            return {}
        text = read_private(self.passwords, what="The password file of the bus").decode()
        return dict(line.split(":", 1) for line in text.splitlines() if ":" in line)

    def _write_bus(self) -> None:
        names = (*SERVICES, *self.people())
        lines = [f"{name}:{self.identity(name).password}\n" for name in names]
        write_private(self.passwords, "".join(lines).encode())
        write_private(self.router_config, self.router(["tls/0.0.0.0:7447"]).encode())
