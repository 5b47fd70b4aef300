"""Authorisation of commands, before the limits of the board are checked.  No I/O.

On a guarded bus the router has authenticated the sender, whose role and name are in the key (`topics.command_key`).
This module checks the role, the age of the command and the sender's rate.  On a bus that is not guarded there are no
roles and a command may have no date; a date is checked in the same way.

Rule 1: STOP needs a role only.  Neither its date nor the rate is checked: a wrong clock must not keep the coil on.
Rule 2: a command is valid for MAX_AGE_S after it was issued, or for `valid_s` if that is less.  The command handler
        stores ids for longer than that, so that a repeated command is executed once.  A command that may have been
        issued before this gateway's start is refused, because the previous gateway may have executed it.
Rule 3: the clocks of sender and gateway may differ by MAX_AHEAD_S.
"""

from __future__ import annotations

import math
import threading
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass, replace

from gateway.access.roles import ROLE_WORDS, Role, may, refusal_text
from gateway.board.limits import TokenBucket
from gateway.board.scaling import Refusal
from protocol.bus import board51_pb2 as pb
from protocol.bus import topics

MAX_AGE_S = 10.0
MAX_AHEAD_S = 1.0
COMMANDS_PER_S = 100.0  # of one sender to all boards; the boards' own limits are lower
BURST = 200.0
MAX_SENDERS = 256  # names in memory; the views' account may send under any name
_REPORT_S = 1.0  # between two events about a flood of one sender


@dataclass(frozen=True, slots=True, kw_only=True)
class Sender:
    """The sender of a command: on a guarded bus authenticated by the router, otherwise unknown."""

    name: str
    role: Role | None  # None: the bus is not guarded
    arrived_ns: int  # Unix time
    arrived_s: float  # the same moment, by the monotonic clock
    started_ns: int  # of this gateway

    def sign(self, command: pb.Command) -> None:
        """Overwrite `who` and `role` of the command; on a bus that is not guarded, `who` stays and `role` is empty."""
        command.role = ""
        if self.role is not None:
            command.who, command.role = self.name, self.role.word

    def right(self, command: pb.Command) -> Refusal | None:
        """Check the role; None if it suffices."""
        act = command.WhichOneof("what") or ""
        if self.role is None or may(self.role, act):
            return None
        return Refusal("not-allowed", refusal_text(self.name, self.role, act))

    def left_s(self, command: pb.Command) -> float:
        """Return the remaining time in which the command may begin to act, s; infinite without a date."""
        if not command.issued_ns:
            return math.inf
        valid_s = min(command.valid_s or MAX_AGE_S, MAX_AGE_S)
        return valid_s - (self.arrived_ns - command.issued_ns) * 1e-9

    def fresh(self, command: pb.Command) -> Refusal | None:
        """Check the date of the command; None if it is still valid."""
        if command.WhichOneof("what") == "stop":
            return None
        if not command.issued_ns:
            if self.role is None:
                return None
            text = "On a guarded bus a command must state when it was issued (issued_ns, Unix time)."
            return Refusal("not-fresh", text)
        age_s = (self.arrived_ns - command.issued_ns) * 1e-9
        if age_s < -MAX_AHEAD_S or self.left_s(command) < 0:
            valid_s = self.left_s(command) + age_s
            when = f"{age_s:.1f} s ago" if age_s > 0 else f"{-age_s:.1f} s in the future"
            text = f"The command was issued {when}; it is valid for {valid_s:g} s. If it is not a repeated old one,"
            return Refusal("not-fresh", f"{text} the clocks of its sender and of the gateway differ: set them.")
        if command.issued_ns < self.started_ns + MAX_AHEAD_S * 1e9:
            text = "The command may be older than this gateway, which has just started: send a new one."
            return Refusal("not-fresh", text)
        return None


class Authorizer:
    """Authorisation of one gateway; thread-safe.

    `on_flood` is called with sender and number of refused commands, at most once a second for each sender.
    """

    def __init__(self, started_ns: int, on_flood: Callable[[str, int], None], *, guarded: bool = True) -> None:
        self.guarded = guarded
        self._started_ns, self._on_flood = started_ns, on_flood
        self._lock = threading.Lock()
        self._floods: OrderedDict[str, _Flood] = OrderedDict()

    def clock_stepped(self, step_ns: int) -> None:
        """Correct the time of the gateway's start after a step of the host's clock."""
        self._started_ns += step_ns

    def sender(self, key: str, arrived_ns: int, arrived_s: float) -> Sender | Refusal:
        """Return the sender of a command with this key, or a refusal."""
        unknown = Sender(name="", role=None, arrived_ns=arrived_ns, arrived_s=arrived_s, started_ns=self._started_ns)
        if not self.guarded:
            return unknown
        role_and_name = topics.sender(key)
        if role_and_name is None or role_and_name[0] not in ROLE_WORDS:
            text = f"On this bus a command goes under .../command/as/ROLE/NAME, not under {key[-100:]}."
            return Refusal("not-allowed", text)
        role, name = role_and_name
        return replace(unknown, name=name, role=Role[role.upper()])

    def flooded(self, sender: Sender, now_s: float) -> bool:
        """Count a command of the sender; True if its rate is exceeded.  Not for STOP."""
        assert self.guarded
        with self._lock:
            flood = self._floods.get(sender.name)
            if flood is None:
                flood = self._floods[sender.name] = _Flood(TokenBucket(BURST, COMMANDS_PER_S))
                if len(self._floods) > MAX_SENDERS:
                    self._floods.popitem(last=False)
            self._floods.move_to_end(sender.name)
            if flood.bucket.level(now_s) >= 1.0:
                flood.bucket.take(1.0, now_s)
                return False
            flood.refused += 1
            refused = flood.refused
            if report := now_s - flood.reported_s >= _REPORT_S:
                flood.refused, flood.reported_s = 0, now_s
        if report:
            self._on_flood(sender.name, refused)
        return True


@dataclass(slots=True)
class _Flood:
    bucket: TokenBucket
    refused: int = 0
    reported_s: float = float("-inf")
