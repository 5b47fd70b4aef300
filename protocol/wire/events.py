"""Events that a `Session` reports about one board, in the order of their occurrence."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, NamedTuple

from protocol.wire.decoder import State
from protocol.wire.messages import EventCode, Message


class Sample(NamedTuple):
    """A state with its tick."""

    tick: int
    session: int
    lost_before: int  # ticks without a sample directly before it
    state: State
    arrived_s: float  # the caller's time of the read; earlier than neighbouring events if it waited for its successor


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
    """The count of ticks ends; the next `Opened` begins a new one.  `why` is 'tick' or 'no-session'.

    `doubtful` holds the first and last tick of the samples that may have wrong ticks.
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
    """The outcome of a submitted command.

    `message` is the board's answer (ack, nack); `why` is the reason of a cancellation: 'stop', 'board-reset',
    'disconnected'.
    """

    token: int
    outcome: Outcome
    attempts: int
    message: Message | None = None
    why: str = ""


Event = Sample | Opened | VersionRefused | Restarted | BoardEvent | Answer
