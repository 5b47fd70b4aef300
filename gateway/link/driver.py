"""State machine of the link to one board.  No I/O; `io_thread.py` moves the bytes.

Link states describe the direction from the board (`from_board.py`):

    absent       no port
    connecting   the port is being opened
    handshake    the port is open, the board has not agreed yet
    streaming    valid frames arrive, and states if the stream is on
    silent       no valid frame has arrived for `stale_s`

The direction to the board has a state of its own (`to_board.py`).

Rule 1: each change of state or reason is reported (`reporter.py`).
Rule 2: the driver never changes mode or reference: starting or ending the gateway must not drop the ball.
"""

from __future__ import annotations

import secrets
from dataclasses import dataclass

from gateway.access.authorize import Sender
from gateway.board.scaling import StateEncoder, WireCommand, parameters_message, scaling_of
from gateway.config import BoardConfig
from gateway.link import event_text
from gateway.link.capture import CaptureReader
from gateway.link.clock import HostClock
from gateway.link.command_handler import CommandHandler
from gateway.link.from_board import DIAGNOSE_S, FromBoard, Known
from gateway.link.keepalive import Keepalive
from gateway.link.reporter import LinkReporter
from gateway.link.sink import Reply, Sink
from gateway.link.to_board import ToBoard
from protocol.wire.events import Answer, BoardEvent, Event, Opened, Restarted, Sample, VersionRefused
from protocol.wire.messages import EventCode, Message
from protocol.wire.session import Session

REFUSED_RETRY_S = 5.0  # retry of a refused board, which may have been replaced or flashed since
_RESTARTS = {"tick": "its tick jumped", "no-session": "it forgot this gateway"}


@dataclass(slots=True)
class LinkCounts:
    """The counters of one board since the gateway's start."""

    bytes_sent: int = 0
    opened: int = 0  # how often the port was opened
    samples: int = 0  # handed on
    samples_refused: int = 0  # of a board that is not served


def _new_session(config: BoardConfig) -> Session:
    # Random: a gateway that restarts must not reuse the number of a session that a subscriber remembers, wherever its
    # clock is.
    return Session(
        choose_session=lambda: secrets.randbits(16),
        timeout_s=config.command_timeout_s,
        retries=config.command_retries,
        hello_s=max(0.25, config.command_timeout_s),
        first_number=1 + secrets.randbits(30),
    )


