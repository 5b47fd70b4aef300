"""Ports for servers under test.

The system gives ephemeral ports (32768 and above on Linux) to clients.  So a client of another test may take a port
that was free a moment ago, before the server listens on it.  These ports are below that range.  Each process of a run
has a range of its own, counts up in it, and skips what is in use.
"""

from __future__ import annotations

import itertools
import os
import socket

FIRST, END = 10_000, 32_000
EACH = 2_500  # more than a process of a run asks for
_process = int(os.environ.get("PYTEST_XDIST_WORKER", "gw0").removeprefix("gw"))
_offsets = itertools.count(os.getppid() * 97 + _process * EACH)  # the parent of the processes of one run is the same


def free_port() -> int:
    """Return a TCP port of 127.0.0.1 on which nobody listens."""
    while True:
        port = FIRST + next(_offsets) % (END - FIRST)
        with socket.socket() as probe:
            try:
                probe.bind(("127.0.0.1", port))
            except OSError:
                continue
        return port


def free_endpoint() -> str:
    """Return a zenoh endpoint on which nobody listens."""
    return f"tcp/127.0.0.1:{free_port()}"
