"""Reports of one board's link: events on the bus, lines in the gateway's log, the sign of life, and their time.

Rule 1: each change of state or reason gives one event and one log line, with counts; repeated attempts give none.
Rule 2: within a session the time never steps (clock.py).
"""

from __future__ import annotations

import logging
import time

from gateway.board.conditions import TO_BOARD
from gateway.link import event_text
from gateway.link.clock import HostClock
from gateway.link.sink import Sink
from gateway.link.to_board import ANSWERING, UNANSWERED, UNANSWERED_S
from protocol.bus import board51_pb2 as pb
from protocol.wire.events import BoardEvent
from protocol.wire.messages import FAULT_EVENTS
from protocol.wire.session import Session

_logger = logging.getLogger("gateway.link")
_LEVELS = {"info": logging.INFO, "warning": logging.WARNING}


class LinkReporter:
    """The reported state of one board's link, with its reason and time."""

    def __init__(self, board: str, session: Session, sink: Sink, clock: HostClock) -> None:
        self.state = "connecting"
        self.reason = "the port is being opened"
        self.fault: pb.Event | None = None  # the latest fault event; whether it is active: FAULT flag
        self.unanswered: pb.Event | None = None  # while the board answers nothing
        self._kind = ""
        self._board, self._session, self._sink, self._clock = board, session, sink, clock
        self.renew_time()
        self.since_ns = self.host_ns()  # Unix time: streaming, or not, since then

    def renew_time(self) -> None:
        """Read the host's clock again, at the start of a session."""
        self.offset_ns = self._clock.offset_ns()  # Unix time minus monotonic time

    def host_ns(self) -> int:
        """Return Unix time that does not step within a session, ns."""
        # Not the wall clock itself: a step of it would put samples of one session into the wrong order.
        return time.monotonic_ns() + self.offset_ns

    def publish(self, name: str, severity: str, text: str, *, source: str = "gateway", tick: int = 0) -> pb.Event:
        """Publish and log an event of this board."""
        event = pb.Event(
            host_time_ns=self.host_ns(),
            tick=tick,
            session=self._session.number if self._session.is_open else 0,
            source=source,
            severity=severity,
            name=name,
            text=text,
        )
        self._sink.send("event", event, event.host_time_ns)
        return event

    def change(self, state: str, kind: str, text: str, *, severity: str = "info") -> None:
        """Report a state of the link; `kind` is the event's name."""
        if (state, kind) == (self.state, self._kind):
            return
        was_alive, alive = self.state == "streaming", state == "streaming"
        self.state, self._kind, self.reason = state, kind, "" if alive else text
        if alive != was_alive:
            self.since_ns = self.host_ns()
            self._sink.alive(alive=alive)
        self.publish(kind, severity, text)
        counters = self._session.counters
        _logger.log(
            _LEVELS.get(severity, logging.ERROR),
            "%s: %s: %s [%d samples, %d lost, %d bad frames, %d resets]",
            self._board,
            state,
            text,
            counters.samples,
            self._session.unwrapper.lost,
            sum(counters.bad_frames.values()),
            counters.board_resets,
        )

    def change_to_board(self, state: str) -> None:
        """Report a state of the direction to the board."""
        before, self.unanswered = self.unanswered, None
        if state == UNANSWERED:
            text = (
                f"The board has not answered for {UNANSWERED_S:g} s although its frames arrive: a STOP may not reach"
                " it. Check the line to the board (its RX); to stop the rig now, cut its power."
            )
            self.unanswered = self.publish(TO_BOARD, "fault", text)
            _logger.error("%s: %s", self._board, self.unanswered.text)
        elif state == ANSWERING and before is not None:
            published = self.publish("board-answers", "info", "The board answers again.")
            _logger.info("%s: %s", self._board, published.text)

    def board_event(self, event: BoardEvent) -> None:
        """Report an event of the board."""
        if event.missed:
            self.publish("events-lost", "warning", f"{event.missed} events of the board were lost on the line.")
        name, severity, text = event_text.of_board(event)
        published = self.publish(name, severity, text, source="board", tick=event.tick)
        if event.code in FAULT_EVENTS:
            self.fault = published