class BoardDriver:
    """The state machine of one board's link.  All calls must come from one thread."""

    def __init__(self, config: BoardConfig, sink: Sink, clock: HostClock) -> None:
        self.config = config
        self.counts = LinkCounts()
        self.port = config.port
        self.deadline_s = float("inf")
        self.session = _new_session(config)
        self.known = Known()
        self.handler = CommandHandler(config.limits, self.session, self.known, sink, self._accepted)
        self.report = LinkReporter(config.name, self.session, sink, clock)
        self._sink, self._clock = sink, clock
        self._encoder: StateEncoder | None = None
        self._capture = CaptureReader(self.session, self.report, sink)
        self.keepalive = Keepalive(config, self.session, self._got_parameters)
        self.from_board = FromBoard(config, self.session.counters, self.known)
        self.to_board = ToBoard(self.report.change_to_board)
        self._refused_until_s = 0.0
        self._now_s = 0.0

    @property
    def stopped_ns(self) -> int:
        """The arrival of the last STOP, Unix time by the clock as it is now; 0 where none came."""
        stopped_s = self.handler.stopped_s
        return 0 if stopped_s is None else round(stopped_s * 1e9) + self._clock.offset_ns()

    @property
    def link(self) -> str:
        """The state of the link."""
        return self.report.state

    # -- the port, as the loop finds it

    def port_absent(self, kind: str, text: str) -> None:
        """Note that the port could not be opened; `kind` is the event's name."""
        self.report.change("absent", kind, text, severity="warning")

    def port_opened(self, name: str, now_s: float) -> None:
        """Begin the handshake on an open port."""
        self.counts.opened += 1
        self.port = name
        self._now_s = now_s
        self.from_board.port_opened(now_s)
        self.report.renew_time()
        self.to_board.begin()
        self.report.change("handshake", "port-opened", f"{name} is open; calling the board.")
        self.session.connect(now_s)
        self._set_deadline()

    def port_lost(self, text: str, now_s: float, *, severity: str = "warning") -> None:
        """Note that the port was lost or closed; all pending commands are answered."""
        self._now_s = now_s
        self._disconnect("the loss of the port", now_s)
        self.to_board.begin()
        self.report.change("absent", "port-lost", text, severity=severity)
        self.deadline_s = float("inf")

    # -- bytes and time

    def received(self, data: bytes, now_ns: int) -> None:
        """Process bytes read at `now_ns` (monotonic)."""
        now_s = self._now_s = now_ns * 1e-9
        host_ns = now_ns + self.report.offset_ns
        self.from_board.bytes_received += len(data)
        self._sink.raw(data, host_ns, to_board=False)
        counters = self.session.counters
        valid, states, board_answers = counters.valid_frames, counters.states, counters.stray_board_answers
        payloads: list[bytes] = []
        sample: Sample | None = None
        quiet = self.link == "streaming"  # and nothing but samples arrives
        for event in self.session.feed(data, now_s):
            if type(event) is Sample:
                if self._encoder is None:
                    self.counts.samples_refused += 1
                    continue
                sample = event
                # One that had to wait for its successor was read earlier than these bytes.
                at_ns = host_ns if event.arrived_s == now_s else round(event.arrived_s * 1e9) + self.report.offset_ns
                payloads.append(self._encoder.encode(event, at_ns))
            else:
                quiet = False
                self._hand_on(payloads, host_ns, now_ns)  # keep the order: a reset follows the samples before it
                payloads = []
                self._handle(event, now_s)
                host_ns = now_ns + self.report.offset_ns  # a session that begins here reads the clock again
        self._hand_on(payloads, host_ns, now_ns)
        if payloads and self._encoder is not None:
            self.known.sample = sample
        if counters.valid_frames != valid:
            self.from_board.frames_arrived(now_s, states=counters.states != states)
            if counters.stray_board_answers != board_answers:
                self.to_board.answered()  # too late for its command, but it proves that the board received it
            self.to_board.frames_arrived(now_s, self.known.stream_period_s)
            # The sign of life means that samples arrive, and not that the process, the port or the session lives.
            if self.link != "streaming" and self._encoder is not None and not self.from_board.states_missing(now_s):
                assert self.known.identity is not None
                text = event_text.board_identity(self.known.identity, self.port, self.session.number)
                self.report.change("streaming", "link-streaming", text)
        if not quiet:
            self._set_deadline()
        elif self.session.deadline_s < self.deadline_s:  # samples move all others to later: `poll` looks again
            self.deadline_s = self.session.deadline_s

    def poll(self, now_s: float) -> None:
        """Process what is due: time-outs of answers, PINGs and the check for silence."""
        self._now_s = now_s
        for event in self.session.poll(now_s):
            self._handle(event, now_s)
        if self.link in ("streaming", "silent"):
            silence = self.from_board.silence(now_s)
            if silence is not None:
                self.report.change("silent", *silence, severity="warning")
        self.to_board.judge(now_s)
        if self.link == "handshake":
            self._explain(now_s)
        if self.session.is_open:
            self.keepalive.poll(now_s)
        self._capture.poll(now_s)
        self._set_deadline()

    def command(self, payload: bytes, reply: Reply, now_s: float, sender: Sender) -> None:
        """Handle a query from the bus."""
        self._now_s = now_s
        self.handler.take(
            payload, reply, now_s, self.report.host_ns(), link=self.link, reason=self.report.reason, sender=sender
        )
        for event in self.session.take_outcomes():
            self._handle(event, now_s)
        self._set_deadline()

    def output(self) -> bytes:
        """Return the bytes to write next; call it again after `wrote`, because there may be more."""
        data = self.session.output()
        if data:  # also where the port takes nothing: then nothing reaches the board
            self.to_board.sent(self._now_s)
        return data

    def wrote(self, count: int) -> None:
        """Note that the port has accepted `count` bytes, and log them."""
        if count:
            # Logged once the port has accepted them: what a STOP or a time-out dropped before has never been sent.
            self._sink.raw(self.session.output()[:count], self.report.host_ns(), to_board=True)
        self.counts.bytes_sent += count
        self.session.wrote(count)

    def _hand_on(self, payloads: list[bytes], host_ns: int, now_ns: int) -> None:
        if payloads:
            self.counts.samples += len(payloads)
            self._sink.states(payloads, host_ns, now_ns)

    # -- events of the session

    def _handle(self, event: Event, now_s: float) -> None:
        match event:
            case Answer():
                if event.message is not None:
                    self.to_board.answered()
                known = self.handler.answered(event, self.report.host_ns()) or self._capture.answered(event, now_s)
                if not known:
                    self.keepalive.answered(event, now_s)
            case BoardEvent():
                self.report.board_event(event)
                if event.code == EventCode.CAPTURE_DONE:
                    self._capture.capture_completed(now_s)
            case Opened():
                self.to_board.answered()
                self._opened(event, now_s)
            case Restarted():
                self.from_board.began_s = now_s
                if event.doubtful is not None:
                    text = event_text.in_doubt(*event.doubtful, self.session.number)
                    self.report.publish("samples-in-doubt", "warning", text)
                self._end_session("a restart of the board" if event.board_reset else "a jump of the tick")
                text = f"The board restarted: {_RESTARTS[event.why]}."
                self.report.change("handshake", "board-restarted", text, severity="warning")
            case VersionRefused():
                self.to_board.answered()
                self._refuse_board("version-mismatch", event_text.other_version(event.board_version), now_s)

    def _opened(self, opened: Opened, now_s: float) -> None:
        scaling, board_id = scaling_of(opened.identity), opened.identity.int("board_id")
        if self.config.board_id not in (0, board_id):
            text = event_text.wrong_board(self.port, board_id, self.config.board_id)
            self._refuse_board("wrong-board", text, now_s)
        elif isinstance(scaling, str):
            self._refuse_board("bad-identity", scaling, now_s)
        else:
            self.report.renew_time()
            self.known.identity, self.known.scaling = opened.identity, scaling
            self._encoder = StateEncoder(scaling, opened.session)
            self.from_board.state_s = now_s
            self.keepalive.begin(now_s)

    def _refuse_board(self, kind: str, text: str, now_s: float) -> None:
        self._disconnect("the refusal of the board", now_s)
        self._refused_until_s = now_s + REFUSED_RETRY_S
        self.report.change("handshake", kind, text, severity="fault")

    def _disconnect(self, why: str, now_s: float) -> None:
        for event in self.session.disconnect():
            self._handle(event, now_s)
        self._end_session(why)

    def _end_session(self, why: str) -> None:
        self._encoder = None
        self.known.forget()
        self.keepalive.end()
        self.handler.session_ended()
        self._capture.interrupt(why)

    def _got_parameters(self, message: Message) -> None:
        identity, scaling = self.known.identity, self.known.scaling
        if identity is not None and scaling is not None:
            if not self.known.stream_period_s:
                self.from_board.state_s = self._now_s  # a stream that was off, or not known
            self.known.board_has(message)
            host_ns = self.report.host_ns()
            number, limits = self.session.number, self.config.limits
            parameters = parameters_message(message, identity, scaling, session=number, host_time_ns=host_ns)
            parameters.gateway_x_ref_min_m, parameters.gateway_x_ref_max_m = limits.x_ref_min_m, limits.x_ref_max_m
            self._sink.send("parameters", parameters, host_ns)
            self.handler.plant_card.board_is(parameters.board_id, parameters.firmware, host_ns)

    def _accepted(self, wire: WireCommand) -> None:
        self._capture.accepted(wire, self.known.scaling, self._now_s)
        self.keepalive.accepted(wire, self._now_s)

    def _explain(self, now_s: float) -> None:
        if not self._refused_until_s:
            verdict = self.from_board.no_handshake(now_s)
            if verdict is not None:
                self.report.change("handshake", *verdict, severity="warning")
        elif now_s >= self._refused_until_s:
            self._refused_until_s = 0.0
            self.session.connect(now_s)

    def _set_deadline(self) -> None:
        deadlines = [part.deadline_s for part in (self.session, self.keepalive, self.to_board, self._capture)]
        if self.link == "streaming":
            deadlines.append(self.from_board.deadline_s)
        elif self.link == "handshake":
            deadlines.append(self._refused_until_s or self._now_s + DIAGNOSE_S)
        self.deadline_s = min(deadlines)
