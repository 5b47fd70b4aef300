"""What `alarms` says of one board: the conditions that the gateway knows to hold, since when, and who has seen what.

No I/O.

Rule: told on change and every EVERY_S, so that a view which starts later lists what it has missed, with its first time.
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
    """Something that is wrong now."""

    text: str
    since_ns: int = 0  # Unix time; 0: not known, so when it was first seen


class Standing:
    """The conditions of one board over time."""

    def __init__(self) -> None:
        self._since_ns: dict[str, int] = {}
        self._told: bytes = b""
        self._told_s = -math.inf

    def tell(
        self,
        holding: Mapping[str, Condition],
        acknowledged: Sequence[pb.Acknowledgement],
        *,
        host_ns: int,
        now_s: float,
    ) -> pb.Alarms | None:
        """The message, where it is time for one.

        Args:
            holding: what is wrong now, by name.
            acknowledged: what was seen, and by whom.
            host_ns: Unix time.
            now_s: monotonic.
        """
        self._since_ns = {
            name: condition.since_ns or self._since_ns.get(name, host_ns) for name, condition in holding.items()
        }
        message = pb.Alarms(acknowledged=acknowledged)
        for name, condition in holding.items():
            message.active.add(name=name, active=True, text=condition.text, host_time_ns=self._since_ns[name])
        content = message.SerializeToString()
        if content == self._told and now_s - self._told_s < EVERY_S:
            return None
        self._told, self._told_s = content, now_s
        message.host_time_ns = host_ns
        return message
