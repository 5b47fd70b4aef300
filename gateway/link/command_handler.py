"""Passes commands from the bus to one board, and the answers back.  No I/O.

Rule 1: every query is answered exactly once.  It is accepted, or refused by gateway, board or link (down, timed out,
        cancelled), or it fails by an error of the gateway (`internal-error`).
Rule 2: an id is executed at most once.  The replies of the last 256 ids, and of all of the last 20 s, are kept; the
        same command again gets the kept reply, which says until when.  The same id with other content is refused
        (`id-reused`).  A dated command expires before its id is discarded (access/authorize.py), so it is executed at
        most once in any case; an undated one at most once within one run of the gateway.
Rule 3: the refusals `link-down`, `flood`, `queue-full` and a time-out before a byte was sent are not kept.  Nothing was
        executed, so the sender may try again with the same id.
Rule 4: sender, time, content and result of every command are published as a CommandRecord.
Rule 5: on a guarded bus the sender (access/authorize.py) is written into the command, and its role and the command's
        age are checked first.  These refusals are not kept, so that senders without a right cannot fill the memory.
Rule 6: every STOP is sent to the board, whatever its id: used, pending, or absent.
Rule 7: a command to the board that was issued before the last STOP arrived is refused (`superseded-by-stop`), whenever
        it arrives.  Its date counts, or its arrival where it has none or a later date.  A command that was refused as
        `not-fresh` and is sent again with a new date counts by its first arrival.
"""

from __future__ import annotations

import logging
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass, field

from gateway.access.authorize import Sender
from gateway.board.limits import BoardView, Gate, bumpless, read_command
from gateway.board.scaling import Refusal, WireCommand, to_wire
from gateway.config import LimitsConfig
from gateway.link.annotations import KINDS, Annotations
from gateway.link.card_keeper import CardKeeper
from gateway.link.event_text import mode_name
from gateway.link.from_board import Known
from gateway.link.sink import Reply, Sink
from protocol.bus import board51_pb2 as pb
from protocol.wire.events import Answer
from protocol.wire.messages import Flag, Message, Mode, Reason
from protocol.wire.session import Session

RETAINED_IDS = 256
STALE_IDS = 256  # commands that were refused as not fresh and may come again with a new date
RETAINED_S = 20.0  # longer than a command is valid (access/authorize.py): none is executed twice
MAX_WAITING = 32  # commands that may wait for one board: at 0.5 s per time-out, more would expire in the queue

_NOT_RETAINED = (
    "flood", "queue-full", "id-reused", "not-allowed", "not-fresh", "not-available", "link-down", "internal-error",
)  # fmt: skip
_NO_PORT = ("absent", "connecting")
_logger = logging.getLogger("gateway.link")

_CANCELLED = {
    "stop": ("superseded-by-stop", "A STOP arrived. If the board already had this command, the STOP ended its effect."),
    "board-reset": ("board-reset", "The board restarted before it answered; whether it acted is unknown."),
    "disconnected": ("disconnected", "The port was lost before the board answered; whether it acted is unknown."),
}
_NACK_TEXT = {
    Reason.OUT_OF_RANGE: "a value is outside the board's bounds; the bound is {detail} counts",
    Reason.SLEW: "the jump of the reference is larger than the allowance of {detail} counts",
    Reason.WRONG_MODE: "this is not possible in mode {mode}",
    Reason.BUSY: "it is busy, probably with a capture",
    Reason.NO_SESSION: "it has restarted and does not know this gateway yet; try again",
    Reason.NOT_AVAILABLE: "there is nothing to read",
    Reason.FAULT_ACTIVE: "a fault is active; set a mode to clear it",
}


@dataclass(slots=True, kw_only=True)
class _Request:
    """A command and the callers that wait for its reply: several if it was repeated."""

    command: pb.Command
    received_ns: int
    replies: list[Reply]


@dataclass(slots=True, kw_only=True)
class _Pending:
    wire: WireCommand
    requests: list[_Request] = field(default_factory=list)  # several: STOPs that share a frame


@dataclass(slots=True)
class _Retained:
    content: bytes
    reply: pb.CommandReply
    at_ns: int


