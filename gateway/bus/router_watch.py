"""Pauses the publishers of a gateway that is a client while its router is absent; the queues keep and count messages.

Rule 1: `hold` is called in zenoh's thread as soon as the connection ends; everything else happens at the next `look`.
Rule 2: after the router's return the subscribers need time to reconnect, and messages sent at once would be lost.  The
        pause therefore lasts SETTLE_S longer, and then until there is a subscriber, at most PATIENCE_S.
Rule 3: messages that zenoh or the system accepted before the end of the connection may be lost; they are not counted.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Sequence

import zenoh

from gateway.bus.publisher import BoardSink, Publisher

SETTLE_S = 1.5  # clients look for their router every second at least (protocol/bus/endpoint.py)
PATIENCE_S = 10.0


class RouterWatch:
    """Holds `publishers` while `session`, of a client or a router without listeners, has no router.

    The losses of `sinks` are reported and their subscribers awaited; `where` names the endpoints in messages.
    """

    def __init__(
        self,
        session: zenoh.Session,
        where: str,
        sinks: Sequence[BoardSink],
        publishers: Sequence[Publisher],
    ) -> None:
        self._where, self._sinks, self._publishers = where, sinks, publishers
        self._lock = threading.Lock()
        self._routers = 0
        self._joined = False  # ever
        self._lost_s: float | None = time.monotonic()  # None: not paused
        self._back_s = self._lost_s
        self._loss_reported = False
        self._dropped = 0  # count of the sinks at the start of the pause
        self._hold(held=True)
        self._listener = session.info.declare_transport_events_listener(self._changed, history=True)

    def close(self) -> None:
        """Stop watching, and release the publishers."""
        self._listener.undeclare()
        self._hold(held=False)

    def look(self) -> tuple[str, str, str] | None:
        """Return (name, severity, text) of the event to publish, or None; call it once a second."""
        now_s = time.monotonic()
        with self._lock:
            if self._lost_s is None:
                return None
            if not self._loss_reported:
                self._loss_reported = True
                text = f"No router at {self._where}: messages wait, the newest are kept, and the log has them all."
                return "bus-lost", "warning", text
            back_s = now_s - self._back_s
            may_resume = back_s >= PATIENCE_S or any(sink.has_subscribers for sink in self._sinks)
            if not self._routers or back_s < SETTLE_S or not may_resume:
                return None
            waiting = sum(publisher.waiting for publisher in self._publishers)
            self._hold(held=False)
            dropped = sum(sink.dropped for sink in self._sinks) - self._dropped
            text = f"The router was away for {self._back_s - self._lost_s:.1f} s; {waiting} messages waited and follow"
            text += f", the {dropped} before them are only in the log." if dropped else "."
            self._lost_s = None
            return "bus-back", "warning" if dropped else "info", text

    def _changed(self, event: zenoh.TransportEvent) -> None:
        """Handle a change of the connection; called in zenoh's thread."""
        now_s = time.monotonic()
        with self._lock:
            if event.kind == zenoh.SampleKind.PUT:
                first, self._joined, self._back_s = not self._joined, True, now_s
                self._routers += 1
                if first and self._lost_s is not None and now_s - self._lost_s < SETTLE_S:
                    self._lost_s = None  # connected from the start: no subscriber has to reconnect
                    self._hold(held=False)
                return
            self._routers -= 1
            if not self._routers and self._lost_s is None:
                self._lost_s, self._loss_reported = now_s, False
                self._dropped = sum(sink.dropped for sink in self._sinks)
                self._hold(held=True)

    def _hold(self, *, held: bool) -> None:
        for publisher in self._publishers:
            publisher.hold(held=held)
