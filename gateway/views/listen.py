"""Common parts of the views' commands: HOST:PORT, the check whether it may be opened, and who they are on the bus."""

from __future__ import annotations

import argparse
import logging
from pathlib import Path

from gateway.access.listeners import check_listener
from gateway.client.connection import add_bus_arguments
from protocol.bus.identity import Identity, find_identity
from protocol.bus.topics import check_name
from protocol.errors import ConfigError

ADDRESSES = {"opcua": "127.0.0.1:4840", "hmi": "127.0.0.1:8051", "foxglove": "127.0.0.1:8765"}  # defaults
ACCOUNT = "views"  # of a guarded bus: it may send commands for users whom a view has authenticated
SECURITY = "folder made by `board51 security init`: "


def add_view_arguments(parser: argparse.ArgumentParser, view: str, *, security: str = "", insecure: str) -> None:
    """The bus, `--listen`, `--insecure`, and `--security` where `security` says what it gives."""
    add_bus_arguments(parser)
    parser.add_argument(
        "--listen", default=ADDRESSES[view], metavar="HOST:PORT", help="address to listen on (default %(default)s)"
    )
    parser.add_argument("--insecure", action="store_true", help=insecure)
    if security:
        parser.add_argument("--security", type=Path, metavar="DIR", help=SECURITY + security)


def listener(args: argparse.Namespace, what: str, *, remedy: str) -> tuple[str, int]:
    """(host, port) of `--listen`, where it may be opened; the log of the process goes to stderr from here on.

    Args:
        args: of `add_view_arguments`.
        what: is to be opened, for the message.
        remedy: instead of opening it to the network without protection.

    Raises:
        ConfigError: site or address is invalid, or the address would be open to the network without protection.
    """
    check_name(args.site, what="--site")
    host, port = address(args.listen)
    protected, what = getattr(args, "security", None) is not None, f"{what} at {args.listen}"
    check_listener(host, protected=protected, insecure=args.insecure, what=what, remedy=remedy)
    logging.basicConfig(level=logging.INFO, format="%(asctime)s %(levelname)-7s %(message)s")
    return host, port


def address(text: str, *, where: str = "--listen") -> tuple[str, int]:
    """(host, port) of `127.0.0.1:4840` or `[::1]:4840`.

    Raises:
        ConfigError: the text is not an address.
    """
    host, colon, port = text.rpartition(":")
    good = bool(colon and host) and port.isascii() and port.isdigit() and int(port) <= 65535
    if not good or (":" in host and not host.startswith("[")):
        raise ConfigError(f"{where} {text!r} is not an address", remedy="Write HOST:PORT, e.g. 127.0.0.1:4840")
    return host.strip("[]"), int(port)


def views_identity(folder: str | None) -> Identity | None:
    """Return the identity in `folder` or BOARD51_IDENTITY; None on an unguarded bus.

    Raises:
        ConfigError: the identity is not usable, or belongs to a person.
    """
    identity = find_identity(folder)
    if identity is not None and identity.role != ACCOUNT:
        problem = f"The identity {identity.name} cannot send commands for others"
        raise ConfigError(problem, remedy=f"Give --identity DIR/identities/{ACCOUNT}")
    return identity
