"""Access of a view to the bus: latest messages per board with their age, alarms, bins, and commands.

    feed = Feed(session, "board51")
    feed.boards()                      names, in order; a board appears with its first message
    board = feed.board("rig1")         None while nothing was heard of it
    board.link()                       Link(state="live", ...): is what you see true now?
    board.latest(pb.State)             the latest message of that type, or None; also Status, Parameters, TwinState,
                                       Divergence, TwinModel, CaptureRecord.  Do not change it.
    board.alarms(), board.events(), board.commands()
    tap = board.tap(pb.State, width_s=1 / 30)          bins with min / max of every channel; tap.take() now and then
    feed.acknowledge("rig1", "divergence-x", who="eva", role="operator")           a command too: all views and the log
    feed.command("rig1", pb.Command(stop=pb.Stop()), who="eva", role="operator")    blocks up to 5 s: use a thread

Rule 1: views poll the feed.  zenoh's thread receives the messages and runs no code of a view.  So a slow view only
        falls behind itself (a tap keeps the newest bins); it stalls neither router nor gateway.
Rule 2: age is measured by this process's monotonic clock, never by time stamps of others.
Rule 3: messages that are malformed, of unknown type or beyond the number of boards are counted (`refused`); no error is
        raised.
Rule 4: a board is known by messages of its gateway; those of the twin alone make none.
Rule 5: what a replay sends is marked (protocol/bus/encoding.py).  A feed takes either live or
        replayed messages.  So a replay is never shown as a rig, and is never among the rigs of STOP.
Rule 6: alarms that the views raise themselves have the time of this host; samples have that of the gateway.
"""

from __future__ import annotations

import math
import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol, TypeVar

import zenoh
from google.protobuf.message import Message

from gateway.board.conditions import LINK
from gateway.client.connection import BusBoard, Subscription, send
from gateway.record.replay import SESSIONS_PER_PASS
from gateway.views.alarms import Alarm, AlarmBook
from gateway.views.decimate import TopicBins
from gateway.views.journal import Entry
from protocol.bus import board51_pb2 as pb
from protocol.bus import topics
from protocol.bus.encoding import is_replayed, parse

M = TypeVar("M", bound=Message)

MAX_BOARDS = 64
RETAINED_EVENTS = 200
SILENT_S = 0.5  # without a state for so long (and three of its periods) a board is not live
GRACE_S = 2.0  # no alarm while a board is being discovered
GATEWAY_S = 3.5  # status comes once a second: without it, three times over, there is no gateway
UNSEEN_S = 120.0  # a board without any message for so long may be removed
TWIN_TIMEOUT_S = 12.0  # `twin/alarms` comes every 5 s: without it twice over, there is no twin
_TOPICS = ("states", "status", "event", "alarms", "parameters", "plant", "command/record", "twin/state",
           "twin/divergence", "twin/alarm", "twin/alarms", "twin/model", "twin/diagnosis", "capture")  # fmt: skip
