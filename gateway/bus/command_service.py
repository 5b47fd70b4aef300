"""The queryable `<site>/<board>/command`: a Command in, exactly one CommandReply out.

On a guarded bus it is `<site>/<board>/command/as/<role>/<who>`, and nothing is served under the plain key.

zenoh calls back in its own threads.  The serial thread handles the command (`link/command_handler.py`), a publisher's
thread sends the reply.  Every query gets a reply: without one, its sender would assume that there is no gateway.
"""

from __future__ import annotations

import threading
import time

import zenoh

from gateway.access.authorize import Authorizer, Sender
from gateway.board.limits import read_command
from gateway.board.scaling import Refusal
from gateway.bus.publisher import Publisher, PublishQueue
from gateway.link.driver import BoardDriver
from gateway.link.io_thread import LinkThread
from gateway.link.sink import Reply
from protocol.bus import board51_pb2 as pb
from protocol.bus import topics
from protocol.bus.encoding import zenoh_encoding

MAX_POSTED = 256  # queries that may wait for the serial thread; beyond this, only STOP is passed on
_ENCODING = zenoh_encoding(pb.CommandReply)


class CommandService:
    """Serves one board's commands until the zenoh session closes.

    The publisher of the replies is not that of events, which holds while there is no router.
    """

    def __init__(
        self,
        session: zenoh.Session,
        site: str,
        driver: BoardDriver,
        link: LinkThread,
        replies: Publisher,
        authorizer: Authorizer,
    ) -> None:
        self._key = topics.key(site, driver.config.name, "command")
        self._driver, self._link, self._replies, self._authorizer = driver, link, replies, authorizer
        self._lock = threading.Lock()  # of _posted: queries come in several threads
        self._posted = 0
        served = f"{self._key}/{topics.AS}/*/*" if authorizer.guarded else self._key
        self._queryable = session.declare_queryable(served, self._on_query)

    def _on_query(self, query: zenoh.Query) -> None:
        payload = query.payload.to_bytes() if query.payload is not None else b""
        query_key = str(query.key_expr)
        sender = self._authorizer.sender(query_key, time.time_ns(), time.monotonic())
        if isinstance(sender, Refusal):
            refusal = pb.CommandReply(refused_by="gateway", reason=sender.reason, text=sender.text)
            _reply_to(query, query_key, self._replies)(refusal)
            return
        role = sender.role
        key = self._key if role is None else f"{self._key}/{topics.AS}/{role.word}/{sender.name}"
        reply = _reply_to(query, key, self._replies)
        flood = self._flood(payload, sender)
        if flood is not None:
            reply(flood)
            return
        with self._lock:
            self._posted += 1

        def finish(answer: pb.CommandReply) -> None:
            with self._lock:
                self._posted -= 1
            reply(answer)

        self._link.command(self._driver, payload, finish, sender)

    def _flood(self, payload: bytes, sender: Sender) -> pb.CommandReply | None:
        """Return the refusal of a command beyond the rate, before it loads the serial thread; None if accepted."""
        full = self._posted >= MAX_POSTED
        if not full and not self._authorizer.guarded:
            return None
        command, _ = read_command(payload)
        if command.WhichOneof("what") == "stop":
            return None
        if not full and not self._authorizer.flooded(sender, time.monotonic()):
            return None
        text = "Too many commands at once; only STOP is exempt."
        return pb.CommandReply(id=command.id, refused_by="gateway", reason="flood", text=text)


def _reply_to(query: zenoh.Query, key: str, replies: Publisher) -> Reply:
    """Return the function that answers one query."""

    def send(payload: bytes) -> None:
        with query:
            query.reply(key, payload, encoding=_ENCODING)

    return lambda answer: replies.put(PublishQueue(send), [answer.SerializeToString()])
