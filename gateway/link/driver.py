"""One board: what the link is doing, what the board says, what it is told.  No I/O; `loop.py` moves the bytes.

Link states: `absent` (no port), `connecting` (being opened), `handshake` (open, the board has not agreed yet),
`streaming` (valid frames arrive, and states where the stream is on), `silent` (none for `stale_s`).  That is the
direction from the board; the one to it has a state of its own, see `to_board.py`.

Rule 1: one event and one log line for each change of state or reason, with counts; not one for each attempt.
Rule 2: nothing here changes mode or reference: a gateway that comes or goes must not drop the ball.
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
from gateway.link.capture import CaptureReader
from gateway.link.clock import HostClock
from gateway.link.command_handler import CommandHandler, Known
from gateway.link.event_text import describe
from gateway.link.keepalive import Keepalive
from gateway.link.sink import Reply, Sink
from gateway.link.to_board import ANSWERING, UNANSWERED, UNANSWERED_S, ToBoard
from protocol.bus import board51_pb2 as pb
from protocol.wire.events import Answer, BoardEvent, Event, Opened, Restarted, Sample, VersionRefused
from protocol.wire.messages import FAULT_EVENTS, VERSION, EventCode, Message
from protocol.wire.session import Session

DIAGNOSE_S = 2.0  # an open port without a handshake for this long gets an explanation
# After a pause of everything the first frame need not be a STATE.  Longer than between two PONGs, shorter than stale_s.
STANDSTILL_S = 0.6
REFUSED_RETRY_S = 5.0  # a board that was refused may have been exchanged or flashed
_logger = logging.getLogger("gateway.link")


@dataclass(slots=True)
class LinkCounts:
    """Of one board since the gateway's start."""

    bytes_received: int = 0
    bytes_sent: int = 0
    reconnects: int = 0
    opened: int = 0
    samples: int = 0  # handed on
    samples_refused: int = 0  # of a board that is not served


