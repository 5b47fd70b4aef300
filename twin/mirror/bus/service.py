"""Mirrors on the bus: subscribe state and parameters, one mirror per board, publish what it says; take other models.

Rule 1: the zenoh callbacks only queue; one worker thread computes and publishes.  The queue is bounded: messages that
        do not fit are dropped and counted.  The mirror sees the gap by the ticks, as it sees any other.
Rule 2: no other file of the twin has a clock.  It serves two purposes: to notice that a board is silent, and to repeat
        which model runs and which alarms are active.
Rule 3: publishing blocks rather than drops (a divergence that vanishes unseen is worse than a late one); behind the
        queue that costs nobody else anything.
Rule 4: a model is handed over by a query, `<site>/<board>/twin/command`, which waits in the same queue.  It takes
        effect between two samples, and every sample is answered by one model.  A model that is refused changes nothing.
        A command for `<site>/*` means every board, also those that appear later.
Rule 5: if the status says that samples come, and none do, the bus does not deliver them to this process.  This was seen
        once in 13 starts with a separate router, until that was restarted; the cause is not known.  The twin then opens
        a new session.
Rule 6: a board has one twin.  Before it handles the first message, the twin looks for another one of the same board
        (`claim.py`); if there is one, it ends with a ServiceError in `failure`.
"""

from __future__ import annotations

import logging
import queue
import threading
import time
from collections.abc import Callable

import zenoh

from protocol.bus import board51_pb2 as pb
from protocol.bus import encoding, topics
from protocol.bus.closing import close
from protocol.bus.endpoint import DEFAULT_ENDPOINT, zenoh_config
from protocol.bus.identity import Identity
from protocol.errors import ServiceError
from twin.mirror.bus.claim import Claim
from twin.mirror.bus.handover import Answered, believe, read_command, read_model, refusal
from twin.mirror.bus.watched import Namer, Watched
from twin.mirror.warm_up import compile_kernels
from twin.model.parameters import Model
from twin.settings.mirror import Settings

QUEUE_LENGTH = 5000  # a hundred seconds of one board
DEAF_S = 5.0  # status comes every second: more than a moment's hold-up, and time for a new session to join
POLL_S = 0.1  # of the look at the clock where nothing arrives
_MAY_HAND_OVER = "engineer"  # the role that a guarded bus wants for it; the router has checked who has it
_REPLY_ENCODING = encoding.zenoh_encoding(pb.CommandReply)
_TOPICS = ("parameters", "states", "status")
log = logging.getLogger(__name__)


