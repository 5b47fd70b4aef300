"""The board's clock on the host's time axis: evenly spaced source timestamps without the jitter of the link.  Pure.

A sample's arrival is late by the link's latency, which varies; its tick is exact but of an unknown origin.  The origin
is estimated per session.  Early arrivals pull it at once, because a sample cannot arrive before it was made.  Late ones
pull it slowly, so that it follows the drift of the quartz and not the queue.
"""

from __future__ import annotations

PULL = 0.002  # share of a late arrival's error taken per sample
JUMP_NS = 500_000_000  # a clock that was set, or a long gap: restart the estimate


class StampClock:
    """Stamps of one board, in ns of Unix time; strictly increasing."""

    def __init__(self) -> None:
        self._session: int | None = None
        self._origin_ns = 0
        self._newest_ns = 0

    def stamp(self, *, session: int, t_s: float, host_time_ns: int) -> int:
        """Return the time of the sample with board time `t_s`; `host_time_ns` is 0 if its arrival is not known."""
        t_ns = round(t_s * 1e9)
        if host_time_ns:
            delay_ns = host_time_ns - (self._origin_ns + t_ns)
            if session != self._session or abs(delay_ns) > JUMP_NS:
                self._origin_ns = host_time_ns - t_ns
            else:
                self._origin_ns += delay_ns if delay_ns < 0 else round(PULL * delay_ns)
            self._session = session
        self._newest_ns = max(self._newest_ns + 1000, self._origin_ns + t_ns)  # Python's datetime counts in us
        return self._newest_ns

    def time_ns(self, t_s: float) -> int:
        """Return the time of another message of the same session, such as the twin's, without updating the estimate."""
        return self._origin_ns + round(t_s * 1e9)
