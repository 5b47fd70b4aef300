"""The zenoh configuration with which a process joins the bus, as plain values for zenoh in any language.

By default no separate server is needed: the gateway is the router (`listen`), all other processes are clients of it.
Multicast scouting is off, so that two rigs in one laboratory do not connect by accident.

Rule: a subscriber that does not read loses only its own messages.  Publishers use BLOCK towards their router, so that
      messages wait in a bounded queue that counts losses.  On the way out of the router, each subscriber has a queue of
      1 MiB.  Messages that do not fit are dropped at once.  Waiting there would stall all other subscribers (measured:
      gateway/README.md, "A subscriber that does not read").
"""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from typing import Any, Literal

from protocol.bus.identity import AUTHORITY, CERTIFICATE, KEY, Identity
from protocol.errors import ConfigError, ServiceError

DEFAULT_ENDPOINT = "tcp/127.0.0.1:7447"
_ENDPOINT = re.compile(r"(tcp|udp|tls|quic|ws|unixsock-stream)/[^\s#?]+")
Mode = Literal["router", "client"]
BATCHES = 16  # of 64 KiB: the largest queue zenoh allows; 2 s of 8 boards at 500 Hz beyond what the system buffers
ROUTER_QUEUE: dict[str, Any] = {
    "size": {"data": BATCHES, "data_high": BATCHES},
    "congestion_control": {"drop": {"wait_before_drop": 0}},
}
_DROP = {"congestion_control": "drop"}
ROUTER_QOS: dict[str, Any] = {
    "network": [
        {"messages": ["put", "delete", "query"], "flows": ["egress"], "overwrite": _DROP},
        # Replies have the priority of their query, so that they do not wait behind unread states.
        {"messages": ["query"], "flows": ["ingress"], "overwrite": _DROP | {"priority": "data_high"}},
    ]
}


def check_endpoint(endpoint: str, *, where: str) -> str:
    """Return `endpoint` if it is valid, such as tcp/127.0.0.1:7447, else raise ConfigError naming `where`."""
    if not _ENDPOINT.fullmatch(endpoint):
        raise ConfigError(
            f"{where}: {endpoint!r} is not a zenoh endpoint",
            remedy=f"Write it as tcp/HOST:PORT, e.g. {DEFAULT_ENDPOINT}",
        )
    return endpoint


def zenoh_config(
    mode: Mode,
    *,
    listen: Sequence[str] = (),
    connect: Sequence[str] = (),
    wait_for_router: bool = True,
    identity: Identity | None = None,
) -> str:
    """Return the JSON5 text for `zenoh.Config.from_json5`.

    Args:
        mode: "router" for the process that others connect to, "client" for all others.
        listen: Endpoints to open, e.g. tcp/127.0.0.1:7447.
        connect: Endpoints to connect to.
        wait_for_router: True (for commands) fails after 5 s without a router.  False (for daemons, which may start in
            any order) returns at once and connects in the background.  zenoh does this for peers and routers only; a
            client's open blocks.  A router passes no messages between two peers that cannot reach each other, so
            such a daemon joins as a router without listeners.
        identity: Identity of this process on a guarded bus.
    """
    config: dict[str, Any] = {
        "mode": mode if wait_for_router else "router",
        "listen": {"endpoints": list(listen), "exit_on_failure": True},
        "connect": {
            "endpoints": list(connect),
            "timeout_ms": 5000 if wait_for_router else -1,
            "exit_on_failure": wait_for_router,
            "retry": {"period_init_ms": 200, "period_max_ms": 1000, "period_increase_factor": 1.5},
        },
        "scouting": {"multicast": {"enabled": False}, "gossip": {"enabled": False}},
        "timestamping": {"enabled": False},
    }
    link: dict[str, Any] = {}
    # zenoh would pass messages from 3 KiB on through 16 MiB of shared memory, which each process at both ends maps and
    # keeps: 27 MB of a gateway and 52 MB of a router after the first one.
    config["transport"] = {"link": link, "shared_memory": {"enabled": False}}
    if listen:
        link["tx"] = {"queue": ROUTER_QUEUE}
        config["qos"] = ROUTER_QOS
    if identity is not None:
        config["transport"]["auth"] = {"usrpwd": {"user": identity.name, "password": identity.password}}
        link["tls"] = {
            "root_ca_certificate": str(identity.folder / AUTHORITY),
            "connect_certificate": str(identity.folder / CERTIFICATE),
            "connect_private_key": str(identity.folder / KEY),
            "enable_mtls": True,
            "verify_name_on_connect": True,
        }
    return json.dumps(config, indent=2)


def router_refusal(endpoints: Sequence[str], identity: Identity | None) -> ServiceError:
    """Return the error for a client whose `zenoh.open` failed; zenoh itself reports only a time-out.

    A router that rejects this client's certificate or password looks like an absent router.  The same holds
    for a guarded router and a client without an identity.
    """
    where = ", ".join(endpoints)
    remedy = "Start `board51 gateway`, or give its endpoint with --connect"
    if identity is not None:
        return ServiceError(
            f"No router answers at {where}, or it does not accept the identity {identity.name}",
            remedy=f"{remedy}; if it runs, copy {identity.folder} again from its `board51 security` folder",
        )
    if any(endpoint.startswith(("tls/", "quic/")) for endpoint in endpoints):
        remedy += "; a guarded router requires --identity DIR/identities/NAME"
    return ServiceError(f"No router answers at {where}", remedy=remedy)


def has_subscriber(publisher: Any) -> bool:
    """Return whether this zenoh publisher has a subscriber; takes about a microsecond."""
    return bool(publisher.matching_status.matching)
