"""The demo's view of the bus: counts, newest values, commands."""

from __future__ import annotations

import contextlib
import math
import queue
import time

import zenoh

from gateway.client.connection import send
from protocol.bus import board51_pb2 as pb
from protocol.bus import topics
from protocol.bus.encoding import parse
from protocol.errors import ServiceError


class BusView:
    """The bus topics of one board.

    Args:
        session: of the bus.
        board: its name.
    """

    def __init__(self, session: zenoh.Session, board: str) -> None:
        self._session, self._board = session, board
        self._counts: dict[str, int] = {}
        self._samples: queue.SimpleQueue[tuple[str, bytes]] = queue.SimpleQueue()
        self.t_s = math.nan  # time of the newest sample read, on the board's clock
        for name in ("state", "twin/state", "twin/divergence"):
            session.declare_subscriber(topics.key(topics.DEFAULT_SITE, board, name), self._arrived)

    def _arrived(self, sample: zenoh.Sample) -> None:
        address = topics.split(str(sample.key_expr))
        if address is not None:
            self._counts[address[2]] = self._counts.get(address[2], 0) + 1
            self._samples.put((address[2], sample.payload.to_bytes()))

    def count(self, topic: str) -> int:
        """Number of messages of a topic so far."""
        return self._counts.get(topic, 0)

    def command(self, command: pb.Command) -> None:
        """Send a command to the board.  Raises ServiceError if it was refused."""
        command.who = "demo"
        reply = send(self._session, topics.DEFAULT_SITE, self._board, command)
        if not reply.accepted:
            what = command.WhichOneof("what")
            raise ServiceError(
                f"{what} was refused by {reply.refused_by}: {reply.reason}: {reply.text.rstrip('.')}",
                remedy="Run it step by step with board51 emulate, gateway and send",
            )

    def catch_up(self) -> float:
        """Read all waiting messages; returns the board's time of the newest sample, s."""
        with contextlib.suppress(queue.Empty):
            while True:
                self._take(*self._samples.get_nowait())
        return self.t_s

    def hold(self, duration_s: float) -> tuple[float, float]:
        """Read for `duration_s`; returns the last position, m, and the rms of measured minus twin current, A."""
        end = time.monotonic() + duration_s
        x, squares, n = math.nan, 0.0, 0
        while (left := end - time.monotonic()) > 0:
            with contextlib.suppress(queue.Empty):
                message = self._take(*self._samples.get(timeout=left))
                if isinstance(message, pb.State):
                    x = message.x_m
                elif isinstance(message, pb.Divergence) and math.isfinite(message.i_c_a.error):
                    squares, n = squares + message.i_c_a.error**2, n + 1
        return x, math.sqrt(squares / n) if n else math.nan

    def _take(self, topic: str, data: bytes) -> pb.State | pb.Divergence | None:
        if topic == "state":
            state = parse(pb.State, data)
            self.t_s = state.t_s if state else self.t_s
            return state
        return parse(pb.Divergence, data) if topic == "twin/divergence" else None
