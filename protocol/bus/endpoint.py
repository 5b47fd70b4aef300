"""How a process of ours joins the bus: the zenoh configuration as plain values, for any language's zenoh.

The default needs no server: the gateway is the router (`listen`), everybody else a client that connects to it.
Multicast scouting is off: two rigs in one lab must not find each other by accident.

Rule: who does not read loses its own messages and nobody else's.  Publishers say BLOCK, so that what they hand to their
      router waits where a bounded queue counts it.  Where a router hands it on (egress), each subscriber has a queue of
      1 MiB and what does not fit is dropped at once: blocking there, or waiting a moment for each message, would stall
      all subscribers behind the one (measured: gateway/README.md, "A subscriber that does not read").
"""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from typing import Any, Literal

from protocol.bus.identity import Identity
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
        # Replies go as their query came: not in the queue of the states, which may be full of what nobody reads.
        {"messages": ["query"], "flows": ["ingress"], "overwrite": _DROP | {"priority": "data_high"}},
    ]
}


def check_endpoint(endpoint: str, *, where: str) -> str:
    """Return a zenoh endpoint such as tcp/127.0.0.1:7447, else raise ConfigError naming `where`."""
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
    """JSON5 text for `zenoh.Config.from_json5`.

    Args:
        mode: router for the one who listens for others, client for everybody else.
        listen: endpoints to open, e.g. tcp/127.0.0.1:7447.
        connect: endpoints to reach.
        wait_for_router: True fails after 5 s without a router: a command should say so.  False returns at once and
            keeps looking for it in the background: daemons must start in any order.  (zenoh does that for peers and
            routers, a client's open blocks.  A router passes nothing between two peers that cannot reach each other, so
            such a daemon joins as a router that listens nowhere.)
        identity: who this process is on a guarded bus.
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
    config["transport"] = {"link": link}
    if listen:
        link["tx"] = {"queue": ROUTER_QUEUE}
        config["qos"] = ROUTER_QOS
    if identity is not None:
        config["transport"]["auth"] = {"usrpwd": {"user": identity.name, "password": identity.password}}
        link["tls"] = {
            "root_ca_certificate": str(identity.ca),
            "connect_certificate": str(identity.certificate),
            "connect_private_key": str(identity.key),
            "enable_mtls": True,
            "verify_name_on_connect": True,
        }
    return json.dumps(config, indent=2)


def refused_by_router(endpoints: Sequence[str], identity: Identity | None) -> ServiceError:
    """The error for a client whose `zenoh.open` failed: zenoh tells only that nobody answered in time.

    A router that does not take this client's certificate or password looks like no router; so does a guarded one to a
    client without an identity.
    """
    where = ", ".join(endpoints)
    remedy = "Start `board51 gateway`, or give its endpoint with --connect"
    if identity is not None:
        return ServiceError(
            f"No router answers at {where}, or it does not take the identity {identity.name}",
            remedy=f"{remedy}; if it runs, get {identity.folder} anew from its `board51 security` folder",
        )
    if any(endpoint.startswith(("tls/", "quic/")) for endpoint in endpoints):
        remedy += "; a guarded one wants --identity DIR/identities/NAME"
    return ServiceError(f"No router answers at {where}", remedy=remedy)
