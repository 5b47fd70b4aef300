"""How often passwords may be tried: by where they come from, never by whose name is tried.  Pure: time comes in.

A lock on a name would let anybody lock out the operator.  Here every source of logins has a lane of its own: BURST
tries at once, then one in PACE_S, in the order in which they came.

Rule 1: a lane is an address (of IPv6 its /64 network).  Who came in with the right password has further lanes, which
        others' tries do not fill: one for that name from that address, and one for the browser that still shows the
        cookie of its last session.
Rule 2: the lanes of strangers, taken together, move on at TOGETHER_PACE_S: a flood from many addresses must not take
        the processor.  It does not hold up those who came in before.
Rule 3: a try that would have to wait for longer than the caller's patience is refused at once, with the time, and
        leaves no trace.  So at most patience / PACE_S tries wait in a lane.
Rule 4: a right password costs RIGHT_COST of a wrong one: a plant's clients may all come back at once.
Rule 5: memory is bounded: the lane that was idle longest makes room.
"""

from __future__ import annotations

import ipaddress
import logging
from collections import OrderedDict
from collections.abc import Hashable
from dataclasses import dataclass

BURST = 5
PACE_S = 1.0
TOGETHER_BURST = 20
TOGETHER_PACE_S = 0.2  # of two cores a quarter of one: a try costs 50 ms
RIGHT_COST = 0.25
MAX_TRACKED = 1000
_logger = logging.getLogger("gateway.access")


@dataclass(slots=True)
class Lane:
    """A queue without a queue: it knows only when the next try would be due if there were no burst."""

    burst: int = BURST
    pace_s: float = PACE_S
    due_s: float = float("-inf")

    def wait_s(self, now_s: float) -> float:
        """For how long a try that comes now has to wait."""
        return max(0.0, self.due_s - now_s - (self.burst - 1) * self.pace_s)

    def take(self, now_s: float) -> None:
        """A try is under way, or waits."""
        self.due_s = max(self.due_s, now_s) + self.pace_s

    def give_back(self) -> None:
        """It was the right one."""
        self.due_s -= (1.0 - RIGHT_COST) * self.pace_s


@dataclass(frozen=True, slots=True, kw_only=True)
class Turn:
    """When a try may be made."""

    granted: bool  # else not at all: come again when `wait_s` is over
    wait_s: float
    lanes: tuple[Lane, ...]


class Tries:
    """All lanes of one server."""

    def __init__(self) -> None:
        self._lanes: OrderedDict[Hashable, Lane] = OrderedDict()
        self._strangers = Lane(burst=TOGETHER_BURST, pace_s=TOGETHER_PACE_S)
        self._known: OrderedDict[Hashable, None] = OrderedDict()

    def turn(self, name: str, host: str, now_s: float, *, patience_s: float, browser: str = "") -> Turn:
        """The turn of a try that comes now.

        Args:
            name: that is tried.
            host: address that it comes from.
            now_s: monotonic.
            patience_s: for how long the caller would wait.
            browser: token of a session that this browser has or had under this name; empty: none.
        """
        source, stranger = network(host), False
        if browser:
            lane = self._lane((name, browser))
        elif (name, source) in self._known:
            self._known.move_to_end((name, source))
            lane = self._lane((name, source))
        else:
            lane, stranger = self._lane(source), True
        lanes = (lane, self._strangers) if stranger else (lane,)
        wait_s = max(one.wait_s(now_s) for one in lanes)
        granted = wait_s <= patience_s
        if granted:
            free = lane.wait_s(now_s) == 0.0
            for one in lanes:
                one.take(now_s)
            if free and lane.wait_s(now_s) > 0.0:  # told once for each flood
                _logger.warning("many passwords are tried from %s: from now on one in %g s", source, lane.pace_s)
        return Turn(granted=granted, wait_s=wait_s, lanes=lanes)

    def right(self, turn: Turn, name: str, host: str) -> None:
        """The try of this turn had the right password."""
        for lane in turn.lanes:
            lane.give_back()
        self._known[name, network(host)] = None
        self._known.move_to_end((name, network(host)))
        _shorten(self._known)

    def _lane(self, key: Hashable) -> Lane:
        lane = self._lanes.setdefault(key, Lane())
        self._lanes.move_to_end(key)
        _shorten(self._lanes)
        return lane


def network(host: str) -> str:
    """What one machine has of addresses: one of IPv4, a /64 of IPv6."""
    try:
        address = ipaddress.ip_address(host.partition("%")[0])
    except ValueError:
        return host
    if isinstance(address, ipaddress.IPv4Address):
        return str(address)
    if address.ipv4_mapped is not None:
        return str(address.ipv4_mapped)
    return str(ipaddress.ip_network((address, 64), strict=False))


def _shorten(retained: OrderedDict[Hashable, Lane] | OrderedDict[Hashable, None]) -> None:
    while len(retained) > MAX_TRACKED:
        retained.popitem(last=False)
