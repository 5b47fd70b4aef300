"""What a `Session` tells of one board, in the order in which it happened."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, NamedTuple

from protocol.wire.decoder import State
from protocol.wire.messages import EventCode, Message


class Sample(NamedTuple):
    """A state with its place in time."""

    tick: int
    session: int
    lost_before: int
    state: State
    arrived_s: float  # when it was read; earlier than the events around it where it had to wait for its successor


@dataclass(frozen=True, slots=True)
class Opened:
    """The board answered the handshake; commands are possible."""

    identity: Message
    session: int


@dataclass(frozen=True, slots=True)
class VersionRefused:
    """Host and board have no protocol version in common; the handshake has ended."""

    board_version: int


@dataclass(frozen=True, slots=True)
class Restarted:
    """The count of ticks ends here; `Opened` begins a new one.  `why`: 'tick', 'no-session'.

    `doubtful`: first and last tick of the samples that may have been given wrong ticks before this was found.
    """

    why: str
    board_reset: bool
    doubtful: tuple[int, int] | None = None


@dataclass(frozen=True, slots=True)
class BoardEvent:
    """An EVENT frame; `missed` events were lost directly before it."""

    tick: int
    code: EventCode
    detail: int
    missed: int


Outcome = Literal["ack", "nack", "timed-out", "cancelled"]


@dataclass(frozen=True, slots=True)
class Answer:
    """How a submitted command ended.

    `message` is the board's answer (ack, nack); `why` says what cancelled it: 'stop', 'board-reset', 'disconnected'.
    """

    token: int
    outcome: Outcome
    attempts: int
    message: Message | None = None
    why: str = ""


Event = Sample | Opened | VersionRefused | Restarted | BoardEvent | Answer
