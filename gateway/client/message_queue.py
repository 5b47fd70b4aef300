"""Queues of bus messages and samples in the order of arrival, for a loop that reads at its own pace.

A full queue drops the OLDEST message and counts it, because zenoh's thread must not wait for a slow reader.
"""

from __future__ import annotations

import threading
import time
import weakref
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from contextlib import AbstractContextManager
from typing import NamedTuple, TypeVar

import zenoh
from google.protobuf.message import Message

from gateway.client.connection import BusBoard, Subscription
from gateway.client.errors import NoSamplesError
from gateway.client.values import Sample
from protocol.bus import board51_pb2 as pb
from protocol.bus import topics
from protocol.bus.encoding import parse
from protocol.errors import UsageError

M = TypeVar("M", bound=Message)
CAPACITY = 100_000  # messages: 200 s of one board's samples


class Arrival(NamedTuple):
    """A message of the bus, as it arrived."""

    key: str
    message: Message | None  # None: the bytes are not a valid message
    size: int  # of the payload, bytes


class MessageQueue(AbstractContextManager["MessageQueue"], Iterator[Message]):
    """The messages of some topics from now on: an iterator that ends when it is closed or garbage-collected.

    It also ends after `timeout_s` without a message.
    """

    def __init__(
        self, board: BusBoard, names: Iterable[str], *, capacity: int = CAPACITY, timeout_s: float | None = None
    ) -> None:
        self._waiting = _Waiting(capacity)
        self._timeout_s = timeout_s
        subscription = Subscription(board.session, [f"{board}/{name}" for name in names], self._waiting.put)
        # The callbacks refer to the queue and not to the feed, so that a loop left with `break` ends the subscription.
        self._end = weakref.finalize(self, subscription.close)

    def __exit__(self, *_: object) -> None:
        self.close()

    def __next__(self) -> Message:
        while (arrival := self.take(self._timeout_s)) is not None:
            if arrival.message is not None:
                return arrival.message
        raise StopIteration

    def close(self) -> None:
        """End the subscription."""
        self._end()

    @property
    def dropped(self) -> int:
        """Messages dropped because the queue was full."""
        return self._waiting.dropped

    def take(self, timeout_s: float | None = None) -> Arrival | None:
        """The next message; None if none arrives within `timeout_s` (s; None: wait without limit)."""
        return self._waiting.take(timeout_s)

    def first(self, kind: type[M], timeout_s: float, accepts: Callable[[M], bool] = lambda message: True) -> M | None:
        """The next message of type `kind` for which `accepts` is true; None if none arrives within `timeout_s`, s."""
        end_s = time.monotonic() + timeout_s
        while (arrival := self.take(max(0.0, end_s - time.monotonic()))) is not None:
            if isinstance(arrival.message, kind) and accepts(arrival.message):
                return arrival.message
        return None


class _Waiting:
    def __init__(self, capacity: int) -> None:
        self._messages: deque[tuple[str, bytes]] = deque(maxlen=capacity)
        self._changed = threading.Condition()
        self.dropped = 0

    def put(self, sample: zenoh.Sample) -> None:
        arrived = str(sample.key_expr), sample.payload.to_bytes()
        with self._changed:
            self.dropped += len(self._messages) == self._messages.maxlen
            self._messages.append(arrived)
            self._changed.notify()

    def take(self, timeout_s: float | None) -> Arrival | None:
        end_s = None if timeout_s is None else time.monotonic() + timeout_s
        while True:
            with self._changed:
                left_s = None if end_s is None else max(0.0, end_s - time.monotonic())
                if not self._changed.wait_for(lambda: self._messages, left_s):
                    return None
                key, data = self._messages.popleft()
            address = topics.split(key)
            if address is not None:
                return Arrival(key, parse(topics.TOPIC_OF_NAME[address[2]].message, data), len(data))


class SampleStream(AbstractContextManager["SampleStream"], Iterator[Sample]):
    """Iterator over the samples of one board for a duration of its time; `rig.samples()` makes it.

    It subscribes when it is made, so no sample is missed before the loop begins.
    """

    def __init__(self, queue: MessageQueue, board: str, duration_s: float, timeout_s: float) -> None:
        self._queue, self._board = queue, board
        self._left_s, self._timeout_s = duration_s, timeout_s
        self._last: Sample | None = None

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """End the subscription."""
        self._queue.close()

    @property
    def dropped(self) -> int:
        """Samples dropped because the loop was too slow."""
        return self._queue.dropped

    def __next__(self) -> Sample:
        state = None
        while not isinstance(state, pb.State):
            arrival = self._queue.take(self._timeout_s)
            if arrival is None:
                raise NoSamplesError(
                    f"No samples from {self._board} for {self._timeout_s:g} s",
                    remedy="Look at rig.status(): gateway, link or board has failed, or its stream is off",
                )
            state = arrival.message
        sample, last = Sample.of(state), self._last
        if last is not None and last.session == sample.session:
            self._left_s -= sample.t_s - last.t_s
        self._last = sample
        if self._left_s < 1e-6:  # s; less than a tick, more than rounding errors
            self.close()
            raise StopIteration
        return sample


def check_topic(name: str) -> None:
    """Check that a client can receive a topic.

    Raises:
        UsageError: it cannot; the message lists the topics.
    """
    if name not in topics.RECEIVED:
        raise UsageError(f"{name!r} is not a topic of the bus", remedy=f"Choose among {', '.join(topics.RECEIVED)}")
