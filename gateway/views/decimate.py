"""Decimates messages at the tick rate to bins with the lowest, highest and last of each floating-point value.

Rule 1: no spike is lost: every finite value lies within low .. high of exactly one bin.
Rule 2: a bin covers `width_ticks` ticks and begins at a multiple of them, so two readers of one board see equal bins.
Rule 3: a bin never spans two sessions: ticks of different sessions are not comparable.
Rule 4: memory is bounded: of bins that are not taken, the newest MAX_BINS remain.
Rule 5: a channel without a finite value in a bin is NaN in low, high and last of it.
"""

from __future__ import annotations

import math
import threading
from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from operator import attrgetter
from typing import Any

from google.protobuf.descriptor import FieldDescriptor
from google.protobuf.message import Message

MAX_BINS = 256


@dataclass(frozen=True, slots=True)
class Bin:
    """Values within one width; `low`, `high`, `last` by the name of the channel."""

    message: Any  # the last one; every per-tick message has session, tick and t_s
    lost: int  # samples missing before or within
    low: dict[str, float]
    high: dict[str, float]
    last: dict[str, float]


class TopicBins:
    """Bins of one topic of one board for one reader.

    Args:
        message: type of the topic's messages.
        width_ticks: of a bin; 1 or more.
        lock: held by the caller of `push`.
        channels: two or more floating-point values of the message; by default all of them.
    """

    def __init__(
        self, message: type[Message], width_ticks: int, lock: threading.Lock, channels: Sequence[str] = ()
    ) -> None:
        self.channels = tuple(channels) or tuple(_doubles(message.DESCRIPTOR))
        self._values = attrgetter(*self.channels)
        optional = {field.name for field in message.DESCRIPTOR.fields if field.has_presence}
        self._optional = [n for n, name in enumerate(self.channels) if name in optional]
        self._width, self._lock = width_ticks, lock
        self._closed: deque[Bin] = deque(maxlen=MAX_BINS)
        self._slot = (-1, -1)  # session and place in it of the bin that is being filled
        self._message: Any = None  # last one of that bin; None: it is closed
        self._lost = 0
        self._low: list[float] = []
        self._high: list[float] = []
        self._last: list[float] = []

    def push(self, message: Message) -> None:
        """Add a message; called by the feed, with its lock."""
        tick: Any = message
        values = list(self._values(message))
        for n in self._optional:
            if not message.HasField(self.channels[n]):
                values[n] = math.nan
        slot = tick.session, tick.tick // self._width
        if self._message is None or slot != self._slot:
            self._close()
            self._slot, self._lost = slot, 0
            self._low, self._high = [math.inf] * len(values), [-math.inf] * len(values)
        self._lost += getattr(message, "lost_before", 0)
        low, high = self._low, self._high
        for n, value in enumerate(values):  # comparisons with NaN are false: it moves neither bound
            if value < low[n]:
                low[n] = value
            if value > high[n]:
                high[n] = value
        self._last, self._message = values, message

    def take(self, *, unfinished: bool = False) -> list[Bin]:
        """Return the bins finished since the last call, oldest first; with `unfinished`, the one being filled too.

        The bin being filled is closed then; what follows of its width comes as another bin.
        """
        with self._lock:
            if unfinished:
                self._close()
            bins = list(self._closed)
            self._closed.clear()
            return bins

    def _close(self) -> None:
        if self._message is None:
            return
        has_readings = [low <= high for low, high in zip(self._low, self._high, strict=True)]
        low, high, last = (
            {n: v if good else math.nan for n, v, good in zip(self.channels, values, has_readings, strict=True)}
            for values in (self._low, self._high, self._last)
        )
        self._closed.append(Bin(self._message, self._lost, low, high, last))
        self._message = None


def _doubles(descriptor: Any, path: str = "") -> Iterator[str]:
    """Yield the names of all floating-point values of a message, such as `x_m.error` in nested messages."""
    for field in descriptor.fields:
        if field.message_type is not None:
            yield from _doubles(field.message_type, f"{path}{field.name}.")
        elif field.type == FieldDescriptor.TYPE_DOUBLE and field.name != "t_s":
            yield path + field.name
