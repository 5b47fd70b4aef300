"""Publishes messages in threads of their own; passes the output of a board's driver to bus and log.

Rule 1: `Publisher.put` returns at once.  If a router stops reading, zenoh's put blocks in this thread, never in the
        serial one.
Rule 2: the queue is bounded; when full, the OLDEST messages are dropped and counted with their channel.
Rule 3: samples, replies and everything else have separate threads: an event does not wait behind 8000 samples.
Rule 4: a message is serialised once; bus and log get the same bytes.
Rule 5: samples are published twice: each at once on `state`, if somebody subscribes to it (asked every 20 ms), and
        those of 20 ms together on `states`.  Each message wakes up each of its subscribers: who can wait 20 ms
        subscribes to `states`.
Rule 6: without a router zenoh discards messages silently.  Publishing therefore pauses (`hold`): the queue keeps the
        newest messages and counts the dropped ones.  At the end of a pause up to twice as many wait for the thread.
"""

from __future__ import annotations

import logging
import threading
import time
from collections import deque
from collections.abc import Callable, Iterable
from typing import Literal, NamedTuple

import zenoh
from google.protobuf.message import Message as ProtoMessage

from gateway.record.recorder import Recorder
from protocol.bus import board51_pb2 as pb
from protocol.bus import topics
from protocol.bus.encoding import zenoh_encoding
from protocol.bus.endpoint import has_subscriber

GATHER_S = 0.02  # of `states`
LOOK_NS = 20_000_000  # how often a board asks whether `state` has a subscriber
BATCH = 16  # entries at a time: what a stalled bus can hold beside the queue
RAW_USES = 1000  # of one message for the bytes of the line
LONGEST_BATCH = 256  # payloads; without it the backlog of a pause would be one message, larger than a router's queue

_logger = logging.getLogger("gateway.publish")


class PublishQueue:
    """A function that sends one payload, and may block, with its counters and the latencies of the last second."""

    def __init__(self, send: Callable[[bytes], object]) -> None:
        self.send = send
        self.waiting = 0
        self.dropped = 0
        self._latencies_s: list[float] = []

    def note(self, latency_s: float) -> None:
        """Record the latency of one published read."""
        self._latencies_s.append(latency_s)

    def take_latencies_s(self) -> list[float]:
        """Return the latencies recorded since the last call, s."""
        latencies_s, self._latencies_s = self._latencies_s, []
        return latencies_s


class Publisher:
    """A thread that publishes at most `capacity` queued payloads in order.

    With `join` it waits `gather_s` after the first payload.  What arrives meanwhile becomes one payload per channel, of
    at most `LONGEST_BATCH`.
    """

    def __init__(
        self, name: str, capacity: int, *, gather_s: float = 0.0, join: Callable[[list[bytes]], bytes] | None = None
    ) -> None:
        self._capacity = capacity
        self._gather_s, self._join = gather_s, join
        self._queue: deque[tuple[PublishQueue, list[bytes], int]] = deque()
        self.waiting = 0  # payloads in the queue
        self._lock = threading.Lock()
        self._condition = threading.Condition(self._lock)
        self.held = False
        self._was_held = False  # and what waited is not yet taken
        self._stopping = False
        self._failed = False
        self._thread = threading.Thread(target=self._work, name=name, daemon=True)

    def start(self) -> None:
        """Start the thread."""
        self._thread.start()

    def put(self, channel: PublishQueue, payloads: list[bytes], read_mono_ns: int = 0, *, wake: bool = True) -> None:
        """Queue payloads of one channel, in order; `read_mono_ns` is for their latency, where it is of interest.

        Without `wake` the caller wakes the thread, once for many.
        """
        with self._lock:
            idle = wake and not self._queue
            self._queue.append((channel, payloads, read_mono_ns))
            self.waiting += len(payloads)
            channel.waiting += len(payloads)
            # The end of a pause reports what was dropped, so nothing more is dropped until the thread has woken.
            while self.waiting > self._capacity * (2 if self._was_held else 1):
                oldest, dropped, _ = self._queue.popleft()
                oldest.dropped += len(dropped)
                oldest.waiting -= len(dropped)
                self.waiting -= len(dropped)
            if idle:  # otherwise the thread is at work and looks again by itself
                self._condition.notify()

    def wake(self) -> None:
        """Wake the thread for payloads that were put without."""
        if self._queue:
            with self._condition:
                self._condition.notify()

    def hold(self, *, held: bool) -> None:
        """Pause publishing, or continue with the queued payloads."""
        with self._condition:
            self._was_held = self.held and not held
            self.held = held
            self._condition.notify()

    def stop(self, *, patience_s: float = 1.0) -> None:
        """Publish the queued payloads within at most `patience_s`, and end the thread."""
        with self._condition:
            self._stopping = True
            self._condition.notify()
        self._thread.join(patience_s)

    def _work(self) -> None:
        while True:
            with self._condition:
                while self.held or not self._queue:
                    if self._stopping:
                        return
                    self._condition.wait()
            if self._gather_s and not self._stopping:
                time.sleep(self._gather_s)
            for channel, payloads, read_ns in self._take():
                try:
                    for payload in payloads if self._join is None else self._joined(payloads):
                        channel.send(payload)
                except Exception as error:  # whatever it is, the next message may go through
                    channel.dropped += len(payloads)
                    if not self._failed:
                        self._failed = True
                        _logger.warning("the bus refuses a message: %s", error)
                    continue
                self._failed = False
                if read_ns:
                    channel.note((time.monotonic_ns() - read_ns) * 1e-9)

    def _joined(self, payloads: list[bytes]) -> Iterable[bytes]:
        assert self._join is not None
        for start in range(0, len(payloads), LONGEST_BATCH):
            yield self._join(payloads[start : start + LONGEST_BATCH])

    def _take(self) -> Iterable[tuple[PublishQueue, list[bytes], int]]:
        """Return the oldest entries of the queue; if payloads are gathered, all of them, one entry per channel."""
        with self._condition:
            if self.held or not self._queue:  # held, or dropped, while this thread gathered
                return ()
            count = len(self._queue) if self._join is not None else min(len(self._queue), BATCH)
            entries = [self._queue.popleft() for _ in range(count)]
            for channel, payloads, _ in entries:
                self.waiting -= len(payloads)
                channel.waiting -= len(payloads)
            self._was_held = False
        if self._join is None:
            return entries
        gathered: dict[PublishQueue, list[bytes]] = {}
        for channel, payloads, _ in entries:
            gathered.setdefault(channel, []).extend(payloads)
        return ((channel, payloads, 0) for channel, payloads in gathered.items())


