"""The state of one board as a view sees it: latest messages with their age, alarms, events, commands and bins.

Filled by `Feed`, whose lock it shares.
"""

from __future__ import annotations

import math
import threading
import time
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Protocol, TypeVar

from google.protobuf.message import Message

from gateway.board.conditions import LINK
from gateway.views.alarms import Alarm, AlarmBook, Entry
from gateway.views.decimate import TopicBins
from protocol.bus import board51_pb2 as pb

M = TypeVar("M", bound=Message)
T = TypeVar("T")

RETAINED_EVENTS = 200
SILENT_S = 0.5  # a board without a state for this time (and three of its periods) is not live
GRACE_S = 2.0  # no alarm while a board is being discovered
GATEWAY_S = 3.5  # status comes once a second: without it, three times over, there is no gateway
UNSEEN_S = 120.0  # a board without any message for this time may be removed
TWIN_TIMEOUT_S = 12.0  # `twin/alarms` comes every 5 s: without it twice over, there is no twin
_OF_GATEWAY = (pb.Status, pb.Event, pb.State)  # while one of them comes, there is a gateway
_REASONS = {
    "absent": "Its port is missing.",
    "silent": "The board sends nothing.",
    "connecting": "The port is being opened.",
    "handshake": "The board has not answered yet.",
}


@dataclass(frozen=True, slots=True, kw_only=True)
class Link:
    """The state of the link: whether samples arrive, and if not, why.

    `state`: "live"; of the gateway "connecting", "handshake", "streaming" (but its samples do not reach this view),
    "silent", "absent"; "no-gateway" where nothing at all comes.
    """

    state: str
    reason: str  # a sentence; empty where live
    age_s: float  # of the newest sample; infinite where none came

    @property
    def live(self) -> bool:
        """Return whether samples arrive."""
        return self.state == "live"


class Tap(Protocol):
    """Takes every message of one type."""

    def push(self, message: Any) -> None:
        """Take a message; called with the feed's lock, by the thread that receives."""


