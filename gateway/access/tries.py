"""Rate limit of password attempts, by source and not by user name.  Pure: the caller gives the time.

A lock on a name would let any client lock out the operator.  Here each source has a lane of its own: BURST attempts at
once, then one in PACE_S, in the order of arrival.

Rule 1: a source is an address (for IPv6 its /64 network).  After a successful login, two more lanes are separate
        from the attempts of others.  One is for that name from that address, one for the browser with the cookie of its
        last session.
Rule 2: all sources without a successful login together are limited to one attempt in TOGETHER_PACE_S.  A flood from
        many addresses therefore does not use up the processor.  Other users are not delayed by it.
Rule 3: an attempt that would wait longer than the caller's patience is refused at once with the waiting time, and does
        not count.  So at most patience / PACE_S attempts wait in a lane.
Rule 4: a right password counts only RIGHT_COST of an attempt, because all clients of a plant may reconnect at once.
Rule 5: memory is bounded: the lane that was idle for the longest time is dropped.
"""

from __future__ import annotations

import ipaddress
import logging
from collections import OrderedDict
from collections.abc import Hashable
from dataclasses import dataclass

from gateway.board.limits import TokenBucket

BURST = 5
PACE_S = 1.0
TOGETHER_BURST = 20
TOGETHER_PACE_S = 0.2  # a quarter of one core, as an attempt takes 50 ms
RIGHT_COST = 0.25
MAX_TRACKED = 1000
_logger = logging.getLogger("gateway.access")


@dataclass(frozen=True, slots=True, kw_only=True)
class Turn:
    """The permission for an attempt."""

    granted: bool  # False: refused; another attempt is possible after `wait_s`
    wait_s: float
    now_s: float  # of the request
    lanes: tuple[TokenBucket, ...]


class Tries:
    """The lanes of one server."""

    def __init__(self) -> None:
        self._lanes: OrderedDict[Hashable, TokenBucket] = OrderedDict()
        self._strangers = TokenBucket(TOGETHER_BURST, 1.0 / TOGETHER_PACE_S)
        self._known: OrderedDict[Hashable, None] = OrderedDict()

    def turn(self, name: str, host: str, now_s: float, *, patience_s: float, browser: str = "") -> Turn:
        """Request an attempt, for which the caller waits `patience_s` at most.

        `browser` is the token of a present or past session of this browser under this name; empty: none.
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
        wait_s = max(bucket.wait_s(1.0, now_s) for bucket in lanes)
        granted = wait_s <= patience_s
        if granted:
            free = lane.wait_s(1.0, now_s) == 0.0
            for bucket in lanes:
                bucket.take(1.0, now_s)
            if free and lane.wait_s(1.0, now_s) > 0.0:  # once for each flood
                _logger.warning(
                    "many password attempts from %s: from now on it has one attempt per %g s", source, PACE_S
                )
        return Turn(granted=granted, wait_s=wait_s, now_s=now_s, lanes=lanes)

    def right(self, turn: Turn, name: str, host: str) -> None:
        """Record that the password of this attempt was right."""
        for lane in turn.lanes:
            lane.take(RIGHT_COST - 1.0, turn.now_s)
        self._known[name, network(host)] = None
        self._known.move_to_end((name, network(host)))
        _shorten(self._known)

    def _lane(self, key: Hashable) -> TokenBucket:
        lane = self._lanes.setdefault(key, TokenBucket(BURST, 1.0 / PACE_S))
        self._lanes.move_to_end(key)
        _shorten(self._lanes)
        return lane


def network(host: str) -> str:
    """Return the addresses that count as one machine: an IPv4 address, or the /64 network of an IPv6 address."""
    try:
        address = ipaddress.ip_address(host.partition("%")[0])
    except ValueError:
        return host
    if isinstance(address, ipaddress.IPv4Address):
        return str(address)
    if address.ipv4_mapped is not None:
        return str(address.ipv4_mapped)
    return str(ipaddress.ip_network((address, 64), strict=False))


def _shorten(retained: OrderedDict[Hashable, TokenBucket] | OrderedDict[Hashable, None]) -> None:
    while len(retained) > MAX_TRACKED:
        retained.popitem(last=False)
