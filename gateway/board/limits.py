"""Checks commands against the limits of gateway and board before they are sent.  Pure: the caller passes the time.

The board checks again.  This check may be stricter (configuration), and its refusals use the units of the web page
(lengths in mm).

Rule 1: STOP is never refused: not by rate, mode, bounds or form, as long as it can be decoded as a STOP.
Rule 2: every refusal has a stable kebab-case reason and a sentence.  Reasons: malformed, oversize, bad-id, bad-who,
        empty-command, not-finite, out-of-range, slew, wrong-mode, fault-active, flood, queue-full, not-available.
Rule 3: the stricter of the bounds of configuration and board applies.
Rule 4: the reference has an allowance, as on the board (protocol/README.md, rule 7).  It is `x_ref_step_m` at most,
        refills at `x_ref_slew_m_s`, and is used up by each accepted jump.
Rule 5: ending an excitation requires only its mode: no bound prevents it, and the signal does not jump.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

from google.protobuf.message import Message as ProtoMessage

from gateway.board.reference import SLACK
from gateway.board.scaling import Refusal, Scaling, WireCommand, measured
from protocol.bus import board51_pb2 as pb
from protocol.bus.encoding import parse
from protocol.wire.messages import Flag, Message, Mode

if TYPE_CHECKING:  # pydantic takes long to import: the commands of clients need it not
    from gateway.config import LimitsConfig

MAX_PAYLOAD = 4096  # bytes; the largest sensible command has about 200
MAX_STOP = 65536  # bytes that are searched for a STOP, the largest payload that the router of a guarded bus passes
MAX_ID = 128
MAX_WHO = 128
MAX_TEXT = 200  # characters of a remark, of a comment
MAX_ALARM = 64
MAX_SHELVE_S = 86400.0


@dataclass(frozen=True, slots=True, kw_only=True)
class BoardView:
    """The current state of the board as needed for the checks; None where it is not known."""

    mode: Mode | None
    flags: int
    x_ref_m: float | None  # in force, or commanded and not yet visible
    u_c_v: float | None  # in force
    parameters: Message | None  # PARAMETERS, counts
    scaling: Scaling | None = None  # of them


def read_command(payload: bytes) -> tuple[pb.Command, Refusal | None]:
    """Decode the command in a query and check its form; the command is empty if it cannot be decoded."""
    command = parse(pb.Command, payload) if len(payload) <= MAX_STOP else None
    if command is not None and command.WhichOneof("what") == "stop":
        # A STOP is accepted despite other errors; texts that are too long are cut for the record.
        return pb.Command(
            id=command.id[:MAX_ID], who=command.who[:MAX_WHO], issued_ns=command.issued_ns, stop=pb.Stop()
        ), None
    if len(payload) > MAX_PAYLOAD:
        text = f"The payload has {len(payload)} bytes; a command has at most {MAX_PAYLOAD}."
        return pb.Command(), Refusal("oversize", text)
    if command is None:
        return pb.Command(), Refusal("malformed", "The payload is not a board51.v1.Command in protobuf.")
    return command, _form(command)


def _form(command: pb.Command) -> Refusal | None:
    if not 0 < len(command.id) <= MAX_ID:
        return Refusal(
            "bad-id", f"The id has {len(command.id)} characters; choose 1 to {MAX_ID}, new for each command."
        )
    if len(command.who) > MAX_WHO:
        return Refusal("bad-who", f"The who has {len(command.who)} characters; at most {MAX_WHO}.")
    for what, text in (("remark", command.mark.text), ("comment", command.acknowledge.comment)):
        if len(text) > MAX_TEXT:
            return Refusal("oversize", f"The {what} has {len(text)} characters; at most {MAX_TEXT}.")
    if command.WhichOneof("what") == "acknowledge" and not 0 < len(command.acknowledge.alarm) <= MAX_ALARM:
        text = f"An alarm's name has 1 to {MAX_ALARM} characters, not {len(command.acknowledge.alarm)}."
        return Refusal("malformed", text)
    if not 0.0 <= command.acknowledge.shelve_s <= MAX_SHELVE_S:
        return Refusal("out-of-range", f"An alarm can be shelved for 0 to {MAX_SHELVE_S:g} s.")
    if command.WhichOneof("what") is None:
        return Refusal("empty-command", "The command has no action, or one that this gateway does not know.")
    wrong = next((name for name, value in _numbers(command) if not math.isfinite(value)), None)
    return None if wrong is None else Refusal("not-finite", f"{wrong} is not a finite number.")


def _numbers(message: ProtoMessage, path: str = "") -> Iterator[tuple[str, float]]:
    for field, value in message.ListFields():
        name = f"{path}{field.name}"
        if isinstance(value, ProtoMessage):
            yield from _numbers(value, name + ".")
        elif field.cpp_type == field.CPPTYPE_DOUBLE:
            values = [value] if isinstance(value, float) else value
            yield from ((name, v) for v in values)


def ends_excitation(command: pb.Command) -> bool:
    """Return whether a command ends an excitation: shape none, except on u_c with an offset, which sets a level."""
    excite = command.excite
    none = command.WhichOneof("what") == "excite" and excite.shape == pb.SHAPE_NONE
    return none and (excite.on_reference or not excite.HasField("offset"))


def bumpless(command: pb.Command, board: BoardView) -> pb.Command | Refusal:
    """Return `command`; if it ends an excitation, with the current level as its offset, so that nothing jumps."""
    if not ends_excitation(command):
        return command
    closed = board.mode == Mode.CLOSED_LOOP
    level = board.x_ref_m if closed else board.u_c_v
    if board.mode is None or level is None:
        text = "The current value of the signal is not known yet: try again, or end it with a reference or a mode."
        return Refusal("not-available", text)
    return pb.Command(excite=pb.Excite(shape=pb.SHAPE_NONE, on_reference=closed, offset=level))


class TokenBucket:
    """An allowance of at most `size`, refilled at `rate` per second; full at the start."""

    def __init__(self, size: float, rate: float) -> None:
        self._size, self._rate = size, rate
        self._level, self._at_s = size, -math.inf

    def level(self, now_s: float) -> float:
        """Return the amount available at `now_s`."""
        return min(self._size, self._level + self._rate * (now_s - self._at_s))

    def wait_s(self, amount: float, now_s: float) -> float:
        """Return the time until `amount` is available, s."""
        return max(0.0, (amount - self.level(now_s)) / self._rate)

    def take(self, amount: float, now_s: float) -> None:
        """Take `amount`; what exceeds the level is a debt, and a negative amount is given back."""
        self._level, self._at_s = self.level(now_s) - amount, now_s


class Gate:
    """The limits of one board.  Call `check` for each command, and `passed` for each command that is sent."""

    def __init__(self, limits: LimitsConfig) -> None:
        self._limits = limits
        self._commands = TokenBucket(max(1.0, limits.commands_per_s), limits.commands_per_s)
        self._jumps = TokenBucket(limits.x_ref_step_m, limits.x_ref_slew_m_s)

    def admit(self, command: pb.Command, now_s: float) -> Refusal | None:
        """Limit the rate of commands: every command except STOP counts, refused or not."""
        if command.WhichOneof("what") == "stop":
            return None
        if self._commands.level(now_s) < 1.0:
            return Refusal(
                "flood", f"More than {self._limits.commands_per_s:g} commands per second; only STOP is exempt."
            )
        self._commands.take(1.0, now_s)
        return None

    def check(self, command: pb.Command, wire: WireCommand, board: BoardView, now_s: float) -> Refusal | None:
        """Return the refusal of a command, or None if it may be sent to the board."""
        match command.WhichOneof("what"):
            case "set_reference":
                return self.check_configured_range(command) or self._reference(
                    command.set_reference.x_ref_m, wire, board, now_s
                )
            case "set_gains":
                return self._gains(command.set_gains)
            case "excite":
                if ends_excitation(command):
                    return _needs(board, command)
                return _needs(board, command) or self._excite(command.excite, wire, board)
            case "capture":
                return _needs(board, command) or self._capture(command.capture, wire, board)
            case "set_host_loss":
                return self._host_loss(command.set_host_loss.timeout_s)
        return None

    def check_configured_range(self, command: pb.Command) -> Refusal | None:
        """Check the configured bounds only; called before conversion to counts, whose range differs."""
        if command.WhichOneof("what") != "set_reference":
            return None
        limits = self._limits
        return _within(command.set_reference.x_ref_m, limits.x_ref_min_m, limits.x_ref_max_m, "x_ref", "m")

    def passed(self, command: pb.Command, board: BoardView, now_s: float) -> None:
        """Update the allowances for a command that is sent to the board."""
        if command.WhichOneof("what") == "set_reference" and board.x_ref_m is not None:
            self._jumps.take(abs(command.set_reference.x_ref_m - board.x_ref_m), now_s)

    def _reference(self, x_ref_m: float, wire: WireCommand, board: BoardView, now_s: float) -> Refusal | None:
        limits = self._limits
        refusal = _on_board(int(wire.values["x_ref"]), "x_ref_min", "x_ref_max", "x_ref", "m", board)
        if refusal is not None or board.x_ref_m is None:
            return refusal
        jump, allowed = abs(x_ref_m - board.x_ref_m), self._jumps.level(now_s)
        if jump > allowed:
            return Refusal(
                "slew",
                f"The jump of {jump * 1e3:.3g} mm from {board.x_ref_m * 1e3:.4g} mm is larger than the"
                f" {allowed * 1e3:.3g} mm allowed now; the allowance refills at {limits.x_ref_slew_m_s * 1e3:g} mm/s"
                f" up to {limits.x_ref_step_m * 1e3:g} mm.",
            )
        return None

    def _gains(self, gains: pb.SetGains) -> Refusal | None:
        for n, gain in enumerate(gains.gains, 1):
            if abs(gain) > self._limits.gain_max:
                return Refusal("out-of-range", f"Gain {n} = {gain:g} is above gain_max {self._limits.gain_max:g}.")
        return None

    def _excite(self, excite: pb.Excite, wire: WireCommand, board: BoardView) -> Refusal | None:
        limits, longest_s = self._limits, self._limits.excitation_max_s
        if longest_s and excite.shape != pb.SHAPE_NONE and not 0 < excite.duration_s <= longest_s:
            supplied = f"A duration of {excite.duration_s:g} s" if excite.duration_s else "A duration of 0 s, endless,"
            return Refusal("out-of-range", f"{supplied} is outside the gateway's limit, up to {longest_s:g} s.")
        low, high = excite.offset - abs(excite.amplitude), excite.offset + abs(excite.amplitude)
        offset, amplitude = int(wire.values["offset"]), abs(int(wire.values["amplitude"]))
        if excite.on_reference:
            refusal = _within(low, limits.x_ref_min_m, limits.x_ref_max_m, "the lowest x_ref", "m")
            refusal = refusal or _within(high, limits.x_ref_min_m, limits.x_ref_max_m, "the highest x_ref", "m")
            bounds = ("x_ref_min", "x_ref_max")
            unit = "m"
        else:
            refusal = _within(high, -math.inf, limits.u_max_v, "the highest u_c", "V")
            bounds = ("", "u_max")
            unit = "V"
        for count in (offset - amplitude, offset + amplitude):
            refusal = refusal or _on_board(count, *bounds, "offset -+ amplitude", unit, board)
        return refusal

    def _host_loss(self, timeout_s: float) -> Refusal | None:
        shortest_s = self._limits.host_loss_min_s
        if timeout_s >= shortest_s:
            return None
        return Refusal(
            "out-of-range",
            f"A host-loss time-out of {timeout_s:g} s is below host_loss_min_s {shortest_s:g} s. On a busy computer the"
            " gateway is sometimes silent for longer, and the board would act. If this computer is never late, its"
            " configuration may set a smaller limit.",
        )

    def _capture(self, capture: pb.Capture, wire: WireCommand, board: BoardView) -> Refusal | None:
        for name, value in (("u_from", capture.u_from_v), ("u_to", capture.u_to_v)):
            refusal = _within(value, -math.inf, self._limits.u_max_v, name, "V")
            refusal = refusal or _on_board(int(wire.values[name]), "", "u_max", name, "V", board)
            if refusal is not None:
                return refusal
        return None


def _within(value: float, low: float, high: float, what: str, unit: str) -> Refusal | None:
    if low - SLACK <= value <= high + SLACK:
        return None
    highest = measured(high, unit)
    bounds = f"{measured(low, unit)} .. {highest}" if math.isfinite(low) else f"at most {highest}"
    return Refusal("out-of-range", f"{what} = {measured(value, unit)} is outside the gateway's limits, {bounds}.")


def _on_board(count: int, low: str, high: str, what: str, unit: str, board: BoardView) -> Refusal | None:
    """Check a value in counts against the bounds in PARAMETERS; an empty `low` means 0."""
    if board.parameters is None:
        return None  # the board checks itself
    lowest, highest = board.parameters.int(low) if low else 0, board.parameters.int(high)
    if lowest <= count <= highest:
        return None

    def with_unit(counts: int) -> str:
        s = board.scaling
        if s is None:
            return f"{counts} counts"
        return measured(s.x_m(counts) if unit == "m" else s.u_v(counts), unit)

    bounds = f"{with_unit(lowest)} .. {with_unit(highest)}"
    return Refusal("out-of-range", f"{what} = {with_unit(count)} is outside the board's limits, {bounds}.")


def _needs(board: BoardView, command: pb.Command) -> Refusal | None:
    if board.mode is None:
        return None  # no state yet: the board checks itself
    if board.flags & Flag.FAULT:
        return Refusal("fault-active", "A fault is active; set a mode first to clear it.")
    good: tuple[Mode, ...]
    if command.WhichOneof("what") == "capture":
        good = (Mode.IDLE, Mode.OPEN_LOOP)
    elif ends_excitation(command):
        good = (Mode.OPEN_LOOP, Mode.CLOSED_LOOP)
    else:
        good = (Mode.CLOSED_LOOP,) if command.excite.on_reference else (Mode.OPEN_LOOP,)
    if board.mode in good:
        return None
    names = " or ".join(mode.name.lower().replace("_", " ") for mode in good)
    return Refusal(
        "wrong-mode", f"This needs mode {names}; the board is in {board.mode.name.lower().replace('_', ' ')}."
    )
