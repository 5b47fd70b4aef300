"""State machine of the link to one board.  No I/O; `io_thread.py` moves the bytes.

Link states describe the direction from the board (`from_board.py`):

    absent       no port
    connecting   the port is being opened
    handshake    the port is open, the board has not agreed yet
    streaming    valid frames arrive, and states if the stream is on
    silent       no valid frame has arrived for `stale_s`

The direction to the board has a state of its own (`to_board.py`).

Rule 1: each change of state or reason gives one event and one log line, with counts; repeated attempts give none.
Rule 2: the driver never changes mode or reference: starting or ending the gateway must not drop the ball.
Rule 3: within a session `host_time_ns` never steps (clock.py).
"""

from __future__ import annotations

import logging
import secrets
import time
from dataclasses import dataclass

from gateway.access.authorize import Sender
from gateway.board.conditions import TO_BOARD
from gateway.board.scaling import StateEncoder, WireCommand, parameters_message, scaling_of
from gateway.config import BoardConfig
from gateway.link import event_text
from gateway.link.capture import CaptureReader
from gateway.link.clock import HostClock
from gateway.link.command_handler import CommandHandler
from gateway.link.from_board import DIAGNOSE_S, FromBoard, Known
from gateway.link.keepalive import Keepalive
from gateway.link.sink import Reply, Sink
from gateway.link.to_board import ANSWERING, UNANSWERED, UNANSWERED_S, ToBoard
from protocol.bus import board51_pb2 as pb
from protocol.wire.events import Answer, BoardEvent, Event, Opened, Restarted, Sample, VersionRefused
from protocol.wire.messages import FAULT_EVENTS, EventCode, Message
from protocol.wire.session import Session

REFUSED_RETRY_S = 5.0  # retry of a refused board, which may have been replaced or flashed since
_logger = logging.getLogger("gateway.link")


@dataclass(slots=True)
class LinkCounts:
    """The counters of one board since the gateway's start."""

    bytes_sent: int = 0
    reconnects: int = 0
    opened: int = 0
    samples: int = 0  # handed on
    samples_refused: int = 0  # of a board that is not served


