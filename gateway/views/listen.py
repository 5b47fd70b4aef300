"""HOST:PORT on the command line of a view."""

from __future__ import annotations

import argparse

from protocol.errors import ConfigError


def add_listen_argument(parser: argparse.ArgumentParser, default: str) -> None:
    """`--listen HOST:PORT`."""
    parser.add_argument("--listen", default=default, metavar="HOST:PORT", help=f"where (default {default})")


def address(text: str, *, where: str = "--listen") -> tuple[str, int]:
    """(host, port) of `127.0.0.1:4840` or `[::1]:4840`.

    Raises:
        ConfigError: it is no address.
    """
    host, colon, port = text.rpartition(":")
    good = bool(colon and host) and port.isascii() and port.isdigit() and int(port) <= 65535
    if not good or (":" in host and not host.startswith("[")):
        raise ConfigError(f"{where} {text!r} is not an address", remedy="Write HOST:PORT, e.g. 127.0.0.1:4840")
    return host.strip("[]"), int(port)