class CommandHandler:
    """Handles the commands of one board; the driver keeps `known` up to date.

    `accepted` is called with each command that the board accepted.
    """

    def __init__(
        self, limits: LimitsConfig, session: Session, known: Known, sink: Sink, accepted: Callable[[WireCommand], None]
    ) -> None:
        self.accepted_count = self.refused_count = self.timed_out_count = 0
        self.annotations, self.plant_card = Annotations(sink), CardKeeper(sink)
        self._gate = Gate(limits)
        self._session, self._known, self._sink, self._on_accepted = session, known, sink, accepted
        self._pending: dict[int, _Pending] = {}
        # In memory, not in a file: that would need an fsync before each command. After a restart the age of a dated
        # command protects from a second execution.
        self._retained: OrderedDict[str, _Retained] = OrderedDict()
        self._x_ref_m: float | None = None  # commanded, not yet seen in a state
        self._x_ref_tick: float = -1  # seen from this tick on
        self._mode_tick: float = -1
        self.stopped_s: float | None = None  # arrival of the last STOP, monotonic: the host's clock may step
        self._stale: OrderedDict[str, float] = OrderedDict()  # id -> first arrival of a command that was not fresh

    def take(
        self, payload: bytes, reply: Reply, now_s: float, host_ns: int, *, link: str, reason: str, sender: Sender
    ) -> None:
        """Handle one query.  `link` and `reason` describe the state of the link, for a refusal if it is down."""
        command, bad_form = read_command(payload)
        request = _Request(command=command, received_ns=host_ns, replies=[reply])
        sender.sign(command)
        if bad_form is not None:
            self._refuse(request, bad_form, keep=False)
            return
        try:
            refusal = self._decide(request, now_s, link, reason, sender)
        except Exception as error:  # an internal error fails this command, which still gets its answer and its record
            _logger.exception("a command")
            refusal = Refusal(
                "internal-error", f"An internal error of the gateway ({type(error).__name__}); its log has the details."
            )
        if refusal is not None:
            self._refuse(request, refusal, keep=refusal.reason not in _NOT_RETAINED)

    def _decide(self, request: _Request, now_s: float, link: str, reason: str, sender: Sender) -> Refusal | None:
        """Answer the command or pass it on; return the refusal if it is neither."""
        command = request.command
        not_allowed = sender.right(command)
        if not_allowed is not None:
            return not_allowed
        # Before the checks of id and date: a STOP with a used id or an old date must still stop the board.
        if command.WhichOneof("what") == "stop":
            # By its arrival, not by its own date: a STOP from a clock that is behind would count too early.
            self.stopped_s = max(self.stopped_s or 0.0, sender.arrived_s)  # also of a STOP that cannot be sent now
            return self._stop(request, now_s, link, reason)
        waiting = (r for pending in self._pending.values() for r in pending.requests)
        pending = next((r for r in waiting if r.command.id == command.id and not _is_stop(r.command)), None)
        retained = self._retained.get(command.id)
        if retained is not None or pending is not None:
            same = _content(command) == (
                retained.content if retained else _content(pending.command) if pending else b""
            )
            if not same:
                return Refusal("id-reused", "This id was used for another command; choose a new one.")
            if retained is not None:
                request.replies[0](retained.reply)
            elif pending is not None:
                pending.replies += request.replies
            return None
        refusal = sender.fresh(command)
        if refusal is not None:
            # The first arrival is kept: sent again with a new date, the command must not pass a STOP in between.
            self._stale.setdefault(command.id, sender.arrived_s)
            if len(self._stale) > STALE_IDS:
                self._stale.popitem(last=False)
            return refusal
        refusal = self._gate.admit(command, now_s)
        if refusal is not None:
            return refusal
        if self._session.waiting >= MAX_WAITING:
            return Refusal("queue-full", f"{MAX_WAITING} commands wait for this board already.")
        if command.WhichOneof("what") in (*KINDS, "set_plant"):
            return self._note(request)
        # No margin for clocks that are ahead: it would refuse every command in the time after a STOP, also where the
        # clocks agree.
        if self.stopped_s is not None and (before_s := self.stopped_s - self._issued_s(command, sender)) > 0:
            return Refusal(
                "superseded-by-stop",
                f"It was issued {before_s:.3f} s before the last STOP of this rig arrived, so it was not sent. If it is"
                " newer than the STOP, the clocks of its sender and of the gateway differ: set them.",
            )
        return self._carry_on(request, now_s, link, reason, sender.left_s(command))

    def answered(self, answer: Answer, host_ns: int) -> bool:
        """Process the outcome of a command; return False if the command did not come from the bus."""
        pending = self._pending.pop(answer.token, None)
        if pending is None:
            return False
        message, count, keep = answer.message, len(pending.requests), True
        reply = pb.CommandReply(attempts=answer.attempts)
        tick = -1
        if answer.outcome == "ack" and message is not None:
            tick = message.int("tick")
            reply.accepted, reply.tick, reply.text = True, tick, pending.wire.note
            self.accepted_count += count
        elif answer.outcome == "nack" and message is not None:
            reply.refused_by = "board"
            reply.reason, reply.text = _nack(message)
            self.refused_count += count
        elif answer.outcome == "timed-out":
            reply.refused_by, reply.reason = "link", "timed-out"
            reply.text = _timed_out(pending.wire.name, answer.attempts)
            # Before its first byte nothing can have acted, so the sender may try again with the same id.
            keep = answer.attempts > 0
            self.timed_out_count += count
        else:
            reply.refused_by = "link"
            reply.reason, reply.text = _CANCELLED[answer.why]
            self.refused_count += count
        for request in pending.requests:
            self._settle(request.command, tick)
            self._finish(request, reply, host_ns, keep=keep)
        if reply.accepted:
            self._on_accepted(pending.wire)
        return True

    def _issued_s(self, command: pb.Command, sender: Sender) -> float:
        """Return when a command was issued at the latest, monotonic, as far as the clocks of both agree."""
        age_s = max(0, sender.arrived_ns - (command.issued_ns or sender.arrived_ns)) * 1e-9
        return min(sender.arrived_s - age_s, self._stale.get(command.id, sender.arrived_s))

    def _stop(self, request: _Request, now_s: float, link: str, reason: str) -> Refusal | None:
        if link in _NO_PORT:
            return _down(link, reason)
        self._mode_tick = float("inf")
        token = self._session.submit("STOP", now_s)  # needs neither session nor scaling
        pending = self._pending.setdefault(token, _Pending(wire=WireCommand(name="STOP", values={})))
        pending.requests.append(request)
        return None

    def _carry_on(self, request: _Request, now_s: float, link: str, reason: str, left_s: float) -> Refusal | None:
        command, scaling, view = request.command, self._known.scaling, self._view()
        if not self._session.is_open or scaling is None:
            return _down(link, reason)
        whole = bumpless(command, view)
        wire = whole if isinstance(whole, Refusal) else to_wire(whole, scaling)
        refusal = self._gate.check_configured_range(command)
        if refusal is None:
            refusal = wire if isinstance(wire, Refusal) else self._gate.check(command, wire, view, now_s)
        if refusal is not None or isinstance(wire, Refusal):
            return refusal
        token = self._session.submit(wire.name, now_s, left_s, **wire.values)
        self._pending[token] = _Pending(wire=wire, requests=[request])
        self._gate.passed(command, view, now_s)
        if command.WhichOneof("what") == "set_reference":
            self._x_ref_m, self._x_ref_tick = command.set_reference.x_ref_m, float("inf")
        elif command.WhichOneof("what") == "set_mode":
            self._mode_tick = float("inf")
        return None

    def _note(self, request: _Request) -> Refusal | None:
        """Execute a command of the gateway itself, which does not need the board."""
        command, host_ns = request.command, request.received_ns
        tick = self._known.sample.tick if self._known.sample is not None else 0
        session = self._session.number if self._session.is_open else 0
        if command.WhichOneof("what") in KINDS:
            answer = self.annotations.take(command, host_ns, tick=tick, session=session)
        else:
            highest_m = self._known.highest_reference_m
            stated = self.plant_card.take(command, host_ns, tick=tick, session=session, highest_reference_m=highest_m)
            if isinstance(stated, Refusal):
                return stated
            answer = stated
        self.accepted_count += 1
        self._finish(request, answer, host_ns, keep=True)
        return None

    def _view(self) -> BoardView:
        sample, scaling, parameters = self._known.sample, self._known.scaling, self._known.parameters
        if parameters is not None and parameters.int("divider") == 0:
            sample = None  # the stream is off: the last state is out of date
        tick = -1 if sample is None else sample.tick
        x_ref_m = None
        if self._x_ref_tick > tick:
            x_ref_m = self._x_ref_m
        elif sample is not None and scaling is not None:
            x_ref_m = scaling.x_m(sample.state.x_ref)
        # Until a state shows the commanded mode, the mode is unknown: the last state may be from before the command.
        known_mode = sample is not None and self._mode_tick <= tick
        flags = sample.state.flags if sample is not None else 0
        return BoardView(
            mode=Mode(flags & 3) if known_mode else None,
            flags=flags & int(~Flag(0)) if known_mode else 0,
            x_ref_m=x_ref_m,
            u_c_v=scaling.u_v(sample.state.u_c) if sample is not None and scaling is not None else None,
            parameters=parameters,
            scaling=scaling,
        )

    def _settle(self, command: pb.Command, tick: int) -> None:
        if command.WhichOneof("what") == "set_reference":
            self._x_ref_tick = tick
        elif command.WhichOneof("what") in ("set_mode", "stop"):
            self._mode_tick = tick

    def session_ended(self) -> None:
        """Discard the commanded reference: after a new count of ticks it does not describe the board."""
        self._x_ref_tick = self._mode_tick = -1

    def _refuse(self, request: _Request, refusal: Refusal, *, keep: bool) -> None:
        self.refused_count += 1
        source = "link" if refusal.reason == "link-down" else "gateway"
        answer = pb.CommandReply(refused_by=source, reason=refusal.reason, text=refusal.text)
        self._finish(request, answer, request.received_ns, keep=keep)

    def _finish(self, request: _Request, outcome: pb.CommandReply, answered_ns: int, *, keep: bool) -> None:
        command, answer = request.command, pb.CommandReply()
        answer.CopyFrom(outcome)
        answer.id = command.id
        if keep and not _is_stop(command):
            answer.repeat_until_ns = answered_ns + round(RETAINED_S * 1e9)
            self._retained[command.id] = _Retained(_content(command), answer, answered_ns)
            while len(self._retained) > RETAINED_IDS:
                oldest = next(iter(self._retained.values()))
                if 0 <= answered_ns - oldest.at_ns < RETAINED_S * 1e9:
                    break
                self._retained.popitem(last=False)
        received_ns = request.received_ns
        record = pb.CommandRecord(received_ns=received_ns, answered_ns=answered_ns, command=command, reply=answer)
        self._sink.send("command/record", record, answered_ns)
        for reply in request.replies:
            reply(answer)