# One subscriber for all of the twin: zenoh keeps the order within a subscriber, and a list of active alarms that
# overtakes an alarm would end it.
_KEYS = (*(topic for topic in _TOPICS if not topic.startswith("twin/")), "twin/*")
_OF_GATEWAY = (pb.Status, pb.Event, pb.State)  # while one of them comes, there is a gateway
_REASONS = {
    "absent": "Its port is missing.",
    "silent": "The board sends nothing.",
    "connecting": "The port is being opened.",
    "handshake": "The board has not answered yet.",
}
_TYPES: dict[str, type[Message]] = {name: topics.TOPIC_OF_NAME[name].message for name in _TOPICS}


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
        self._book = AlarmBook(name)
        self.alive = True  # the gateway's token, before any time-out; until one was seen, its absence says nothing
        self._period_s = 0.0
        self._first_s = now_s()
        self._back_s = self._first_s  # the gateway came, or came back
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
        if min(self.age_s(kind) for kind in _OF_GATEWAY) > GATEWAY_S:
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

    def shelved(self) -> tuple[Alarm, ...]:
        """Return the shelved alarms, the first that comes back first."""
        with self._lock:
            return self._book.shelved()

    def journal(self) -> tuple[int, tuple[Entry, ...]]:
        """Return (how many entries there were so far, the entries, the newest first)."""
        with self._lock:
            return self._book.journal.count, self._book.journal.newest_first()

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

    def tap(self, message: type[Message], *, width_s: float) -> TopicBins:
        """Return bins of pb.State, pb.TwinState or pb.Divergence; `width_s` is rounded to whole ticks, at least 1."""
        parameters = self.latest(pb.Parameters)
        period_s = parameters.sample_time_s if parameters is not None and parameters.sample_time_s > 0 else 2e-3
        tap = TopicBins(message, max(1, round(width_s / period_s)), self._lock)
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

    def take(self, message: Message, now_ns: int) -> None:
        """Process one message from the bus; the caller holds the feed's lock."""
        name = message.DESCRIPTOR.full_name
        if isinstance(message, _OF_GATEWAY) and min(self.age_s(kind) for kind in _OF_GATEWAY) > GATEWAY_S:
            self._back_s = self._now_s()  # with whichever comes first: status follows a sample by up to a second
        self._latest[name] = message
        self._at_s[name] = self._now_s()
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
        """Acknowledge or shelve an alarm in this view only; see Feed.acknowledge."""
        with self._lock:
            self._book.acknowledge(what.alarm, who, now_ns, what.comment, shelve_s=what.shelve_s)

    def is_unseen(self) -> bool:
        """Return whether nothing has come from the gateway for UNSEEN_S."""
        return min(self.age_s(kind) for kind in _OF_GATEWAY) > UNSEEN_S

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


