"""The host's time for samples: Unix time that never steps, carried by the monotonic clock.

Unix time is read once, when a session begins, and the monotonic clock takes it on from there.  A step of the host's
clock (NTP after boot, a hand on `date`) is noticed and told, and reaches the samples with the next session only.
"""

from __future__ import annotations

import time
from collections.abc import Callable

STEP_NS = 100_000_000  # slewing by NTP is at most 0.5 ms/s; a change of 100 ms between two looks (1 s) is a step


class HostClock:
    """Compares the wall clock with the monotonic one.

    Args:
        wall_ns: Unix time, ns.
        mono_ns: monotonic time, ns.
    """

    def __init__(
        self, wall_ns: Callable[[], int] = time.time_ns, mono_ns: Callable[[], int] = time.monotonic_ns
    ) -> None:
        self._wall_ns, self._mono_ns = wall_ns, mono_ns
        self._seen_offset_ns = self.offset_ns()

    def offset_ns(self) -> int:
        """Unix time minus monotonic time, now."""
        before = self._mono_ns()
        wall = self._wall_ns()
        # The mean of two readings: being descheduled between them would shift every sample of the session.
        return wall - (before + self._mono_ns()) // 2

    def step_ns(self) -> int:
        """By how much the wall clock stepped since the last call; 0 where it did not.  Call it about once a second."""
        offset = self.offset_ns()
        step = offset - self._seen_offset_ns
        self._seen_offset_ns = offset
        return step if abs(step) >= STEP_NS else 0
