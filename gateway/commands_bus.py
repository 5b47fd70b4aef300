"""The queryable `<site>/<board>/command`: a Command in, exactly one CommandReply out.

zenoh calls back in its own threads; the decision falls in the serial thread (`link/desk.py`), the reply leaves through
a publisher's thread.  A query without a reply would look to its sender like a gateway that is not there.
"""

from __future__ import annotations

import threading

import zenoh

from gateway.limits import read_command
from gateway.link.driver import BoardDriver
from gateway.link.loop import LinkThread
from gateway.publish import Channel, Publisher
from gateway.samples import Refusal
from protocol.bus import board51_pb2 as pb
from protocol.bus import topics
from protocol.bus.encoding import zenoh_encoding

MAX_POSTED = 256  # queries on their way to the serial thread; beyond it only STOP is carried there
_ENCODING = zenoh_encoding(pb.CommandReply)


class CommandQueryable:
    """Serves one board's commands until the zenoh session closes."""

    def __init__(
        self, session: zenoh.Session, site: str, driver: BoardDriver, link: LinkThread, messages: Publisher
    ) -> None:
        self._key = topics.key(site, driver.config.name, "command")
        self._driver, self._link, self._messages = driver, link, messages
        self._lock = threading.Lock()  # of _posted: queries come in several threads
        self._posted = 0
        self._queryable = session.declare_queryable(self._key, self._on_query)

    def _on_query(self, query: zenoh.Query) -> None:
        payload = query.payload.to_bytes() if query.payload is not None else b""
        reply = _Reply(query, self._key, self._messages)
        if self._posted >= MAX_POSTED:
            command = read_command(payload)
            if isinstance(command, Refusal) or command.WhichOneof("what") != "stop":
                answer = pb.CommandReply(refused_by="gateway", reason="flood", text="Too many commands at once.")
                answer.id = "" if isinstance(command, Refusal) else command.id
                reply(answer)
                return
        with self._lock:
            self._posted += 1

        def done(answer: pb.CommandReply) -> None:
            with self._lock:
                self._posted -= 1
            reply(answer)

        self._link.command(self._driver, payload, done)


class _Reply:
    """Answers one query."""

    def __init__(self, query: zenoh.Query, key: str, messages: Publisher) -> None:
        self._query, self._key, self._messages = query, key, messages

    def __call__(self, answer: pb.CommandReply) -> None:
        self._messages.put(Channel(self), [answer.SerializeToString()])

    def put(self, payload: bytes, /) -> None:
        with self._query:
            self._query.reply(self._key, payload, encoding=_ENCODING)
