"""Mirrors on the bus: subscribe state and parameters, one mirror per board, publish what it says.

Rule 1: the zenoh callback only queues; one worker thread computes and publishes.  The queue is bounded: what does not
        fit is dropped and counted, and the mirror sees the gap by the ticks, as it sees any other.
Rule 2: this is the only place of the twin with a clock, and it is used for one thing: to notice that a board is silent.
Rule 3: publishing blocks rather than drops (a divergence that vanishes unseen is worse than a late one); behind the
        queue that costs nobody else anything.
"""

from __future__ import annotations

import logging
import queue
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field

import zenoh
from google.protobuf.message import Message

from protocol.bus import board51_pb2 as pb
from protocol.bus import encoding, topics
from protocol.bus.endpoint import zenoh_config
from protocol.errors import ServiceError
from twin.mirror.mirror import Mirror
from twin.mirror.output import Output
from twin.mirror.settings import Settings
from twin.model.parameters import Model

QUEUE_LENGTH = 5000  # ten seconds of one board
SILENT_S = 1.0
POLL_S = 0.1  # of the silence check where nothing arrives
_MESSAGES: dict[str, type[Message]] = {
    "twin/state": pb.TwinState,
    "twin/divergence": pb.Divergence,
    "twin/alarm": pb.Alarm,
}
log = logging.getLogger(__name__)


@dataclass(slots=True, kw_only=True)
class Watched:
    """One board on the bus."""

    site: str
    board: str
    mirror: Mirror
    publishers: dict[str, zenoh.Publisher]
    samples: int = 0
    last_heard_s: float = 0.0  # monotonic
    silent: bool = False
    alarms: dict[str, bool] = field(default_factory=dict)  # name: active


class TwinService:
    """Runs between `start` and `stop`.

    Args:
        model: what every twin believes.
        site: first chunk of the keys.
        board: only this one; None: every board of the site.
        endpoints: where the router listens.
        settings: window, false-alarm rate, longest bridge.
        on_output: called in the worker thread with each board and output, for a display.

    The router may come later, go and come back: the zenoh session reconnects by itself and the twin meets a gap.
    """

    def __init__(
        self,
        model: Model,
        *,
        site: str = topics.DEFAULT_SITE,
        board: str | None = None,
        endpoints: tuple[str, ...],
        settings: Settings | None = None,
        on_output: Callable[[Watched, Output], None] | None = None,
    ) -> None:
        self.boards: dict[str, Watched] = {}
        self.dropped = 0
        self.malformed = 0
        self.parameters_heard = 0
        self._model = model
        self._site = site
        self._board = board
        self._endpoints = endpoints
        self._settings = settings
        self._on_output = on_output
        self._queue: queue.Queue[tuple[str, bytes] | None] = queue.Queue(maxsize=QUEUE_LENGTH)
        self._worker: threading.Thread | None = None
        self._session: zenoh.Session | None = None
        self._stopping = threading.Event()
        self.failure: BaseException | None = None

    def start(self) -> None:
        """Open the session and begin.  Raises ServiceError where zenoh refuses the configuration."""
        try:
            self._session = zenoh.open(
                zenoh.Config.from_json5(zenoh_config("client", connect=self._endpoints, wait_for_router=False))
            )
        except zenoh.ZError as error:
            raise ServiceError(
                f"zenoh cannot be opened with {', '.join(self._endpoints)} ({error})", remedy="Check --connect"
            ) from error
        self._worker = threading.Thread(target=self._work, name="twin", daemon=True)
        self._worker.start()
        # One subscriber for both topics: zenoh keeps the order within a subscriber, not between two, and a sample that
        # overtakes its board's parameters would be compared under the old ones.
        self._session.declare_subscriber(f"{self._site}/{self._board or '*'}/*", self._receive)

    def stop(self) -> None:
        """Answer what is queued for at most a second, then close.  Idempotent."""
        self._stopping.set()
        if self._worker is not None:
            self._worker.join(timeout=2.0)
        if self._session is not None:
            self._session.close()  # type: ignore[no-untyped-call]  # the stub has no return type
            self._session = None

    def __enter__(self) -> TwinService:
        self.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    @property
    def running(self) -> bool:
        """False once the worker has ended, by `stop` or by a failure (then in `failure`)."""
        return self._worker is not None and self._worker.is_alive()

    def _receive(self, sample: zenoh.Sample) -> None:
        key = str(sample.key_expr)
        if not key.endswith(("/state", "/parameters")):
            return
        try:
            self._queue.put_nowait((key, sample.payload.to_bytes()))
        except queue.Full:
            self.dropped += 1

    def _work(self) -> None:
        try:
            checked = time.monotonic()
            while True:
                try:
                    item = self._queue.get(timeout=POLL_S)
                except queue.Empty:
                    item = None
                now = time.monotonic()
                if item is not None:
                    self._take(*item, now)
                elif self._stopping.is_set():
                    return
                if now - checked > POLL_S:
                    checked = now
                    self._look_for_silence(now)
                    if self._stopping.is_set() and self._queue.empty():
                        return
        except Exception as error:  # a worker that dies silently would leave a service that looks alive
            self.failure = error
            log.exception("twin stopped")

    def _take(self, key: str, data: bytes, now: float) -> None:
        found = topics.split(key)
        if found is None:
            return
        site, board, topic = found
        if topic == "parameters":
            parameters = encoding.parse(pb.Parameters, data)
            if parameters is None:
                self.malformed += 1
                return
            self._watched(site, board, now).mirror.parameters(parameters)
            self.parameters_heard += 1
            return
        state = encoding.parse(pb.State, data)
        if state is None:
            self.malformed += 1
            return
        watched = self._watched(site, board, now)
        watched.samples += 1
        watched.last_heard_s = now
        watched.silent = False
        output = watched.mirror.handle(state)
        if output is None:
            return
        if output.state is not None:
            self._publish(watched, "twin/state", output.state)
        self._publish(watched, "twin/divergence", output.divergence)
        for alarm in output.alarms:
            self._alarm(watched, alarm)
        if self._on_output:
            self._on_output(watched, output)

    def _watched(self, site: str, board: str, now: float) -> Watched:
        watched = self.boards.get(board)
        if watched is None:
            assert self._session is not None
            watched = Watched(
                site=site,
                board=board,
                mirror=Mirror(self._model, self._settings),
                publishers={
                    topic: self._session.declare_publisher(
                        topics.key(site, board, topic),
                        encoding=encoding.zenoh_encoding(message),
                        congestion_control=zenoh.CongestionControl.BLOCK,
                    )
                    for topic, message in _MESSAGES.items()
                },
                last_heard_s=now,
            )
            self.boards[board] = watched
            log.info("board %s: twin of model %s", board, self._model.plant.name)
        return watched

    def _look_for_silence(self, now: float) -> None:
        for watched in self.boards.values():
            if watched.samples and not watched.silent and now - watched.last_heard_s > SILENT_S:
                watched.silent = True
                alarm = watched.mirror.silence(f"no sample for {SILENT_S:g} s")
                if alarm is not None:
                    self._alarm(watched, alarm)

    def _alarm(self, watched: Watched, alarm: pb.Alarm) -> None:
        watched.alarms[alarm.name] = alarm.active
        log.warning(
            "board %s: alarm %s %s (%s)", watched.board, alarm.name, "on" if alarm.active else "off", alarm.text
        )
        self._publish(watched, "twin/alarm", alarm)

    def _publish(self, watched: Watched, topic: str, message: Message) -> None:
        watched.publishers[topic].put(message.SerializeToString())