class BoardDriver:
    """The state machine of one board's link.  All calls must come from one thread.

    Args:
        config: Configuration of this board.
        sink: Receives samples, events and records.
        clock: Host clock.
        log_raw: Whether raw bytes are passed to the sink.
    """

    def __init__(self, config: BoardConfig, sink: Sink, clock: HostClock, *, log_raw: bool = True) -> None:
        self.config = config
        self.counts = LinkCounts()
        self.link = "connecting"
        self.reason = "the port is being opened"
        self.fault: pb.Event | None = None  # the latest fault event; whether it is active: FAULT flag
        self._kind = ""
        self.port = config.port
        self.deadline_s = float("inf")
        # Unix seconds: a gateway that restarts must not reuse the number of a session that a subscriber remembers.
        self.session = Session(
            choose_session=lambda: secrets.randbits(16),
            timeout_s=config.command_timeout_s,
            retries=config.command_retries,
            hello_s=max(0.25, config.command_timeout_s),
            first_number=int(time.time()) & 0x7FFFFFFF,
        )
        self.known = Known()
        self.handler = CommandHandler(config.limits, self.session, self.known, sink, self._accepted)
        self._sink, self._clock, self._log_raw = sink, clock, log_raw
        self._offset_ns = clock.offset_ns()
        self.since_ns = self.host_ns()  # Unix time: streaming, or not, since then
        self._encoder: StateEncoder | None = None
        self._capture = CaptureReader(self.session, self._capture_ended)
        self.keepalive = Keepalive(config, self.session, self._got_parameters)
        self.from_board = FromBoard(config, self.session.counters, self.known)
        self.to_board = ToBoard(self._to_board_is)
        self.unanswered: pb.Event | None = None  # while the board answers nothing
        self._refused_until_s = 0.0
        self._now_s = 0.0
        self._alive = False

    # -- the port, as the loop finds it

    def port_absent(self, kind: str, text: str) -> None:
        """Note that the port could not be opened; `kind` is the event's name."""
        self._change("absent", kind, text, severity="warning")

    def port_opened(self, name: str, now_s: float) -> None:
        """Begin the handshake on an open port."""
        self.counts.opened += 1
        self.counts.reconnects = self.counts.opened - 1
        self.port = name
        self._now_s = now_s
        self.from_board.port_opened(now_s)
        self._offset_ns = self._clock.offset_ns()
        self.to_board.begin()
        self._change("handshake", "port-opened", f"{name} is open; calling the board.")
        self.session.connect(now_s)
        self._set_deadline()

    def port_lost(self, text: str, now_s: float, *, severity: str = "warning") -> None:
        """Note that the port was lost or closed; all pending commands are answered."""
        self._now_s = now_s
        for event in self.session.disconnect():
            self._handle(event, now_s)
        self._end_session("the loss of the port")
        self.to_board.begin()
        self._change("absent", "port-lost", text, severity=severity)
        self.deadline_s = float("inf")

    # -- bytes and time

    def received(self, data: bytes, now_ns: int) -> None:
        """Process bytes read at `now_ns` (monotonic)."""
        now_s = self._now_s = now_ns * 1e-9
        host_ns = now_ns + self._offset_ns
        self.from_board.bytes_received += len(data)
        if self._log_raw:
            self._sink.raw(data, host_ns, to_board=False)
        session = self.session
        counters = session.counters
        valid, states, board_answers = counters.valid_frames, counters.states, counters.stray_board_answers
        payloads: list[bytes] = []
        sample: Sample | None = None
        for event in session.feed(data, now_s):
            if type(event) is Sample:
                if self._encoder is None:
                    self.counts.samples_refused += 1
                    continue
                sample = event
                # One that had to wait for its successor was read earlier than these bytes.
                at_ns = host_ns if event.arrived_s == now_s else round(event.arrived_s * 1e9) + self._offset_ns
                payloads.append(self._encoder.encode(event, at_ns))
            else:
                if payloads:  # keep the order: a reset follows the samples before it
                    self._hand_on(payloads, host_ns, now_ns)
                    payloads = []
                self._handle(event, now_s)
        if payloads:
            self._hand_on(payloads, host_ns, now_ns)
            if self._encoder is not None:
                self.known.sample = sample
        if counters.valid_frames != valid:
            self.from_board.frames_arrived(now_s, states=counters.states != states)
            if counters.stray_board_answers != board_answers:
                self.to_board.answered()  # too late for its command, but it proves that the board received it
            self.to_board.frames_arrived(now_s, self.known.stream_period_s)
            if self.link != "streaming" and self._encoder is not None and not self.from_board.states_missing(now_s):
                assert self.known.identity is not None
                text = event_text.board_identity(self.known.identity, self.port, self.session.number)
                self._change("streaming", "link-streaming", text)
        self._set_deadline()

    def poll(self, now_s: float) -> None:
        """Process what is due: time-outs of answers, PINGs and the check for silence."""
        self._now_s = now_s
        for event in self.session.poll(now_s):
            self._handle(event, now_s)
        if self.link in ("streaming", "silent"):
            self._silent(self.from_board.silence(now_s))
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
        self.handler.take(payload, reply, now_s, self.host_ns(), link=self.link, reason=self.reason, sender=sender)
        self._drain(now_s)
        self._set_deadline()

    def output(self) -> bytes:
        """Return the bytes to write next; call it again after `wrote`, because there may be more."""
        data = self.session.output()
        if data:  # also where the port takes nothing: then nothing reaches the board
            self.to_board.sent(self._now_s)
        return data

    def wrote(self, count: int) -> None:
        """Note that the port has accepted `count` bytes, and log them."""
        if count and self._log_raw:
            self._sink.raw(self.session.output()[:count], self.host_ns(), to_board=True)
        self.counts.bytes_sent += count
        self.session.wrote(count)

    def host_ns(self) -> int:
        """Return Unix time that does not step within a session, ns."""
        return time.monotonic_ns() + self._offset_ns

    def publish_event(self, name: str, severity: str, text: str, *, source: str = "gateway", tick: int = 0) -> pb.Event:
        """Publish and log an event of this board."""
        event = pb.Event(
            host_time_ns=self.host_ns(),
            tick=tick,
            session=self.session.number if self.session.is_open else 0,
            source=source,
            severity=severity,
            name=name,
            text=text,
        )
        self._sink.send("event", event, event.host_time_ns)
        return event

    def _hand_on(self, payloads: list[bytes], host_ns: int, now_ns: int) -> None:
        self.counts.samples += len(payloads)
        self._sink.states(payloads, host_ns, now_ns)

    # -- events of the session

    def _handle(self, event: Event, now_s: float) -> None:
        match event:
            case Answer():
                if event.message is not None:
                    self.to_board.answered()
                self._answered(event, now_s)
            case BoardEvent():
                self._board_event(event, now_s)
            case Opened():
                self.to_board.answered()
                self._opened(event, now_s)
            case Restarted():
                self.from_board.handshake_begins(now_s)
                if event.doubtful is not None:
                    text = event_text.in_doubt(*event.doubtful, self.session.number)
                    self.publish_event("samples-in-doubt", "warning", text)
                self._end_session("a restart of the board" if event.board_reset else "a jump of the tick")
                why = {"tick": "its tick jumped", "no-session": "it forgot this gateway"}
                self._change(
                    "handshake", "board-restarted", f"The board restarted: {why[event.why]}.", severity="warning"
                )
            case VersionRefused():
                self.to_board.answered()
                self._refuse_board("version-mismatch", event_text.other_version(event.board_version), now_s)

    def _opened(self, opened: Opened, now_s: float) -> None:
        scaling = scaling_of(opened.identity)
        board_id = opened.identity.int("board_id")
        if self.config.board_id not in (0, board_id):
            text = event_text.wrong_board(self.port, board_id, self.config.board_id)
            self._refuse_board("wrong-board", text, now_s)
            return
        if isinstance(scaling, str):
            self._refuse_board("bad-identity", scaling, now_s)
            return
        self._offset_ns = self._clock.offset_ns()
        self.known.identity, self.known.scaling = opened.identity, scaling
        self._encoder = StateEncoder(scaling, opened.session)
        self.from_board.states_may_begin(now_s)
        self.keepalive.begin(now_s)

    def _refuse_board(self, kind: str, text: str, now_s: float) -> None:
        for event in self.session.disconnect():
            self._handle(event, now_s)
        self._end_session("the refusal of the board")
        self._refused_until_s = now_s + REFUSED_RETRY_S
        self._change("handshake", kind, text, severity="fault")

    def _end_session(self, why: str) -> None:
        self._encoder = None
        self.known.forget()
        self.keepalive.end()
        self.handler.session_ended()
        self._capture.interrupt(why)

    def _answered(self, answer: Answer, now_s: float) -> None:
        if self.handler.answered(answer, self.host_ns()):
            return
        if self._capture.answered(answer, now_s):
            return
        self.keepalive.answered(answer, now_s)

    def _got_parameters(self, message: Message) -> None:
        identity, scaling = self.known.identity, self.known.scaling
        if identity is not None and scaling is not None:
            if not self.known.stream_period_s:
                self.from_board.states_may_begin(self._now_s)  # a stream that was off, or not known
            self.known.parameters = message
            host_ns = self.host_ns()
            parameters = parameters_message(
                message, identity, scaling, session=self.session.number, host_time_ns=host_ns
            )
            parameters.gateway_x_ref_min_m = self.config.limits.x_ref_min_m
            parameters.gateway_x_ref_max_m = self.config.limits.x_ref_max_m
            self._sink.send("parameters", parameters, host_ns)

    def _accepted(self, wire: WireCommand, command: pb.Command, message: Message) -> None:
        if wire.name == "CAPTURE" and self.known.scaling is not None:
            self._capture.begin(self.known.scaling, wire, self._now_s)
        elif wire.name in ("STOP", "SET_MODE"):
            self._capture.interrupt("STOP" if wire.name == "STOP" else "a change of mode")
        elif wire.name == "SET_HOST_LOSS":
            self.keepalive.host_loss_is(int(wire.values["timeout"]), self._now_s)
        if wire.name in ("SET_GAINS", "SET_STREAM", "SET_HOST_LOSS"):
            self.keepalive.read_parameters(self._now_s)

    def _capture_ended(self, result: pb.CaptureRecord | str) -> None:
        if isinstance(result, str):
            self.publish_event("capture-failed", "warning", result)
        else:
            result.host_time_ns = self.host_ns()
            self._sink.send("capture", result, result.host_time_ns)

    def _board_event(self, event: BoardEvent, now_s: float) -> None:
        if event.missed:
            self.publish_event("events-lost", "warning", f"{event.missed} events of the board were lost on the line.")
        name, severity, text = event_text.of_board(event)
        published = self.publish_event(name, severity, text, source="board", tick=event.tick)
        if event.code in FAULT_EVENTS:
            self.fault = published
        if event.code == EventCode.CAPTURE_DONE:
            self._capture.capture_completed(now_s)

    # -- time

    def _silent(self, verdict: tuple[str, str] | None) -> None:
        if verdict is not None:
            self._change("silent", *verdict, severity="warning")

    def _to_board_is(self, state: str) -> None:
        before, self.unanswered = self.unanswered, None
        if state == UNANSWERED:
            self.unanswered = self.publish_event(TO_BOARD, "fault", event_text.no_answers(UNANSWERED_S))
            _logger.error("%s: %s", self.config.name, self.unanswered.text)
        elif state == ANSWERING and before is not None:
            published = self.publish_event("board-answers", "info", "The board answers again.")
            _logger.info("%s: %s", self.config.name, published.text)

    def _drain(self, now_s: float) -> None:
        for event in self.session.take_outcomes():
            self._handle(event, now_s)

    def _explain(self, now_s: float) -> None:
        if self._refused_until_s:
            if now_s >= self._refused_until_s:
                self._refused_until_s = 0.0
                self.session.connect(now_s)
            return
        verdict = self.from_board.no_handshake(now_s)
        if verdict is not None:
            self._change("handshake", *verdict, severity="warning")

    def _set_deadline(self) -> None:
        deadline = min(
            self.session.deadline_s, self.keepalive.deadline_s, self.to_board.deadline_s, self._capture.deadline_s
        )
        if self.link == "streaming":
            deadline = min(deadline, self.from_board.deadline_s)
        elif self.link == "handshake":
            deadline = min(deadline, self._refused_until_s or self._now_s + DIAGNOSE_S)
        self.deadline_s = deadline

    # -- telling

    def _change(self, link: str, kind: str, text: str, *, severity: str = "info") -> None:
        if (link, kind) == (self.link, self._kind):
            return
        self.link, self._kind, self.reason = link, kind, "" if link == "streaming" else text
        alive = link == "streaming"
        if alive != self._alive:
            self._alive, self.since_ns = alive, self.host_ns()
            self._sink.alive(alive=alive)
        self.publish_event(kind, severity, text)
        c = self.session.counters
        level = {"info": logging.INFO, "warning": logging.WARNING}.get(severity, logging.ERROR)
        _logger.log(
            level,
            "%s: %s: %s [%d samples, %d lost, %d bad frames, %d resets]",
            self.config.name,
            link,
            text,
            c.samples,
            self.session.unwrapper.lost,
            sum(c.bad_frames.values()),
            c.board_resets,
        )
