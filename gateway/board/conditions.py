"""Content of `alarms` for one board: active conditions with their start, and acknowledgements.

No I/O.

Rule: published on change and every EVERY_S, so that a view that starts later lists earlier conditions with their start.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from protocol.bus import board51_pb2 as pb

EVERY_S = 5.0
LINK = "link-down"  # conditions that have no event of the board
LOG = "log-failing"
TO_BOARD = "board-unanswered"  # the other direction of the link; an event of this name says when it began


@dataclass(frozen=True, slots=True, kw_only=True)
class Condition:
    """An active condition."""

    text: str
    since_ns: int = 0  # Unix time; 0: not known, replaced by the time of its detection


class Standing:
    """The conditions of one board over time."""

    def __init__(self) -> None:
        self._since_ns: dict[str, int] = {}
        self._published: bytes = b""
        self._published_s = -math.inf

    def due_message(
        self,
        holding: Mapping[str, Condition],
        acknowledged: Sequence[pb.Acknowledgement],
        *,
        host_ns: int,
        now_s: float,
    ) -> pb.Alarms | None:
        """Return the message if it is due, else None.

        `host_ns` is Unix time, `now_s` monotonic.
        """
        self._since_ns = {
            name: condition.since_ns or self._since_ns.get(name, host_ns) for name, condition in holding.items()
        }
        message = pb.Alarms(acknowledged=acknowledged)
        for name, condition in holding.items():
            message.active.add(name=name, active=True, text=condition.text, host_time_ns=self._since_ns[name])
        content = message.SerializeToString()
        if content == self._published and now_s - self._published_s < EVERY_S:
            return None
        self._published, self._published_s = content, now_s
        message.host_time_ns = host_ns
        return message
