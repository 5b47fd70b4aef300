"""Bins of one topic for one reader: minimum, maximum and last of each floating-point value of its messages."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable, Sequence
from operator import attrgetter
from typing import Any

from google.protobuf.descriptor import FieldDescriptor
from google.protobuf.message import Message

from gateway.views.decimate import Bin, Decimator
from protocol.bus import board51_pb2 as pb


class TopicBins:
    """Bins of one topic of one board for one reader."""

    def __init__(self, message: type[Message], decimator_of: Callable[[], Decimator], lock: threading.Lock) -> None:
        self.channels = channels(message)
        self.message = message
        self._values = attrgetter(*self.channels)
        self._optional = [name for name in self.channels if _is_optional(message.DESCRIPTOR, name)]
        self._decimator, self._lock = decimator_of(), lock

    def push(self, message: Message) -> None:
        """Called by the feed, with its lock."""
        values = list(self._values(message))
        for name in self._optional:
            if not message.HasField(name):
                values[self.channels.index(name)] = math.nan
        m: pb.State = message  # type: ignore[assignment]  # the fields that all per-tick messages have
        self._decimator.push(
            values,
            session=m.session,
            tick=m.tick,
            t_s=m.t_s,
            host_time_ns=getattr(message, "host_time_ns", 0),
            lost=getattr(message, "lost_before", 0),
            message=message,
        )

    def take(self, *, unfinished: bool = False) -> list[Bin]:
        """Return the bins finished since the last call, oldest first; at most the newest 256."""
        with self._lock:
            return self._decimator.take(unfinished=unfinished)


def channels(message: type[Message]) -> tuple[str, ...]:
    """Return the names of all floating-point values of a message, such as `x_m.error` in nested messages."""
    return tuple(_doubles(message.DESCRIPTOR))


def _doubles(descriptor: Any, path: str = "") -> Sequence[str]:
    names: list[str] = []
    for field in descriptor.fields:
        if field.message_type is not None:
            names += _doubles(field.message_type, f"{path}{field.name}.")
        elif field.type == FieldDescriptor.TYPE_DOUBLE and field.name != "t_s":
            names.append(path + field.name)
    return names


def _is_optional(
    descriptor: Any,  # the stubs know two classes of descriptors
    name: str,
) -> bool:
    return name in descriptor.fields_by_name and descriptor.fields_by_name[name].has_presence
