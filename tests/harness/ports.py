"""Ports for servers under test.

The system gives ephemeral ports (32768 and above on Linux) to clients.  So a client of another test may take a port
that was free a moment ago, before the server listens on it.  These ports are below that range.  Each process counts up
from a start of its own, and skips what is in use.
"""

from __future__ import annotations

import itertools
import os
import socket

FIRST, END = 10_000, 32_000
_offsets = itertools.count(os.getpid() * 97)


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