class Feed:
    """Subscribes to everything a view needs of one site.

    Args:
        session: of the bus.
        site: first chunk of the keys.
        guarded: whether commands use the key `command/as/<role>/<who>`, as required on a guarded bus.
        replays: whether to take what is replayed, and nothing else.
        now_s: monotonic clock, for tests.
    """

    def __init__(
        self,
        session: zenoh.Session,
        site: str = topics.DEFAULT_SITE,
        *,
        guarded: bool = False,
        replays: bool = False,
        now_s: Callable[[], float] = time.monotonic,
    ) -> None:
        self.site = topics.check_name(site, what="site")
        self.guarded = guarded
        self.refused = 0
        self._session, self._now_s, self._replays = session, now_s, replays
        self._lock = threading.Lock()
        self._boards: dict[str, BoardFeed] = {}
        self._subscription = Subscription(session, [f"{site}/*/{topic}" for topic in _KEYS], self._arrived)
        self._token = session.liveliness().declare_subscriber(f"{site}/*/{topics.ALIVE}", self._alive, history=True)

    def close(self) -> None:
        """Unsubscribe."""
        self._subscription.close()
        self._token.undeclare()  # type: ignore[no-untyped-call]  # the stub has no return type

    def boards(self) -> tuple[str, ...]:
        """Return the names of the boards seen so far, in order."""
        with self._lock:
            return tuple(sorted(self._boards))

    def board_feeds(self) -> list[BoardFeed]:
        """Return the boards seen so far, in the order of their names."""
        with self._lock:
            return [self._boards[name] for name in sorted(self._boards)]

    def board(self, name: str) -> BoardFeed | None:
        """Return a board, or None if no message of it has arrived."""
        return self._boards.get(name)

    def remove(self, name: str) -> bool:
        """Forget a board from which nothing has come for UNSEEN_S, until its next message; False for others."""
        with self._lock:
            board = self._boards.get(name)
            return board is not None and board.is_unseen() and self._boards.pop(name) is board

    def forget(self) -> None:
        """Forget all boards until their next messages: a replay begins."""
        with self._lock:
            self._boards.clear()

    def stopped_s(self, name: str) -> float:
        """Return when the last STOP of a board was seen, monotonic; -inf if none was."""
        board = self._boards.get(name)
        return -math.inf if board is None else board.stopped_s

    def acknowledge(
        self, board: str, alarm: str, *, who: str, role: str = "", comment: str = "", shelve_s: float = 0.0,
        issued_ns: int = 0,
    ) -> pb.CommandReply:  # fmt: skip
        """Acknowledge an alarm by a command, so that every view and the log receive it; blocks like `command`.

        With `shelve_s` it is shelved for so long; a shelved one that is acknowledged is shelved no longer.

        If there is no such alarm, the reply is refused by "view" with the reason "no-alarm".  Without a gateway the
        acknowledgement counts in this view only, and `text` says so.  An operator must be able to silence the alarm
        that reports the missing gateway.
        """
        feed = self._boards.get(board)
        if feed is None or not feed.waits(alarm, shelve=shelve_s > 0.0):
            text = "There is no such alarm, or it is already acknowledged."
            return pb.CommandReply(refused_by="view", reason="no-alarm", text=text)
        what = pb.Command(acknowledge=pb.Acknowledge(alarm=alarm, comment=comment, shelve_s=shelve_s))
        reply = self.command(board, what, who=who, role=role, issued_ns=issued_ns)
        if reply.reason == "not-delivered":
            reply = pb.CommandReply(accepted=True, text="Acknowledged in this view only: no gateway answers.")
        if reply.accepted:  # at once: the record may take a moment
            feed.acknowledge(what.acknowledge, who, time.time_ns())
        return reply

    def command(
        self, board: str, what: pb.Command, *, who: str, role: str = "", timeout_s: float = 5.0, issued_ns: int = 0
    ) -> pb.CommandReply:
        """Send the command `what` on behalf of `who`, and wait for its reply; an empty id is filled in.

        `issued_ns` is when it came to the view, Unix time (0: now): the gateway refuses what was issued before a STOP.
        `refused_by` is "link" if no gateway answered.  The caller has authenticated the user; on a guarded bus the
        gateway checks `role`.
        """
        command = pb.Command()
        command.CopyFrom(what)
        command.who = who
        as_role = role if self.guarded else ""
        return send(
            BusBoard(self._session, self.site, board), command,
            timeout_s=timeout_s, role=as_role, typed=False, since_ns=issued_ns,
        )  # fmt: skip

    def _arrived(self, sample: zenoh.Sample) -> None:
        if is_replayed(sample.attachment) != self._replays:
            return
        address = topics.split(str(sample.key_expr))
        kind = _TYPES.get(address[2]) if address is not None else None
        message = parse(kind, sample.payload.to_bytes()) if kind is not None else None
        if address is None or message is None:
            self.refused += 1
            return
        with self._lock:
            board = self._boards.get(address[1])
            replay_pass = _pass_of(message) if self._replays else None
            if board is None or replay_pass not in (None, board.replay_pass):
                if topics.TOPIC_OF_NAME[address[2]].source != "gateway" and not self._replays:
                    return
                if len(self._boards) >= MAX_BOARDS:
                    self.refused += 1
                    return
                board = self._boards[address[1]] = BoardFeed(
                    address[1], self._lock, self._now_s, replay_pass=(replay_pass or 0) if self._replays else None
                )
            now_ns = time.time_ns()
            for part in message.states if isinstance(message, pb.StateBatch) else (message,):
                board.take(part, now_ns)

    def _alive(self, sample: zenoh.Sample) -> None:
        _, _, rest = str(sample.key_expr).partition("/")
        board = self._boards.get(rest.partition("/")[0])
        if board is not None:
            board.alive = sample.kind == zenoh.SampleKind.PUT


def _pass_of(message: Message) -> int | None:
    """Return the pass of a replay to which a message belongs: after a seek nothing of before is true."""
    if isinstance(message, pb.StateBatch):
        message = message.states[0] if message.states else message
    session: int | None = getattr(message, "session", None)
    return None if session is None else session // SESSIONS_PER_PASS