class Publishers(NamedTuple):
    """The threads that publish the output of all boards."""

    messages: Publisher
    samples: Publisher
    batches: Publisher  # of the same samples


class BoardSink:
    """The output of one board: zenoh publishers, liveliness token, recorder (`gateway/link/sink.py`)."""

    def __init__(
        self,
        session: zenoh.Session,
        site: str,
        board: str,
        publishers: Publishers,
        recorder: Recorder | None,
        *,
        log_raw: bool,
    ) -> None:
        self._session, self._recorder, self._log_raw = session, recorder, log_raw
        # Reused, as a new one for each read takes twice the time.  Not for ever: it keeps memory for all bytes that it
        # was ever given, 16 for a read: 1.4 MB a minute with four boards.
        self._raw_message, self._raw_uses = pb.RawBytes(), 0
        self._messages, self._samples, self._batches = publishers
        self._keys = {topic.name: topics.key(site, board, topic.name) for topic in topics.TOPICS}
        targets = {
            topic.name: session.declare_publisher(
                self._keys[topic.name],
                encoding=zenoh_encoding(topic.message),
                congestion_control=zenoh.CongestionControl.BLOCK,
            )
            for topic in topics.TOPICS
            if topic.source == "gateway" and topic.bus
        }
        self._single, self._batched = targets["state"], targets["states"]
        self._look_ns, self._subscribed = 0, False
        self._channels = {name: PublishQueue(target.put) for name, target in targets.items()}
        self.state_channel, self._batch_channel = self._channels["state"], self._channels["states"]
        self._state_key, self._raw_key = self._keys["state"], self._keys["raw"]
        self._alive_channel = PublishQueue(_Token(session, topics.key(site, board, topics.ALIVE)).put)

    @property
    def has_subscribers(self) -> bool:
        """Return whether this board's samples have a subscriber on the bus."""
        return has_subscriber(self._single) or has_subscriber(self._batched)

    @property
    def dropped(self) -> int:
        """The number of messages of this board that the bus did not accept in time."""
        return self._count("dropped")

    @property
    def waiting(self) -> int:
        """The number of messages of this board that wait for the bus."""
        return self._count("waiting")

    def _count(self, name: Literal["waiting", "dropped"]) -> int:
        counts = {topic: int(getattr(channel, name)) for topic, channel in self._channels.items()}
        twice = min(counts["state"], counts["states"])  # the same samples in both
        return sum(counts.values()) - twice

    def states(self, payloads: list[bytes], host_time_ns: int, read_mono_ns: int) -> None:
        """Send the samples of one read to bus and log."""
        if read_mono_ns >= self._look_ns:
            self._look_ns, self._subscribed = read_mono_ns + LOOK_NS, has_subscriber(self._single)
        # Without a router no subscriber is known: the newest samples wait for those who return with it.
        if self._samples.held or self._subscribed:
            # Woken at the end of the round: a thread at work would take the interpreter after every read of a port.
            self._samples.put(self.state_channel, payloads, read_mono_ns, wake=False)
        self._batches.put(self._batch_channel, payloads)
        if self._recorder is not None:
            self._recorder.put_all(self._state_key, payloads, host_time_ns)

    def send(self, topic: str, message: ProtoMessage, host_time_ns: int) -> None:
        """Send one message to bus and log, according to the table of topics."""
        row, payload = topics.TOPIC_OF_NAME[topic], message.SerializeToString()
        if row.bus:
            self._messages.put(self._channels[topic], [payload])
        if row.logged and self._recorder is not None:
            self._recorder.put(self._keys[topic], payload, host_time_ns)

    def raw(self, data: bytes, host_time_ns: int, *, to_board: bool) -> None:
        """Write bytes of the UART to the log."""
        if self._recorder is not None and self._log_raw:
            self._raw_uses += 1
            if self._raw_uses == RAW_USES:
                self._raw_message, self._raw_uses = pb.RawBytes(), 0
            m = self._raw_message
            m.host_time_ns, m.to_board, m.data = host_time_ns, to_board, data
            self._recorder.put(self._raw_key, m.SerializeToString(), host_time_ns)

    def alive(self, *, alive: bool) -> None:
        """Hold or drop the liveliness token: it is held while the link is streaming, not while the gateway runs."""
        self._messages.put(self._alive_channel, [b"1" if alive else b""])


class _Token:
    """The liveliness token, which a publisher's thread declares in order."""

    def __init__(self, session: zenoh.Session, key: str) -> None:
        self._session, self._key = session, key
        self._token: zenoh.LivelinessToken | None = None

    def put(self, payload: bytes) -> None:
        if payload and self._token is None:
            self._token = self._session.liveliness().declare_token(self._key)
        elif not payload and self._token is not None:
            token, self._token = self._token, None
            token.undeclare()
