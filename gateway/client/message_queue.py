"""A queue of bus messages in the order of arrival, for a loop that reads at its own pace.

A full queue drops the OLDEST message and counts it, because zenoh's thread must not wait for a slow reader.
"""

from __future__ import annotations

import threading
import time
import weakref
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from typing import NamedTuple, Self, TypeVar

import zenoh
from google.protobuf.message import Message

from gateway.client.connection import BusBoard, Subscription
from protocol.bus import topics
from protocol.bus.encoding import parse
from protocol.errors import UsageError

M = TypeVar("M", bound=Message)
CAPACITY = 100_000  # messages: 200 s of one board's samples


class Arrival(NamedTuple):
    """A message of the bus, as it arrived."""

    key: str
    message: Message | None  # None: the bytes are no valid message
    size: int  # of the payload, bytes


class MessageQueue(Iterator[Message]):
    """The messages of some topics from now on: an iterator that ends when it is closed or garbage-collected.

    Args:
        board: the board, or every board.
        names: of topics.
        capacity: of the queue, messages.
        timeout_s: time without a message after which an iteration ends, s; None: no end.
    """

    def __init__(
        self,
        board: BusBoard,
        names: Iterable[str],
        *,
        capacity: int = CAPACITY,
        timeout_s: float | None = None,
    ) -> None:
        self._waiting = _Waiting(capacity)
        self._timeout_s = timeout_s
        subscription = Subscription(board.session, [f"{board}/{name}" for name in names], self._waiting.put)
        # The callbacks refer to the queue and not to the feed, so that a loop left with `break` ends the subscription.
        self._end = weakref.finalize(self, subscription.close)

    def __enter__(self) -> Self:
        return self

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
        self._messages: deque[tuple[str, bytes]] = deque()
        self._capacity = capacity
        self._changed = threading.Condition()
        self.dropped = 0

    def put(self, sample: zenoh.Sample) -> None:
        arrived = str(sample.key_expr), sample.payload.to_bytes()
        with self._changed:
            if len(self._messages) >= self._capacity:
                self._messages.popleft()
                self.dropped += 1
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


def check_topic(name: str) -> None:
    """Check that a client can receive a topic.

    Raises:
        UsageError: it cannot; the message lists the topics.
    """
    if (
        name not in topics.TOPIC_OF_NAME
        or topics.TOPIC_OF_NAME[name].source == "client"
        or not topics.TOPIC_OF_NAME[name].bus
    ):
        available = ", ".join(topic.name for topic in topics.TOPICS if topic.bus and topic.source != "client")
        raise UsageError(f"{name!r} is not a topic of the bus", remedy=f"Choose among {available}")