class TwinService:
    """Runs between `start` and `stop`.

    Args:
        model: what every twin believes until it is handed another one.
        site: first chunk of the keys.
        board: only this one; None: every board of the site.
        endpoints: where the router listens.
        identity: of the twin, on a guarded bus; only engineers hand it models then.
        settings: window, false-alarm rate, longest bridge.
        namers: names causes for a board while it flies, used in the worker thread; None: nobody does.

    Raises:
        DataError: the model cannot be written down for those who ask which one runs.

    The router may come later, go and come back: the zenoh session reconnects by itself and the twin meets a gap.
    """

    def __init__(
        self,
        model: Model,
        *,
        site: str = topics.DEFAULT_SITE,
        board: str | None = None,
        endpoints: tuple[str, ...],
        identity: Identity | None = None,
        settings: Settings | None = None,
        namers: Callable[[Model], Namer] | None = None,
    ) -> None:
        self.boards: dict[str, Watched] = {}
        self.dropped = 0
        self.malformed = 0
        self.parameters_received = 0
        self._belief = believe(model)  # of boards to come
        self._answered = Answered()
        self._site = site
        self._board = board
        self._commands = zenoh.KeyExpr(topics.key(site, board or "*", "twin/command"))
        self._endpoints, self._identity = endpoints, identity
        self._settings = settings
        self._namers = namers
        self._queue: queue.Queue[tuple[str, bytes] | zenoh.Query] = queue.Queue(maxsize=QUEUE_LENGTH)
        self._worker: threading.Thread | None = None
        self._session: zenoh.Session | None = None
        self._hearing: zenoh.Session | None = None  # instead of the first one, once that was deaf
        self._subscribers: list[zenoh.Subscriber[None]] = []
        self.renewed = 0
        self._sampled_s: dict[str, float] = {}  # by board: the latest sample, or when it began to be missed; monotonic
        self._stopping = threading.Event()
        self.failure: BaseException | None = None

    def start(self) -> None:
        """Open the session and begin.  Raises ServiceError where zenoh refuses the configuration."""
        compile_kernels(self._belief.model)
        try:
            self._session = self._open()
        except zenoh.ZError as error:
            raise ServiceError(
                f"zenoh cannot be opened with {', '.join(self._endpoints)} ({error})", remedy="Check --connect"
            ) from error
        self._claim = Claim(self._session, self._site, self._board, self._refuse)
        self._worker = threading.Thread(target=self._work, name="twin", daemon=True)
        self._worker.start()
        self._subscribers = self._hear(self._session)
        served = f"{self._commands}/{topics.AS}/{_MAY_HAND_OVER}/*" if self._identity is not None else self._commands
        self._session.declare_queryable(served, self._answer)

    def stop(self) -> None:
        """Answer the queue for at most a second, then close.  Idempotent."""
        self._stopping.set()
        if self._worker is not None:
            self._worker.join(timeout=2.0)
        for session in (self._hearing, self._session):
            if session is not None:
                close(session)
        self._hearing = self._session = None

    def __enter__(self) -> TwinService:
        self.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    @property
    def running(self) -> bool:
        """Return whether the worker runs; it ends by `stop` or by a failure (then in `failure`)."""
        return self._worker is not None and self._worker.is_alive()

    def _open(self) -> zenoh.Session:
        text = zenoh_config("client", connect=self._endpoints, wait_for_router=False, identity=self._identity)
        return zenoh.open(zenoh.Config.from_json5(text))

    def _hear(self, session: zenoh.Session) -> list[zenoh.Subscriber[None]]:
        # indirect=True would start a thread per subscriber, and samples could overtake their board's parameters.
        receive = zenoh.handlers.Callback(self._receive, indirect=False)
        return [session.declare_subscriber(f"{self._site}/{self._board or '*'}/{topic}", receive) for topic in _TOPICS]

    # ---- in zenoh's threads

    def _refuse(self, error: ServiceError) -> None:
        self.failure = error

    def _receive(self, sample: zenoh.Sample) -> None:
        # Dropped, not waited for: this is zenoh's thread, and all boards' messages come through it.
        try:
            self._queue.put_nowait((str(sample.key_expr), sample.payload.to_bytes()))
        except queue.Full:
            self.dropped += 1

    def _answer(self, query: zenoh.Query) -> None:
        try:
            self._queue.put_nowait(query)
        except queue.Full:
            text = "More samples are queued than this twin can process; try again."
            _reply(query, [(str(query.key_expr), refusal("queue-full", text))])

    # ---- in the worker's thread

    def _work(self) -> None:
        try:
            checked = time.monotonic()
            claimed = False
            while self.failure is None:
                try:
                    item = self._queue.get(timeout=POLL_S)
                except queue.Empty:
                    item = None
                if item is not None and not claimed:  # something arrived, so the router is there to be asked
                    claimed = True
                    self._claim.declare()
                    if self.failure is not None:
                        return
                now = time.monotonic()
                if isinstance(item, tuple):
                    self._take(*item, now)
                elif item is not None:
                    _reply(item, self._command(item))
                elif self._stopping.is_set():
                    return
                if now - checked > POLL_S:
                    checked = now
                    for watched in self.boards.values():
                        watched.look_at_the_clock(now)
                    if self._stopping.is_set() and self._queue.empty():
                        return
        except Exception as error:  # a worker that dies silently would leave a service that looks alive
            if self._stopping.is_set() and isinstance(error, zenoh.ZError):
                self.dropped += 1 + self._queue.qsize()  # `stop` has closed the session before all was answered
                return
            self.failure = error
            log.exception("twin stopped")

    def _take(self, key: str, data: bytes, now: float) -> None:
        parts = topics.split(key)
        if parts is None:
            return
        site, board, topic = parts
        match encoding.parse(topics.TOPIC_OF_NAME[topic].message, data):
            case pb.Parameters() as parameters:
                self._watched(site, board).mirror.parameters(parameters)
                self.parameters_received += 1
            case pb.Status() as status:
                self._judge_hearing(board, status, now)
            case pb.StateBatch() as batch:
                self._sampled_s[board] = now
                watched = self._watched(site, board)
                for state in batch.states:
                    watched.take(state, now)
                watched.send_batch()
            case None:
                self.malformed += topic != "status"

    def _judge_hearing(self, board: str, status: pb.Status, now: float) -> None:
        # A stream that is thinned out may pause for longer than that.
        comes = status.link == "streaming" and status.samples_per_s * DEAF_S >= 2.0
        if not comes or now - self._sampled_s.setdefault(board, now) < DEAF_S:
            if not comes:
                self._sampled_s[board] = now
            return
        self.renewed += 1
        # All boards are given time again: the new session takes some to join.
        self._sampled_s.clear()
        log.warning(
            "board %s: its gateway sends %.0f samples/s and none came for %g s: opening a new session",
            board, status.samples_per_s, DEAF_S,
        )  # fmt: skip
        before, deaf = self._subscribers, self._hearing
        try:
            self._hearing = self._open()
        except zenoh.ZError as error:
            log.warning("no new session: %s", error)
            return
        for subscriber in before:
            subscriber.undeclare()
        self._subscribers = self._hear(self._hearing)
        if deaf is not None:
            deaf.close()

    def _watched(self, site: str, board: str) -> Watched:
        watched = self.boards.get(board)
        if watched is None:
            assert self._session is not None
            reach = _reach(self._endpoints, guarded=self._identity is not None)
            watched = Watched(
                self._session, site, board, self._belief, self._settings, reach=reach, namers=self._namers
            )
            self.boards[board] = watched
            log.info("board %s: twin of model %s", board, watched.belief.title)
        return watched

    def _command(self, query: zenoh.Query) -> list[tuple[str, pb.CommandReply]]:
        """Return (key, reply) for each board that the query means; for none, one under the key that was asked."""
        key_expr = str(query.key_expr)
        plain, _, sender = key_expr.partition(f"/{topics.AS}/")
        suffix = key_expr.removeprefix(plain)
        command = read_command(query.payload.to_bytes() if query.payload is not None else b"")
        if isinstance(command, pb.CommandReply):
            return [(key_expr, command)]
        if sender:
            command.who = sender.partition("/")[2]
        if (before := self._answered.again(key_expr, command)) is not None:
            return before
        boards = zenoh.KeyExpr(plain)
        addressed = {}
        for watched in self.boards.values():
            key = topics.key(watched.site, watched.board, "twin/command")
            if boards.intersects(zenoh.KeyExpr(key)):
                addressed[key + suffix] = watched
        everybody = boards.includes(self._commands)
        if not addressed and not everybody:
            text = f"This twin does not serve that board; it has {', '.join(sorted(self.boards)) or 'none seen yet'}."
            return [(key_expr, refusal("unknown-board", text, command_id=command.id))]
        belief = read_model(command)
        if isinstance(belief, pb.CommandReply):
            log.warning("model refused, from %r: %s", command.who, belief.text)
            replies = [(key_expr, belief)]
        else:
            replies = [(key, watched_board.use(belief)) for key, watched_board in addressed.items()]
            # A model that one board refused is none for boards to come: nobody would read their refusal.
            if everybody and all(reply.accepted for _, reply in replies):
                self._belief = belief
                text = f"will run on {belief.title}; no board has been seen yet"
                replies = replies or [(key_expr, pb.CommandReply(id=command.id, accepted=True, text=text, attempts=1))]
        self._answered.keep(key_expr, command, replies)
        return replies


def _reach(endpoints: tuple[str, ...], *, guarded: bool) -> str:
    """Return the options with which a command reaches this bus, for advice that is read on a page or in a log."""
    at = "" if endpoints == (DEFAULT_ENDPOINT,) else "".join(f" --connect {endpoint}" for endpoint in endpoints)
    return at + (" --identity FOLDER" if guarded else "")


def _reply(query: zenoh.Query, replies: list[tuple[str, pb.CommandReply]]) -> None:
    try:
        with query:  # its end: without it the sender would wait for more until the time-out
            for key, reply in replies:
                query.reply(key, reply.SerializeToString(), encoding=_REPLY_ENCODING)
    except zenoh.ZError as error:  # the sender has left; the act remains done
        log.warning("a reply was not delivered: %s", error)
