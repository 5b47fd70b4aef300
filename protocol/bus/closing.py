"""The end of a session of the bus within a bounded time.

zenoh waits up to 10 s for a peer to take what is still queued for it, then raises (zenoh 1.10, measured with a router
that is stopped).  A service has less time: its parent kills it.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import Protocol

CLOSE_S = 2.0  # a peer that reads takes milliseconds; one on a busy machine is given a chance


class Session(Protocol):
    """A `zenoh.Session`."""

    @property
    def close(self) -> Callable[[], object]:
        """Close it, and raise where its peer does not read."""


def close(session: Session) -> None:
    """Close a session; what its peer has not taken within CLOSE_S is lost."""

    def work() -> None:
        with suppress(Exception):  # its own limit has passed, and nobody waits any longer
            session.close()

    closer = threading.Thread(target=work, name="close-bus", daemon=True)
    closer.start()
    closer.join(CLOSE_S)


@contextmanager
def closing(session: Session) -> Iterator[None]:
    """Context manager: `close` the session at the end of the block."""
    try:
        yield
    finally:
        close(session)