def _is_stop(command: pb.Command) -> bool:
    return bool(command.WhichOneof("what") == "stop")


def _down(link: str, reason: str) -> Refusal:
    return Refusal(
        "link-down",
        f"The board is not available ({link}: {reason})." if reason else f"The board is not available ({link}).",
    )


def _content(command: pb.Command) -> bytes:
    """Return the effect of a command, without sender and time: another program may repeat the command."""
    bare = pb.Command()
    bare.CopyFrom(command)
    bare.who, bare.role, bare.issued_ns, bare.valid_s = "", "", 0, 0.0
    return bare.SerializeToString(deterministic=True)


def _timed_out(name: str, attempts: int) -> str:
    if attempts:
        return (
            f"The board did not answer {attempts} attempts. Whether it acted is unknown, and it may still act"
            " when the line recovers."
        )
    if name == "STOP":
        return "The line accepts no bytes, and the coil may be on. The STOP is sent as soon as the line accepts bytes."
    return "The board does not answer. The command was not sent, so it has not acted and never will."


def _nack(message: Message) -> tuple[str, str]:
    reason, detail = Reason(message.int("reason")), message.int("detail")
    text = _NACK_TEXT.get(reason, "it does not accept this command").format(detail=detail, mode=mode_name(detail))
    return reason.name.lower().replace("_", "-"), f"The board refused: {text}."
