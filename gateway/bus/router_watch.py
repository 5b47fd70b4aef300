"""What a gateway that is a client does while its router is gone: its publishers hold, the queue keeps and counts.

Rule 1: `hold` falls in zenoh's thread, at the moment the connection ends; everything else at the next `look`.
Rule 2: after the router's return the others need a moment to join it again: what were put at once would reach nobody.
        So the hold lasts SETTLE_S more, and until somebody subscribes, PATIENCE_S at most.
Rule 3: what zenoh and the system had taken before the connection ended is not known to have arrived, and not counted.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import zenoh

from gateway.bus.publisher import BoardSink, Publisher

SETTLE_S = 1.5  # clients look for their router every second at least (protocol/bus/endpoint.py)
PATIENCE_S = 10.0


@dataclass(frozen=True, slots=True, kw_only=True)
class RouterChange:
    """An event to tell."""

    name: str
    severity: str
    text: str


class RouterWatch:
    """Holds `publishers` while `session` has no router.

    Args:
        session: a client's, or a router's that listens nowhere.
        where: the endpoints that it connects to, for messages.
        sinks: whose losses are told, and whose subscribers are waited for.
        publishers: what is held.
        now_s: monotonic clock.
    """

    def __init__(
        self,
        session: zenoh.Session,
        where: str,
        sinks: Sequence[BoardSink],
        publishers: Sequence[Publisher],
        *,
        now_s: Callable[[], float] = time.monotonic,
    ) -> None:
        self._where, self._sinks, self._publishers, self._now_s = where, sinks, publishers, now_s
        self._lock = threading.Lock()
        self._routers = 0
        self._joined = False  # ever
        self._lost_s: float | None = now_s()  # None where nothing is held
        self._back_s = self._lost_s
        self._told = False
        self._dropped = 0  # of the sinks, when the hold began
        self._hold(held=True)
        self._listener = session.info.declare_transport_events_listener(self._changed, history=True)

    def close(self) -> None:
        """Watch no more; what waits may go."""
        self._listener.undeclare()  # type: ignore[no-untyped-call]  # the stub has no return type
        self._hold(held=False)

    def look(self) -> RouterChange | None:
        """Once a second: what has changed, where it is to be told."""
        now_s = self._now_s()
        with self._lock:
            if self._lost_s is None:
                return None
            if not self._told:
                self._told = True
                text = f"No router at {self._where}: messages wait, the newest are kept, and the log has them all."
                return RouterChange(name="bus-lost", severity="warning", text=text)
            back_s = now_s - self._back_s
            wanted = back_s >= PATIENCE_S or any(sink.wanted for sink in self._sinks)
            if not self._routers or back_s < SETTLE_S or not wanted:
                return None
            waiting = sum(publisher.waiting for publisher in self._publishers)
            dropped = sum(sink.dropped for sink in self._sinks) - self._dropped
            text = f"The router was away for {self._back_s - self._lost_s:.1f} s; {waiting} messages waited and follow"
            text += f", the {dropped} before them are in the log alone." if dropped else "."
            self._lost_s = None
            self._hold(held=False)
            return RouterChange(name="bus-back", severity="warning" if dropped else "info", text=text)

    def _changed(self, event: zenoh.TransportEvent) -> None:
        """In zenoh's thread."""
        now_s = self._now_s()
        with self._lock:
            if event.kind == zenoh.SampleKind.PUT:
                first, self._joined, self._back_s = not self._joined, True, now_s
                self._routers += 1
                if first and self._lost_s is not None and now_s - self._lost_s < SETTLE_S:
                    self._lost_s = None  # there from the start: nobody has to come back first
                    self._hold(held=False)
                return
            self._routers -= 1
            if not self._routers and self._lost_s is None:
                self._lost_s, self._told = now_s, False
                self._dropped = sum(sink.dropped for sink in self._sinks)
                self._hold(held=True)

    def _hold(self, *, held: bool) -> None:
        for publisher in self._publishers:
            publisher.hold(held=held)
