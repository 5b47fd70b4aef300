"""Serves the bus as a live Foxglove WebSocket: the same topics, bytes and schemas as in the MCAP logs.

Rule 1: it is read-only: no parameters, no services, no messages from clients.
Rule 2: messages are passed on unchanged, with the time stamps of the gateway, as in its log.  Those of `states` are
        passed on one by one, as `state`.  What is `derived` from them for the Log and 3D panels follows them.
Rule 3: the protocol has no login, so the server listens on loopback only, unless `--insecure` is given.
Rule 4: a client that does not read loses only its own messages (`BACKLOG`).
"""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable

import foxglove
import zenoh
from foxglove import Channel, Context, Schema
from google.protobuf.message import Message

from gateway.client.connection import Subscription
from gateway.client.recording import LogTimes
from gateway.views.foxglove.derived import Derived
from protocol.bus import topics
from protocol.bus.encoding import (
    BATCH_OF,
    MESSAGE_ENCODING,
    SCHEMA_ENCODING,
    descriptor_set,
    parse,
    parts,
    schema_name,
)
from protocol.ending import wait_for_end
from protocol.errors import ServiceError

BACKLOG = 4096  # messages that wait for one client; 8 boards with twins send 12 000 a second
MAX_CHANNELS = 1000
_logger = logging.getLogger("gateway.foxglove")


class FoxgloveView:
    """A Foxglove server on one bus session.

    Args:
        session: of the bus.
        site: first chunk of the keys.
        host: to listen on.
        port: 0 for any free one.

    Raises:
        ServiceError: the port is taken.
    """

    def __init__(self, session: zenoh.Session, site: str, host: str, port: int) -> None:
        self.refused = 0
        self._context = Context()
        self._lock = threading.Lock()  # zenoh calls from several threads
        self._channels: dict[str, Channel] = {}
        self._times = LogTimes()
        self._derived = Derived()
        self._descriptors = descriptor_set()
        try:
            self._server = foxglove.start_server(
                name=f"Board51 {site}", host=host, port=port, context=self._context, message_backlog_size=BACKLOG
            )
        except (OSError, RuntimeError) as error:
            raise ServiceError(
                f"Foxglove cannot listen on {host}:{port}: {error}",
                remedy="End the program that uses the port, or give another one with --listen HOST:PORT",
            ) from None
        self.port = self._server.port
        # Batches have the same samples, in fewer messages.
        names = [topic for topic in topics.RECEIVED if topic not in BATCH_OF]
        self._subscription = Subscription(session, [f"{site}/*/{topic}" for topic in names], self._arrived)

    def close(self) -> None:
        """End the server."""
        self._subscription.close()
        self._server.stop()

    def _arrived(self, sample: zenoh.Sample) -> None:
        key, data = str(sample.key_expr), sample.payload.to_bytes()
        address = topics.split(key)
        message = parse(topics.TOPIC_OF_NAME[address[2]].message, data) if address is not None else None
        if address is None or message is None:
            self.refused += 1
            return
        for topic, part in parts(address[2], message):
            whole = part is message
            name = key if whole else topics.key(address[0], address[1], topic)
            self._show(name, address, part, data if whole else part.SerializeToString())

    def _show(self, key: str, address: tuple[str, str, str], message: Message, data: bytes) -> None:
        site, board, _ = address
        with self._lock:
            time_ns = self._times.of(board, message)
            self._log(key, data, time_ns, lambda: self._schema(type(message)))
            for name, panel in self._derived.take(site, board, message, time_ns):
                self._log(name, panel.encode(), time_ns, panel.get_schema)

    def _log(self, key: str, data: bytes, time_ns: int, schema: Callable[[], Schema]) -> None:
        channel = self._channels.get(key)
        if channel is None:
            if len(self._channels) >= MAX_CHANNELS:
                self.refused += 1
                return
            channel = Channel(key, schema=schema(), message_encoding=MESSAGE_ENCODING, context=self._context)
            self._channels[key] = channel
        channel.log(data, log_time=time_ns)

    def _schema(self, message: type[Message]) -> Schema:
        return Schema(name=schema_name(message), encoding=SCHEMA_ENCODING, data=self._descriptors)


def serve(
    session: zenoh.Session, site: str, host: str, port: int, stop: threading.Event, ready: Callable[[int], None]
) -> None:
    """Serve until `stop` is set; `ready` is called with the port."""
    view = FoxgloveView(session, site, host, port)
    _logger.info("Foxglove on ws://%s:%d", host, view.port)
    ready(view.port)
    wait_for_end(stop.wait)
    view.close()
