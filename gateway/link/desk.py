"""Commands from the bus on their way to one board, and the answers on their way back.  No I/O.

Rule 1: every query is answered, once: refused by gateway, board or link (down, timed out, cancelled).
Rule 2: an id is executed at most once.  The replies of the last 256 ids, and of all of the last 20 s, are kept; the
        same command again gets the kept reply.  The same id with other content is refused (`id-reused`): "accepted"
        would be a lie.
Rule 3: `link-down`, `flood` and `queue-full` are not kept: nothing was executed, and trying again with the same id is
        just what the sender should do.
Rule 4: who, when, what and result of every command go out as CommandRecord.
Rule 5: on a guarded bus the sender (access/doorkeeper.py) is written into the command, and its role and the command's
        age are judged first.  What is refused for these is not kept: nobody fills the memory without a right.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass, field

from gateway.access.doorkeeper import Sender
from gateway.config import LimitsConfig
from gateway.limits import BoardView, Gate, read_command
from gateway.link.notes import KINDS, Notes
from gateway.link.outlet import Outlet, Reply
from gateway.link.words import mode_name
from gateway.samples import Refusal, Scaling, WireCommand, to_wire
from protocol.bus import board51_pb2 as pb
from protocol.wire.events import Answer, Sample
from protocol.wire.messages import Flag, Message, Mode, Reason
from protocol.wire.session import Session

KEPT_IDS = 256
KEPT_S = 20.0  # longer than a command is fresh (access/doorkeeper.py): no bytes are executed twice
MAX_WAITING = 32  # commands on their way to one board: at 0.5 s per time-out, a queue beyond it is not worth joining

_NOT_KEPT = ("flood", "queue-full", "id-reused", "not-allowed", "not-fresh")

_CANCELLED = {
    "stop": ("superseded-by-stop", "A STOP came; if the board had this command already, STOP ended what it began."),
    "board-reset": ("board-reset", "The board restarted while this was under way; whether it acted is unknown."),
    "disconnected": ("disconnected", "The port went away while this was under way; whether it acted is unknown."),
}
_NACK_TEXT = {
    Reason.OUT_OF_RANGE: "a value is outside the board's bounds; the bound in the way is {detail} counts",
    Reason.SLEW: "the jump of the reference is larger than the allowance of {detail} counts",
    Reason.WRONG_MODE: "this is not possible in mode {mode}",
    Reason.BUSY: "it is busy, probably with a capture",
    Reason.NO_SESSION: "it has restarted and does not know this gateway yet; try again",
    Reason.NOT_AVAILABLE: "there is nothing to read",
    Reason.FAULT_ACTIVE: "a fault is active; set a mode to clear it",
}


@dataclass(slots=True)
class Known:
    """What the board has said in this session."""

    identity: Message | None = None
    scaling: Scaling | None = None
    parameters: Message | None = None
    sample: Sample | None = None


@dataclass(slots=True, kw_only=True)
class _Pending:
    command: pb.Command
    wire: WireCommand
    received_ns: int
    replies: list[Reply] = field(default_factory=list)


@dataclass(slots=True)
class _Kept:
    content: bytes
    reply: pb.CommandReply
    at_ns: int


class CommandDesk:
    """The commands of one board.

    Args:
        limits: of this board.
        session: where accepted commands go.
        known: what the board has said; the driver keeps it up to date.
        outlet: for the records.
        accepted: called with wire command, bus command and ACK of what the board accepted.
    """

    def __init__(
        self,
        limits: LimitsConfig,
        session: Session,
        known: Known,
        outlet: Outlet,
        accepted: Callable[[WireCommand, pb.Command, Message], None],
    ) -> None:
        self.accepted_count = self.refused_count = self.timed_out_count = 0
        self.notes = Notes(outlet)
        self._gate = Gate(limits)
        self._session, self._known, self._outlet, self._on_accepted = session, known, outlet, accepted
        self._pending: dict[int, _Pending] = {}
        self._kept: OrderedDict[str, _Kept] = OrderedDict()
        self._x_ref_m: float | None = None  # commanded, not yet seen in a state
        self._x_ref_tick: float = -1  # seen from this tick on
        self._mode_tick: float = -1

    def take(
        self,
        payload: bytes,
        reply: Reply,
        now_s: float,
        host_ns: int,
        *,
        link: str,
        reason: str,
        sender: Sender | None = None,
    ) -> None:
        """One query.  `link` and `reason` say how the link is, for the case that it is down."""
        command = read_command(payload)
        if isinstance(command, Refusal):
            unreadable = pb.Command()
            if sender is not None:
                sender.sign(unreadable)
            self._refuse(unreadable, command, reply, host_ns)
            return
        command.role = ""
        if sender is not None:
            sender.sign(command)
            not_allowed = sender.right(command)
            if not_allowed is not None:
                self._refuse(command, not_allowed, reply, host_ns)
                return
        kept = self._kept.get(command.id)
        pending = next((p for p in self._pending.values() if p.command.id == command.id), None)
        if kept is not None or pending is not None:
            same = _content(command) == (kept.content if kept else _content(pending.command) if pending else b"")
            if not same:
                self._refuse(
                    command,
                    Refusal("id-reused", "This id was used for another command; choose a new one."),
                    reply,
                    host_ns,
                )
            elif kept is not None:
                reply(kept.reply)
            elif pending is not None:
                pending.replies.append(reply)
            return
        refusal = (sender.fresh(command) if sender is not None else None) or self._gate.admit(command, now_s)
        if refusal is None and self._session.waiting >= MAX_WAITING and command.WhichOneof("what") != "stop":
            refusal = Refusal("queue-full", f"{MAX_WAITING} commands wait for this board already.")
        if refusal is not None:
            self._refuse(command, refusal, reply, host_ns)
        elif command.WhichOneof("what") in KINDS:
            self._note(command, reply, host_ns)
        else:
            self._carry_on(command, reply, now_s, host_ns, link, reason)

    def answered(self, answer: Answer, host_ns: int) -> bool:
        """Take the end of a command; False if it is not one of the bus."""
        pending = self._pending.pop(answer.token, None)
        if pending is None:
            return False
        message = answer.message
        reply = pb.CommandReply(id=pending.command.id, attempts=answer.attempts)
        if answer.outcome == "ack" and message is not None:
            reply.accepted, reply.tick, reply.text = True, message.int("tick"), pending.wire.note
            self.accepted_count += 1
            self._settle(pending.command, message.int("tick"))
            self._on_accepted(pending.wire, pending.command, message)
        elif answer.outcome == "nack" and message is not None:
            reply.refused_by = "board"
            reply.reason, reply.text = _nack(message)
            self.refused_count += 1
            self._settle(pending.command, -1)
        elif answer.outcome == "timed-out":
            reply.refused_by, reply.reason = "link", "timed-out"
            reply.text = f"The board did not answer {answer.attempts} attempts; whether it acted is unknown."
            self.timed_out_count += 1
            self._settle(pending.command, -1)
        else:
            reply.refused_by = "link"
            reply.reason, reply.text = _CANCELLED[answer.why]
            self.refused_count += 1
            self._settle(pending.command, -1)
        self._finish(pending.command, reply, pending.replies, pending.received_ns, host_ns, keep=True)
        return True

    def _carry_on(self, command: pb.Command, reply: Reply, now_s: float, host_ns: int, link: str, reason: str) -> None:
        stop = command.WhichOneof("what") == "stop"
        scaling = self._known.scaling
        if stop and link in ("handshake", "streaming", "silent"):
            wire: WireCommand | Refusal = WireCommand(name="STOP", values={})  # needs neither session nor scaling
        elif not self._session.is_open or scaling is None:
            text = f"The board is not there ({link}: {reason})." if reason else f"The board is not there ({link})."
            self._finish(
                command,
                pb.CommandReply(id=command.id, refused_by="link", reason="link-down", text=text),
                [reply],
                host_ns,
                host_ns,
                keep=False,
            )
            self.refused_count += 1
            return
        else:
            wire = to_wire(command, scaling)
        view = self._view()
        refusal = wire if isinstance(wire, Refusal) else self._gate.check(command, wire, view, now_s)
        if refusal is not None or isinstance(wire, Refusal):
            assert refusal is not None
            self._refuse(command, refusal, reply, host_ns)
            return
        self._gate.passed(command, view, now_s)
        if command.WhichOneof("what") == "set_reference":
            self._x_ref_m, self._x_ref_tick = command.set_reference.x_ref_m, float("inf")
        elif command.WhichOneof("what") in ("set_mode", "stop"):
            self._mode_tick = float("inf")
        token = self._session.submit(wire.name, now_s, **wire.values)
        self._pending[token] = _Pending(command=command, wire=wire, received_ns=host_ns, replies=[reply])

    def _note(self, command: pb.Command, reply: Reply, host_ns: int) -> None:
        """What the gateway itself does; the board need not be there."""
        tick = self._known.sample.tick if self._known.sample is not None else 0
        session = self._session.number if self._session.is_open else 0
        answer = self.notes.take(command, host_ns, tick=tick, session=session)
        self.accepted_count += 1
        self._finish(command, answer, [reply], host_ns, host_ns, keep=True)

    def _view(self) -> BoardView:
        sample, scaling, parameters = self._known.sample, self._known.scaling, self._known.parameters
        if parameters is not None and parameters.int("divider") == 0:
            sample = None  # the stream is off: the last state tells nothing about now
        tick = -1 if sample is None else sample.tick
        x_ref_m = None
        if self._x_ref_tick > tick:
            x_ref_m = self._x_ref_m
        elif sample is not None and scaling is not None:
            x_ref_m = scaling.x_m(sample.state.x_ref)
        known_mode = sample is not None and self._mode_tick <= tick
        flags = sample.state.flags if sample is not None else 0
        return BoardView(
            mode=Mode(flags & 3) if known_mode else None,
            flags=flags & int(~Flag(0)) if known_mode else 0,
            x_ref_m=x_ref_m,
            parameters=parameters,
        )

    def _settle(self, command: pb.Command, tick: int) -> None:
        if command.WhichOneof("what") == "set_reference":
            self._x_ref_tick = tick
        elif command.WhichOneof("what") in ("set_mode", "stop"):
            self._mode_tick = tick

    def session_ended(self) -> None:
        """The count of ticks begins anew: what was commanded before says nothing about the board now."""
        self._x_ref_tick = self._mode_tick = -1

    def _refuse(self, command: pb.Command, refusal: Refusal, reply: Reply, host_ns: int) -> None:
        self.refused_count += 1
        answer = pb.CommandReply(id=command.id, refused_by="gateway", reason=refusal.reason, text=refusal.text)
        keep = bool(command.id) and refusal.reason not in _NOT_KEPT
        self._finish(command, answer, [reply], host_ns, host_ns, keep=keep)

    def _finish(
        self,
        command: pb.Command,
        answer: pb.CommandReply,
        replies: list[Reply],
        received_ns: int,
        answered_ns: int,
        *,
        keep: bool,
    ) -> None:
        for reply in replies:
            reply(answer)
        record = pb.CommandRecord(received_ns=received_ns, answered_ns=answered_ns, command=command, reply=answer)
        self._outlet.send("command/record", record, answered_ns)
        if keep:
            self._kept[command.id] = _Kept(_content(command), answer, answered_ns)
            while len(self._kept) > KEPT_IDS:
                oldest = next(iter(self._kept.values()))
                if 0 <= answered_ns - oldest.at_ns < KEPT_S * 1e9:
                    break
                self._kept.popitem(last=False)


def _content(command: pb.Command) -> bytes:
    """What the command does: two senders may carry the same id on behalf of each other, so not who, nor when."""
    bare = pb.Command()
    bare.CopyFrom(command)
    bare.who, bare.role, bare.issued_ns = "", "", 0
    return bare.SerializeToString(deterministic=True)


def _nack(message: Message) -> tuple[str, str]:
    reason, detail = Reason(message.int("reason")), message.int("detail")
    text = _NACK_TEXT.get(reason, "it does not take this command").format(detail=detail, mode=mode_name(detail))
    return reason.name.lower().replace("_", "-"), f"The board refused: {text}."