class BoardFeed:
    """Messages of one board on the bus."""

    def __init__(
        self, name: str, lock: threading.Lock, now_s: Callable[[], float], *, replay_pass: int | None = None
    ) -> None:
        self.name = name
        self.replay_pass = replay_pass  # None: it is live.  The silence of a replay is a pause, and no alarm
        self._lock, self._now_s = lock, now_s
        self._latest: dict[str, Message] = {}
        self._at_s: dict[str, float] = {}
        self._events: deque[pb.Event] = deque(maxlen=RETAINED_EVENTS)
        self._commands: deque[pb.CommandRecord] = deque(maxlen=RETAINED_EVENTS)
        self._taps: dict[str, list[Tap]] = {}
        self._companions: dict[Callable[[BoardFeed], object], Any] = {}
        self._book = AlarmBook(name)
        self.alive = True  # the gateway's token, before any time-out; until one was seen, its absence says nothing
        self._period_s = 0.0
        self._first_s = now_s()
        self._back_s = self._first_s  # the gateway came, or came back
        self._heard_s = -math.inf  # when its newest message came
        self.stopped_s = -math.inf  # when the last STOP was seen, whoever sent it

    def latest(self, message: type[M]) -> M | None:
        """Return the newest message of this type, or None."""
        newest = self._latest.get(message.DESCRIPTOR.full_name)
        return newest if isinstance(newest, message) else None

    def age_s(self, message: type[Message]) -> float:
        """Return the age of the newest message of this type, s; infinite if there is none."""
        at_s = self._at_s.get(message.DESCRIPTOR.full_name)
        return math.inf if at_s is None else max(0.0, self._now_s() - at_s)

    def link(self) -> Link:
        """Return the current state of the link."""
        age_s = self.age_s(pb.State)
        status = self.latest(pb.Status)
        limit_s = max(SILENT_S, 3.0 * self._period_s)
        if age_s < limit_s and self.alive:
            return Link(state="live", reason="", age_s=age_s)
        if self._now_s() - self._heard_s > GATEWAY_S:
            return Link(state="no-gateway", reason="Nothing arrives from the gateway.", age_s=age_s)
        word = "connecting" if status is None else status.link
        if word == "streaming":  # of a status before the loss
            return Link(state="silent", reason="No samples arrive.", age_s=age_s)
        alarms = self.latest(pb.Alarms)  # the gateway knows more: which port, what was tried
        why = next((alarm.text for alarm in alarms.active if alarm.name == LINK), "") if alarms is not None else ""
        return Link(state=word, reason=why or _REASONS.get(word, "No samples arrive."), age_s=age_s)

    def alarms(self) -> tuple[Alarm, ...]:
        """Return the alarms that are active or not acknowledged, the most urgent first."""
        with self._lock:
            self._judge()
            return self._book.listed()

    def all_alarms(self) -> tuple[Alarm, ...]:
        """Return those of `alarms`, then those that are gone and still shelved."""
        with self._lock:
            self._judge()
            return (*self._book.listed(), *(alarm for alarm in self._book.shelved() if not alarm.active))

    def shelved(self) -> tuple[Alarm, ...]:
        """Return the shelved alarms, the first that comes back first."""
        with self._lock:
            return self._book.shelved()

    def journal(self) -> tuple[int, tuple[Entry, ...]]:
        """Return (how many entries there were so far, the entries, the newest first)."""
        with self._lock:
            return self._book.noted, tuple(reversed(self._book.journal))

    def alarms_revision(self) -> int:
        """Return a number that rises with each change of `alarms()`."""
        with self._lock:
            self._judge()
            return self._book.revision

    def fault(self) -> str:
        """Return the fault that the board has latched, such as "sensor-fault"; empty if there is none."""
        with self._lock:
            return self._book.fault()

    def events(self) -> tuple[pb.Event, ...]:
        """Return the newest 200 events, oldest first."""
        with self._lock:
            return tuple(self._events)

    def commands(self) -> tuple[pb.CommandRecord, ...]:
        """Return the newest 200 commands with sender and result, oldest first."""
        with self._lock:
            return tuple(self._commands)

    def tap(self, message: type[Message], *, width_s: float, channels: Sequence[str] = ()) -> TopicBins:
        """Return bins of pb.State, pb.TwinState or pb.Divergence, of all channels or of two and more.

        `width_s` is rounded to whole ticks, at least 1.
        """
        parameters = self.latest(pb.Parameters)
        period_s = parameters.sample_time_s if parameters is not None and parameters.sample_time_s >= 1e-6 else 2e-3
        tap = TopicBins(message, max(1, round(width_s / period_s)), self._lock, channels)
        self.attach(message, tap)
        return tap

    def attach(self, message: type[Message], tap: Tap) -> None:
        """Push every message of this type into a tap."""
        with self._lock:
            self._taps.setdefault(message.DESCRIPTOR.full_name, []).append(tap)

    def detach(self, message: type[Message], tap: Tap) -> None:
        """Push nothing more into an attached tap."""
        with self._lock:
            self._taps[message.DESCRIPTOR.full_name].remove(tap)

    def companion(self, make: Callable[[BoardFeed], T]) -> T:
        """Return what `make` makes of this board: made at the first call, kept as long as the board."""
        if make not in self._companions:
            self._companions[make] = make(self)
        companion: T = self._companions[make]
        return companion

    def take(self, message: Message, now_ns: int) -> None:
        """Process one message from the bus; the caller holds the feed's lock."""
        name, now_s = message.DESCRIPTOR.full_name, self._now_s()
        if isinstance(message, _OF_GATEWAY):
            if now_s - self._heard_s > GATEWAY_S:
                self._back_s = now_s  # with whichever comes first: status follows a sample by up to a second
            self._heard_s = now_s
        self._latest[name] = message
        self._at_s[name] = now_s
        for tap in self._taps.get(name, ()):
            tap.push(message)
        if isinstance(message, pb.State):
            self.alive = True  # whatever became of the token: here is a sample
            self._book.state(message, now_ns)
            if self.replay_pass is not None:
                self._book.expire(message.host_time_ns)  # a recording has its own time
        elif isinstance(message, pb.Event):
            self._events.append(message)
            self._book.event(message, now_ns)
        elif isinstance(message, pb.Alarm):
            self._book.twin_alarm(message, now_ns)
        elif isinstance(message, pb.TwinAlarms):
            self._book.twin_alarms(message, now_ns)
        elif isinstance(message, pb.Alarms):
            self._book.repeated(message, now_ns)
        elif isinstance(message, pb.CommandRecord):
            self._commands.append(message)
            self._apply_command(message)
        elif isinstance(message, pb.Status):
            self._book.log(message.log_state, now_ns)
            self._book.to_board(message, now_ns)
        elif isinstance(message, pb.Parameters):
            self._period_s = message.sample_time_s * max(1, message.stream_divider)

    def waits(self, alarm: str, *, shelve: bool = False) -> bool:
        """Return whether there is an alarm of that name to acknowledge, or to shelve."""
        with self._lock:
            self._judge()
            return self._book.waits(alarm, shelve=shelve)

    def acknowledge(self, what: pb.Acknowledge, who: str, now_ns: int) -> None:
        """Acknowledge or shelve an alarm in this view only; see Feed.command."""
        with self._lock:
            self._book.acknowledge(what.alarm, who, now_ns, what.comment, shelve_s=what.shelve_s)

    def is_unseen(self) -> bool:
        """Return whether nothing has come from the gateway for UNSEEN_S."""
        return self._now_s() - self._heard_s > UNSEEN_S

    def _apply_command(self, record: pb.CommandRecord) -> None:
        if record.command.WhichOneof("what") == "stop":
            self.stopped_s = self._now_s()
        if record.reply.accepted and record.command.WhichOneof("what") == "acknowledge":
            what = record.command.acknowledge
            self._book.acknowledge(
                what.alarm, record.command.who or "unknown", record.received_ns, what.comment, shelve_s=what.shelve_s
            )

    def _judge(self) -> None:
        if self.replay_pass is not None:
            return
        self._book.expire(time.time_ns())
        link = self.link()
        twin_s = min(self.age_s(pb.TwinAlarms), self._now_s() - self._back_s)
        if TWIN_TIMEOUT_S < twin_s and self.latest(pb.TwinAlarms) is not None and link.state != "no-gateway":
            self._book.end_twin_alarms(time.time_ns())
        if link.live or self._now_s() - self._first_s > GRACE_S:
            self._book.link("" if link.live else link.reason, time.time_ns())
