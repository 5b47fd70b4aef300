"""The claim of a board by one twin: a liveliness token names the process, and a second process refuses.

Two twins of one board would publish under the same keys, and no subscriber could tell their messages apart.

Rule 1: a twin first looks for the tokens of others, and declares its own only if there is none.  So one that refuses
        is never seen by the one that runs.
Rule 2: two that declare at the same time, or meet when a network is joined again, see each other's tokens: the younger
        one ends.
Rule 3: a token vanishes at once with its process, also after kill -9.  Where a machine or its network fails, the router
        keeps it for the lease, 10 s; until then the next twin refuses.
"""

from __future__ import annotations

import os
import re
import socket
import threading
import time
from collections.abc import Callable

import zenoh

from protocol.bus import topics
from protocol.errors import ServiceError, quoted

LEASE_S = 10.0  # zenoh's default
_LOOK_S = 2.0


class Claim:
    """The token of one twin, and the look-out for those of others.

    Args:
        session: of the bus.
        site: first chunk of the keys.
        board: that the twin serves; None: every board of the site.
        refuse: is called with the error, at most once, in any thread, when another twin serves the same.
    """

    def __init__(
        self, session: zenoh.Session, site: str, board: str | None, refuse: Callable[[ServiceError], None]
    ) -> None:
        host = re.sub(r"[^A-Za-z0-9.]", "-", socket.gethostname())
        self._name = f"{time.time_ns():020d}-{os.getpid()}-{host}"
        self._session, self._site, self._board, self._refuse = session, site, board or topics.EVERY_BOARD, refuse
        self._lock = threading.Lock()  # guards the two below: the look and zenoh's callback may find the same twin
        self._declared = self._refused = False
        self._token: zenoh.LivelinessToken | None = None
        self._key = f"{site}/*/{topics.TWIN_ALIVE}/*"
        self._subscriber = session.liveliness().declare_subscriber(self._key, self._appeared, history=True)

    def declare(self) -> None:
        """Look for other twins, and declare the token if there is none; the session has reached the router."""
        for reply in self._session.liveliness().get(self._key, timeout=_LOOK_S):
            if reply.ok is not None:
                self._meet(str(reply.ok.key_expr))
        with self._lock:
            if self._refused:
                return
            self._declared = True
        key = f"{self._site}/{self._board}/{topics.TWIN_ALIVE}/{self._name}"
        self._token = self._session.liveliness().declare_token(key)

    def _appeared(self, sample: zenoh.Sample) -> None:
        if sample.kind == zenoh.SampleKind.PUT and self._declared:  # before that, `declare` looks
            self._meet(str(sample.key_expr))

    def _meet(self, key: str) -> None:
        _, board, _, _, name = key.split("/")
        # The name begins with the time of the start: so both sides agree which of them is the younger one.
        serves_the_same = topics.EVERY_BOARD in (board, self._board) or board == self._board
        if not serves_the_same or name == self._name or (self._declared and name > self._name):
            return
        with self._lock:
            if self._refused:
                return
            self._refused = True
        process, _, host = name.partition("-")[2].partition("-")
        who = f"process {process} on {host}" if host else f"one that calls itself {quoted(name)}"
        what = "every board" if board == topics.EVERY_BOARD else f"board {board}"
        self._refuse(
            ServiceError(
                f"A twin already serves {what} of site {self._site}: {who}",
                remedy="End it, hand your model over to it (board51 twin --hand-over), or give another --board. If "
                f"its machine or network failed, start again in {LEASE_S:g} s",
            )
        )
