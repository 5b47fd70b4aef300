"""The rules for opening listeners: loopback always, others only if protected or with an explicit `--insecure`.

The gateway, the router, OPC UA and the web page use these checks.
"""

from __future__ import annotations

import ipaddress
import logging
import os
import socket
from collections.abc import Sequence

from protocol.errors import ConfigError

_ENCRYPTED = ("tls", "quic")
_logger = logging.getLogger("gateway.access")


def is_loopback(host: str) -> bool:
    """Return whether `host` is a loopback address or localhost; other names are not resolved."""
    bare = host.strip("[]").partition("%")[0]
    try:
        address = ipaddress.ip_address(bare)
    except ValueError:
        return bare.lower() == "localhost"
    mapped = getattr(address, "ipv4_mapped", None)
    return (mapped or address).is_loopback


def allow_restart(listener: socket.socket) -> None:
    """Let a server listen where one has just ended; on Windows the option would let two listen at once."""
    if os.name == "posix":
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)


def try_listening(host: str, port: int) -> None:
    """Listen for a moment, for servers that tell late or badly of a port in use.  Raises OSError if it is."""
    family, kind, _, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
    with socket.socket(family, kind) as probe:
        allow_restart(probe)
        probe.bind(address)
        probe.listen(1)


def check_listener(host: str, *, protected: bool, insecure: bool, what: str, remedy: str) -> None:
    """Check that a listener may be opened.

    Args:
        host: to listen on, a name or an address.
        protected: whether it encrypts and authenticates.
        insecure: whether the user gave `--insecure`.
        what: description of the listener, for errors: "The web page at 0.0.0.0:8051".
        remedy: how to protect it; ", or listen on 127.0.0.1; --insecure opens it all the same" is added.

    Raises:
        ConfigError: the listener is open to the network without protection.
    """
    if protected or is_loopback(host):
        return
    if not insecure:
        problem = f"{what} would be open to the network without protection"
        raise ConfigError(problem, remedy=f"{remedy}, or listen on 127.0.0.1; --insecure opens it all the same")
    _logger.warning("%s is open to the network WITHOUT PROTECTION (--insecure): whoever reaches it may command", what)


def check_bus_listeners(endpoints: Sequence[str], *, guarded: bool, insecure: bool) -> None:
    """`check_listener` for zenoh endpoints; on a guarded bus, listeners beyond this machine must be encrypted.

    Raises:
        ConfigError: a listener is open to the network without protection.
    """
    for endpoint in endpoints:
        protocol, host = endpoint_host(endpoint)
        if protocol.startswith("unix"):
            continue
        remedy = "Make keys with `board51 security init DIR` and give --security DIR with a tls/ endpoint"
        if guarded:
            remedy = f"Write {endpoint.replace(protocol, 'tls', 1)}"
        protected, what = guarded and protocol in _ENCRYPTED, f"The bus at {endpoint}"
        check_listener(host, protected=protected, insecure=insecure, what=what, remedy=remedy)


def endpoint_host(endpoint: str) -> tuple[str, str]:
    """(protocol, host) of a zenoh endpoint."""
    protocol, _, rest = endpoint.partition("/")
    return protocol, rest.partition("?")[0].partition("#")[0].rpartition(":")[0]


def nearest(endpoints: Sequence[str]) -> str:
    """The listener for a process of this machine: one on loopback if there is any, otherwise the first."""
    local = [endpoint for endpoint in endpoints if is_loopback(endpoint_host(endpoint)[1])]
    return to_reach((local or list(endpoints))[0])


def to_reach(endpoint: str) -> str:
    """The endpoint for a process of this machine to connect to: 0.0.0.0 and [::] are replaced by loopback."""
    for anywhere, loopback in (("/0.0.0.0:", "/127.0.0.1:"), ("/[::]:", "/[::1]:")):
        endpoint = endpoint.replace(anywhere, loopback)
    return endpoint
