"""Access of a view to the bus: latest messages per board with their age, alarms, bins, and commands.

    feed = Feed(session, "board51")
    feed.boards()                      names, in order; a board appears with its first message
    board = feed.board("rig1")         None while nothing was heard of it
    board.link()                       Link(state="live", ...): is what you see true now?
    board.latest(pb.State)             the latest message of that type, or None; also Status, Parameters, TwinState,
                                       Divergence, TwinModel, CaptureRecord.  Do not change it.
    board.alarms(), board.events(), board.commands()
    tap = board.tap(pb.State, width_s=1 / 30)          bins with min / max of every channel; tap.take() now and then
    feed.command("rig1", pb.Command(stop=pb.Stop()), who="eva", role="operator")    blocks up to 5 s: use a thread

Rule 1: views poll the feed.  zenoh's thread receives the messages and runs no code of a view.  So a slow view only
        falls behind itself (a tap keeps the newest bins); it stalls neither router nor gateway.
Rule 2: age is measured by this process's monotonic clock, never by time stamps of others.
Rule 3: messages that are malformed, of unknown type, with numbers that nothing on a rig can have, or beyond the number
        of boards are counted (`refused`); no error is raised.
Rule 4: a board is known by messages of its gateway; those of the twin alone make none.
Rule 5: what a replay sends is marked (protocol/bus/encoding.py).  A feed takes either live or
        replayed messages.  So a replay is never shown as a rig, and is never among the rigs of STOP.
Rule 6: alarms that the views raise themselves have the time of this host; samples have that of the gateway.
"""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable

import zenoh
from google.protobuf.message import Message

from gateway.access.roles import Role, may
from gateway.client.connection import BusBoard, Subscription, send
from gateway.record.replay import SESSIONS_PER_PASS
from gateway.views.board_feed import BoardFeed, M
from protocol.bus import board51_pb2 as pb
from protocol.bus import topics
from protocol.bus.encoding import BATCH_OF, is_plausible, is_replayed, parse, parts

MAX_BOARDS = 64
_TYPES = {name: topics.TOPIC_OF_NAME[name].message for name in topics.RECEIVED if name not in BATCH_OF}
_CHECKED = (pb.Status, pb.Parameters)  # whose numbers become whole ones, axes and limits; samples may have NaN
# One subscriber for both topics of the twin's alarms: zenoh keeps the order within a subscriber, and a list of active
# alarms that overtakes an alarm would end it.  Not `twin/*`: for a subscriber of `twin/state` each tick is sent alone.
_KEYS = (*(topic for topic in _TYPES if not topic.startswith("twin/alarm")), "twin/alarm$*")


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
        self._token.undeclare()

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

    def latest(self, name: str, message: type[M]) -> M | None:
        """Return the newest message of this type of a board, or None."""
        board = self._boards.get(name)
        return None if board is None else board.latest(message)

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

    def command(
        self, board: str, what: pb.Command, *, who: str, role: str = "", timeout_s: float = 5.0, issued_ns: int = 0
    ) -> pb.CommandReply:
        """Send the command `what` on behalf of `who`, and wait for its reply; an empty id is filled in.

        `issued_ns` is when it came to the view, Unix time (0: now): the gateway refuses what was issued before a STOP.
        `refused_by` is "link" if no gateway answered.  The caller has authenticated the user; on a guarded bus the
        gateway checks `role`.

        An acknowledgement of an alarm that there is not is refused by "view" with the reason "no-alarm".  Without a
        gateway it counts in this view only, and `text` says so.  An operator must be able to silence the alarm that
        reports the missing gateway.
        """
        feed, alarm, acknowledges = self._boards.get(board), what.acknowledge, what.HasField("acknowledge")
        if acknowledges and (feed is None or not feed.waits(alarm.alarm, shelve=alarm.shelve_s > 0.0)):
            text = "There is no such alarm, or it is already acknowledged."
            return pb.CommandReply(refused_by="view", reason="no-alarm", text=text)
        command = pb.Command()
        command.CopyFrom(what)
        command.who = who
        where, stated = BusBoard(self._session, self.site, board), role if self.guarded else ""
        reply = send(where, command, timeout_s=timeout_s, typed=False, since_ns=issued_ns, role=stated)
        if not acknowledges or feed is None:
            return reply
        if reply.reason == "not-delivered" and (not role or may(Role[role.upper()], "acknowledge")):
            reply = pb.CommandReply(accepted=True, text="Acknowledged in this view only: no gateway answers.")
        if reply.accepted:  # at once: the record may take a moment
            feed.acknowledge(alarm, who, time.time_ns())
        return reply

    def _arrived(self, sample: zenoh.Sample) -> None:
        if is_replayed(sample.attachment) != self._replays:
            return
        address = topics.split(str(sample.key_expr))
        kind = _TYPES.get(address[2]) if address is not None else None
        message = parse(kind, sample.payload.to_bytes()) if kind is not None else None
        if address is None or message is None or (isinstance(message, _CHECKED) and not is_plausible(message)):
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
            for _, part in parts(address[2], message):
                board.take(part, now_ns)

    def _alive(self, sample: zenoh.Sample) -> None:
        _, _, rest = str(sample.key_expr).partition("/")
        board = self._boards.get(rest.partition("/")[0])
        if board is not None:
            board.alive = sample.kind == zenoh.SampleKind.PUT


def _pass_of(message: Message) -> int | None:
    """Return the pass of a replay to which a message belongs: a seek makes all earlier messages invalid."""
    first = next((part for _, part in parts("", message)), message)
    session: int | None = getattr(first, "session", None)
    return None if session is None else session // SESSIONS_PER_PASS
