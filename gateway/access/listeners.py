"""Which listeners may be opened: loopback always, anything else only protected, or by an explicit `--insecure`.

The gateway, the router, OPC UA and the web page all ask here.
"""

from __future__ import annotations

import ipaddress
import logging
from collections.abc import Sequence

from protocol.errors import ConfigError

_ENCRYPTED = ("tls", "quic")
_logger = logging.getLogger("gateway.access")


def is_loopback(host: str) -> bool:
    """Whether only this machine reaches `host`; a name other than localhost does not count."""
    bare = host.strip("[]").partition("%")[0]
    try:
        address = ipaddress.ip_address(bare)
    except ValueError:
        return bare.lower() == "localhost"
    mapped = getattr(address, "ipv4_mapped", None)
    return (mapped or address).is_loopback


def check_listener(host: str, *, protected: bool, insecure: bool, what: str, remedy: str) -> None:
    """Refuse to open a listener that others reach and nobody guards.

    Args:
        host: to listen on, a name or an address.
        protected: it encrypts and asks who comes.
        insecure: the user has said `--insecure`.
        what: listens, for the error: "The web page at 0.0.0.0:8051".
        remedy: how to protect it; " or listen on 127.0.0.1; --insecure opens it all the same" is added.

    Raises:
        ConfigError: as said.
    """
    if protected or is_loopback(host):
        return
    if not insecure:
        raise ConfigError(
            f"{what} would be open to the network without protection",
            remedy=f"{remedy}, or listen on 127.0.0.1; --insecure opens it all the same",
        )
    _logger.warning("%s is open to the network WITHOUT PROTECTION (--insecure): whoever reaches it may command", what)


def check_bus_listeners(endpoints: Sequence[str], *, guarded: bool, insecure: bool) -> None:
    """The same for zenoh endpoints.  On a guarded bus, too, what leaves this machine must be encrypted.

    Raises:
        ConfigError: as said.
    """
    for endpoint in endpoints:
        protocol, host = endpoint_host(endpoint)
        if protocol.startswith("unix"):
            continue
        remedy = (
            f"Write {endpoint.replace(protocol, 'tls', 1)}"
            if guarded
            else "Make keys with `board51 security init DIR` and give --security DIR with a tls/ endpoint"
        )
        check_listener(
            host,
            protected=guarded and protocol in _ENCRYPTED,
            insecure=insecure,
            what=f"The bus at {endpoint}",
            remedy=remedy,
        )


def endpoint_host(endpoint: str) -> tuple[str, str]:
    """(protocol, host) of a zenoh endpoint."""
    protocol, _, rest = endpoint.partition("/")
    return protocol, rest.partition("?")[0].partition("#")[0].rpartition(":")[0]


def nearest(endpoints: Sequence[str]) -> str:
    """Which of several listeners a process of this machine takes: one that others cannot reach, where there is one."""
    local = [endpoint for endpoint in endpoints if is_loopback(endpoint_host(endpoint)[1])]
    return to_reach((local or list(endpoints))[0])


def to_reach(endpoint: str) -> str:
    """What a process of this machine connects to where `endpoint` is listened on: 0.0.0.0 is no destination."""
    for anywhere, here in (("/0.0.0.0:", "/127.0.0.1:"), ("/[::]:", "/[::1]:")):
        endpoint = endpoint.replace(anywhere, here)
    return endpoint
