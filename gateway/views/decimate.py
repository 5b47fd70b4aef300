"""Decimates samples at the tick rate to bins with the lowest, highest and last value of each channel.  Pure.

Rule 1: no spike is lost: every finite value lies within low .. high of exactly one bin.
Rule 2: a bin covers `width_ticks` ticks and begins at a multiple of them, so two readers of one board see equal bins.
Rule 3: a bin never spans two sessions: ticks of different sessions are not comparable.
Rule 4: memory is bounded: of bins that are not taken, the oldest are dropped and counted.
Rule 5: a channel without a finite value in a bin is NaN in low, high and last of it.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

INF = math.inf


@dataclass(frozen=True, slots=True, kw_only=True)
class Bin:
    """Values within one width; `low`, `high`, `last` by the name of the channel."""

    session: int
    first_tick: int
    last_tick: int
    t_s: float  # of the last sample, on the board's clock
    host_time_ns: int  # of the last sample; 0 where the topic carries none
    samples: int
    lost: int  # missing before or within
    low: dict[str, float]
    high: dict[str, float]
    last: dict[str, float]
    message: object = None  # what the last sample came in, for all that is no number


class Decimator:
    """Bins of one topic of one board.

    Args:
        channels: names of the values, in the order in which `push` gets them.
        width_ticks: of a bin; 1 or more.
        keep: bins that may wait to be taken.
    """

    def __init__(self, channels: Sequence[str], width_ticks: int, *, keep: int = 256) -> None:
        if width_ticks < 1:
            raise ValueError(f"a bin of {width_ticks} ticks holds nothing")
        self.channels = tuple(channels)
        self.dropped = 0
        self._width = width_ticks
        self._closed: deque[Bin] = deque()
        self._keep = keep
        self._session = self._slot = -1
        self._samples = 0
        self._lost = 0
        self._first_tick = self._last_tick = 0
        self._t_s, self._host_time_ns = 0.0, 0
        self._low: list[float] = []
        self._high: list[float] = []
        self._last: Sequence[float] = ()
        self._message: object = None

    def push(
        self,
        values: Sequence[float],
        *,
        session: int,
        tick: int,
        t_s: float,
        host_time_ns: int = 0,
        lost: int = 0,
        message: object = None,
    ) -> None:
        """Add a sample: its values in the order of `channels`, NaN for absent ones, and its message."""
        slot = tick // self._width
        if slot != self._slot or session != self._session:
            self._close()
            self._slot, self._session = slot, session
            self._begin(tick)
        self._samples += 1
        self._lost += lost
        self._last_tick, self._t_s, self._host_time_ns = tick, t_s, host_time_ns
        low, high = self._low, self._high
        for n, value in enumerate(values):  # comparisons with NaN are false: it moves neither bound
            if value < low[n]:
                low[n] = value
            if value > high[n]:
                high[n] = value
        self._last, self._message = values, message

    def take(self, *, unfinished: bool = False) -> list[Bin]:
        """The finished bins since the last call, oldest first; with `unfinished`, the one being filled too.

        The bin being filled is closed then; what follows of its width comes as another bin.
        """
        if unfinished:
            self._close()
        bins = list(self._closed)
        self._closed.clear()
        return bins

    def _begin(self, tick: int) -> None:
        self._first_tick = self._last_tick = tick
        self._low = [INF] * len(self.channels)
        self._high = [-INF] * len(self.channels)
        self._samples = self._lost = 0

    def _close(self) -> None:
        if not self._samples:
            return
        low, high, last = dict[str, float](), dict[str, float](), dict[str, float]()
        for n, name in enumerate(self.channels):
            has_readings = self._low[n] <= self._high[n]
            low[name] = self._low[n] if has_readings else math.nan
            high[name] = self._high[n] if has_readings else math.nan
            last[name] = self._last[n] if has_readings else math.nan
        closed = Bin(
            session=self._session,
            first_tick=self._first_tick,
            last_tick=self._last_tick,
            t_s=self._t_s,
            host_time_ns=self._host_time_ns,
            samples=self._samples,
            lost=self._lost,
            low=low,
            high=high,
            last=last,
            message=self._message,
        )
        if len(self._closed) >= self._keep:
            self._closed.popleft()
            self.dropped += 1
        self._closed.append(closed)
        self._samples = 0
        self._slot = -1
