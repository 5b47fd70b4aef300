"""How a process of ours joins the bus: the zenoh configuration as plain values, for any language's zenoh.

The default needs no server: the gateway is the router (`listen`), everybody else a client that connects to it.
Multicast scouting is off: two rigs in one lab must not find each other by accident.
"""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from typing import Literal

from protocol.errors import ConfigError

DEFAULT_ENDPOINT = "tcp/127.0.0.1:7447"
_ENDPOINT = re.compile(r"(tcp|udp|tls|quic|ws|unixsock-stream)/[^\s#?]+")
Mode = Literal["router", "client"]


def check_endpoint(endpoint: str, *, where: str) -> str:
    """Return a zenoh endpoint such as tcp/127.0.0.1:7447, else raise ConfigError naming `where`."""
    if not _ENDPOINT.fullmatch(endpoint):
        raise ConfigError(
            f"{where}: {endpoint!r} is not a zenoh endpoint",
            remedy=f"Write it as tcp/HOST:PORT, e.g. {DEFAULT_ENDPOINT}",
        )
    return endpoint


def zenoh_config(
    mode: Mode, *, listen: Sequence[str] = (), connect: Sequence[str] = (), wait_for_router: bool = True
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
    """
    return json.dumps(
        {
            "mode": mode if wait_for_router else "router",
            "listen": {"endpoints": list(listen), "exit_on_failure": True},
            "connect": {
                "endpoints": list(connect),
                "timeout_ms": 5000 if wait_for_router else -1,
                "exit_on_failure": wait_for_router,
                "retry": {"period_init_ms": 200, "period_max_ms": 2000, "period_increase_factor": 1.5},
            },
            "scouting": {"multicast": {"enabled": False}, "gossip": {"enabled": False}},
            "timestamping": {"enabled": False},
        },
        indent=2,
    )