class BoardDriver:
    """The state machine of one board's link.  All calls from one thread.

    Args:
        config: of this board.
        sink: where samples, events and records go.
        clock: the host's time.
        log_raw: whether raw bytes are worth handing to the sink.
    """

    def __init__(self, config: BoardConfig, sink: Sink, clock: HostClock, *, log_raw: bool = True) -> None:
        self.config = config
        self.counts = LinkCounts()
        self.link = "connecting"
        self.reason = "the port is being opened"
        self.fault: pb.Event | None = None  # the latest of the board; whether it holds is for the FAULT flag to say
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
        self._capture: CaptureReader | None = None
        self.keepalive = Keepalive(config, self.session, self._got_parameters)
        self.to_board = ToBoard(self._to_board_is)
        self.unanswered: pb.Event | None = None  # while the board answers nothing
        self._last_valid_s = self._last_state_s = self._opened_s = 0.0
        self._valid_at_open = self._bytes_at_open = 0
        self._refused_until_s = 0.0
        self._now_s = 0.0
        self._alive = False

    # -- the port, as the loop finds it

    def port_absent(self, kind: str, text: str) -> None:
        """It could not be opened; `kind` is the event's name."""
        self._change("absent", kind, text, severity="warning")

    def port_opened(self, name: str, now_s: float) -> None:
        """Bytes can flow; begin the handshake."""
        self.counts.opened += 1
        self.counts.reconnects = self.counts.opened - 1
        self.port = name
        self._opened_s = self._last_valid_s = self._now_s = now_s
        self._valid_at_open = self.session.counters.valid_frames
        self._bytes_at_open = self.counts.bytes_received
        self._offset_ns = self._clock.offset_ns()
        self.to_board.begin()
        self._change("handshake", "port-opened", f"{name} is open; calling the board.")
        self.session.connect(now_s)
        self._set_deadline()

    def port_lost(self, text: str, now_s: float, *, severity: str = "warning") -> None:
        """The port is gone, or given back; whatever was under way is answered."""
        self._now_s = now_s
        for event in self.session.disconnect():
            self._handle(event, now_s)
        self._end_session("the loss of the port")
        self.to_board.begin()
        self._change("absent", "port-lost", text, severity=severity)
        self.deadline_s = float("inf")

    # -- bytes and time

    def received(self, data: bytes, now_ns: int) -> None:
        """Bytes read at `now_ns` (monotonic)."""
        now_s = self._now_s = now_ns * 1e-9
        host_ns = now_ns + self._offset_ns
        self.counts.bytes_received += len(data)
        if self._log_raw:
            self._sink.raw(data, host_ns, to_board=False)
        session = self.session
        counters = session.counters
        valid, states, late = counters.valid_frames, counters.states, counters.late_answers
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
            if counters.states != states or now_s - self._last_valid_s >= STANDSTILL_S:
                self._last_state_s = now_s
            if counters.late_answers != late:
                self.to_board.answered()  # too late for its command, but the board has heard it
            self._last_valid_s = now_s
            self.to_board.heard(now_s, self._stream_period_s())
            if self.link != "streaming" and self._encoder is not None and not self._states_missing(now_s):
                self._change("streaming", "link-streaming", self._who_is_there())
        self._set_deadline()

    def poll(self, now_s: float) -> None:
        """Something is due: an answer, a PING, a verdict on silence."""
        self._now_s = now_s
        for event in self.session.poll(now_s):
            self._handle(event, now_s)
        if self.link in ("streaming", "silent"):
            self._listen(now_s)
        self.to_board.judge(now_s)
        if self.link == "handshake":
            self._explain(now_s)
        if self.session.is_open:
            self.keepalive.poll(now_s)
        if self._capture is not None:
            self._capture.poll(now_s)
        self._set_deadline()

    def command(self, payload: bytes, reply: Reply, now_s: float, sender: Sender) -> None:
        """A query from the bus."""
        self._now_s = now_s
        self.handler.take(payload, reply, now_s, self.host_ns(), link=self.link, reason=self.reason, sender=sender)
        self._drain(now_s)
        self._set_deadline()

    def output(self) -> bytes:
        """What to write next; asked again after `wrote`, for there may be more."""
        data = self.session.output()
        if data:  # also where the port takes nothing: then nothing reaches the board
            self.to_board.sent(self._now_s)
        return data

    def wrote(self, count: int) -> None:
        """The port has taken so much of it: that is sent, and logged."""
        if count and self._log_raw:
            self._sink.raw(self.session.output()[:count], self.host_ns(), to_board=True)
        self.counts.bytes_sent += count
        self.session.wrote(count)

    def host_ns(self) -> int:
        """Unix time that does not step within a session."""
        return time.monotonic_ns() + self._offset_ns

    def tell(self, name: str, severity: str, text: str, *, source: str = "gateway", tick: int = 0) -> pb.Event:
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

    # -- what the session says

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
                self._opened_s = now_s
                if event.doubtful is not None:
                    self.tell(
                        "samples-in-doubt",
                        "warning",
                        "PONGs of the board contradict the count of its ticks: the samples {} to {} of session {}"
                        " may have wrong ticks.".format(*event.doubtful, self.session.number),
                    )
                self._end_session("a restart of the board" if event.board_reset else "a jump of the tick")
                why = {"tick": "its tick jumped", "no-session": "it forgot this gateway"}
                self._change(
                    "handshake", "board-restarted", f"The board restarted: {why[event.why]}.", severity="warning"
                )
            case VersionRefused():
                self.to_board.answered()
                self._refuse_board(
                    "version-mismatch",
                    f"The board speaks protocol version {event.board_version}, this gateway {VERSION}:"
                    f" flash firmware of version {VERSION}.x or install a gateway for it.",
                    now_s,
                )

    def _opened(self, opened: Opened, now_s: float) -> None:
        scaling = scaling_of(opened.identity)
        board_id = opened.identity.int("board_id")
        if self.config.board_id not in (0, board_id):
            self._refuse_board(
                "wrong-board",
                f"The board at {self.port} has the serial number {board_id}, the configuration wants"
                f" {self.config.board_id}: exchange the cables or correct board_id.",
                now_s,
            )
            return
        if scaling is None:
            self._refuse_board("bad-identity", "The board reports a scaling of 0: its firmware is not usable.", now_s)
            return
        self._offset_ns = self._clock.offset_ns()
        self.known.identity, self.known.scaling = opened.identity, scaling
        self._encoder = StateEncoder(scaling, opened.session)
        self._last_state_s = now_s
        self.keepalive.begin(now_s)

    def _refuse_board(self, kind: str, text: str, now_s: float) -> None:
        for event in self.session.disconnect():
            self._handle(event, now_s)
        self._end_session("the refusal of the board")
        self._refused_until_s = now_s + REFUSED_RETRY_S
        self._change("handshake", kind, text, severity="fault")

    def _end_session(self, why: str) -> None:
        self._encoder = None
        self.known.identity = self.known.scaling = self.known.parameters = self.known.sample = None
        self.keepalive.end()
        self.handler.session_ended()
        if self._capture is not None:
            self._capture.interrupt(why)

    def _answered(self, answer: Answer, now_s: float) -> None:
        if self.handler.answered(answer, self.host_ns()):
            return
        if self._capture is not None and self._capture.answered(answer, now_s):
            return
        self.keepalive.answered(answer, now_s)

    def _got_parameters(self, message: Message) -> None:
        identity, scaling = self.known.identity, self.known.scaling
        if identity is not None and scaling is not None:
            if not self._stream_period_s():
                self._last_state_s = self._now_s  # a stream that was off, or not known, may begin now
            self.known.parameters = message
            host_ns = self.host_ns()
            parameters = parameters_message(
                message, identity, scaling, session=self.session.number, host_time_ns=host_ns
            )
            self._sink.send("parameters", parameters, host_ns)

    def _accepted(self, wire: WireCommand, command: pb.Command, message: Message) -> None:
        if wire.name == "CAPTURE" and self.known.scaling is not None:
            if self._capture is not None:
                self._capture.interrupt("another one")
            self._capture = CaptureReader(
                self.session,
                self.known.scaling,
                wire,
                command.capture,
                self.session.number,
                self._now_s,
                self._capture_ended,
            )
        elif wire.name in ("STOP", "SET_MODE") and self._capture is not None:
            self._capture.interrupt("STOP" if wire.name == "STOP" else "a change of mode")
        elif wire.name == "SET_HOST_LOSS":
            self.keepalive.host_loss_is(int(wire.values["timeout"]), self._now_s)
        if wire.name in ("SET_GAINS", "SET_STREAM", "SET_HOST_LOSS"):
            self.keepalive.read_parameters(self._now_s)

    def _capture_ended(self, result: pb.CaptureRecord | str) -> None:
        self._capture = None
        if isinstance(result, str):
            self.tell("capture-failed", "warning", result)
        else:
            result.host_time_ns = self.host_ns()
            self._sink.send("capture", result, result.host_time_ns)

    def _board_event(self, event: BoardEvent, now_s: float) -> None:
        if event.missed:
            self.tell("events-lost", "warning", f"{event.missed} events of the board were lost on the line.")
        name, severity, text = describe(event)
        told = self.tell(name, severity, text, source="board", tick=event.tick)
        if event.code in FAULT_EVENTS:
            self.fault = told
        if event.code == EventCode.CAPTURE_DONE and self._capture is not None:
            self._capture.board_says_done(now_s)

    # -- time

    def _stream_period_s(self) -> float:
        """Between two states; 0 where the stream is off or not known."""
        identity, parameters = self.known.identity, self.known.parameters
        if identity is None or parameters is None:
            return 0.0
        return parameters.int("divider") * identity.int("sample_time") * 1e-6

    def _states_limit_s(self) -> float:
        period_s = self._stream_period_s()
        return max(self.config.stale_s, 3 * period_s) if period_s else float("inf")

    def _states_missing(self, now_s: float) -> bool:
        return now_s - self._last_state_s >= self._states_limit_s()

    def _listen(self, now_s: float) -> None:
        stale_s = self.config.stale_s
        if now_s - self._last_valid_s >= stale_s:
            self._change("silent", "link-silent", f"No valid frame for {stale_s:g} s.", severity="warning")
        elif self._states_missing(now_s):
            self._change(
                "silent",
                "no-states",
                f"The board answers, but no STATE has come for {self._states_limit_s():g} s although its stream is on:"
                " its firmware or the line from it is disturbed.",
                severity="warning",
            )

    def _to_board_is(self, state: str) -> None:
        before, self.unanswered = self.unanswered, None
        if state == UNANSWERED:
            self.unanswered = self.tell(
                TO_BOARD,
                "fault",
                f"The board has answered nothing for {UNANSWERED_S:g} s although its frames arrive: a STOP may not"
                " reach it. Check the line to the board (its RX); to stop the rig now, cut its power.",
            )
            _logger.error("%s: %s", self.config.name, self.unanswered.text)
        elif state == ANSWERING and before is not None:
            told = self.tell("board-answers", "info", "The board answers again.")
            _logger.info("%s: %s", self.config.name, told.text)

    def _drain(self, now_s: float) -> None:
        for event in self.session.take_outcomes():
            self._handle(event, now_s)

    def _explain(self, now_s: float) -> None:
        if self._refused_until_s:
            if now_s >= self._refused_until_s:
                self._refused_until_s = 0.0
                self.session.connect(now_s)
            return
        if now_s - self._opened_s < DIAGNOSE_S:
            return
        received = self.counts.bytes_received - self._bytes_at_open
        if self.session.counters.valid_frames > self._valid_at_open:
            if now_s - self._last_valid_s < DIAGNOSE_S:
                kind, text = (
                    "hello-unanswered",
                    "Frames arrive but HELLO is not answered: is the line to the board intact?",
                )
            else:
                kind, text = "no-answer", "The board has fallen silent before the handshake."
        elif received:
            kind = "not-a-board"
            text = (
                f"{received} bytes arrived and none of them is a valid frame: is {self.config.baud} the baud rate,"
                " and is this a Board51?"
            )
        else:
            kind, text = (
                "no-answer",
                "The port is open but nothing arrives: is the board powered, are TX and RX crossed?",
            )
        self._change("handshake", kind, text, severity="warning")

    def _set_deadline(self) -> None:
        deadline = min(self.session.deadline_s, self.keepalive.deadline_s, self.to_board.deadline_s)
        if self.link == "streaming":
            missing_s = self._last_state_s + self._states_limit_s()
            deadline = min(deadline, self._last_valid_s + self.config.stale_s, missing_s)
        elif self.link == "handshake":
            deadline = min(deadline, self._refused_until_s or self._now_s + DIAGNOSE_S)
        if self._capture is not None:
            deadline = min(deadline, self._capture.deadline_s)
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
        self.tell(kind, severity, text)
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

    def _who_is_there(self) -> str:
        identity = self.known.identity
        assert identity is not None
        f = identity.int
        return (
            f"Board {f('board_id')} at {self.port}, firmware {f('firmware_major')}.{f('firmware_minor')},"
            f" T_s {f('sample_time')} us, session {self.session.number}."
        )
