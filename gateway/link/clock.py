"""Host time of samples: Unix time that does not step, derived from the monotonic clock.

Unix time is read once, at the start of a session, and advanced by the monotonic clock.  A step of the host's clock
(NTP after boot, a manual change) is detected and reported; it affects the samples from the next session on.
"""

from __future__ import annotations

import time
from collections.abc import Callable

STEP_NS = 100_000_000  # slewing by NTP is at most 0.5 ms/s; a change of 100 ms between two looks (1 s) is a step


class HostClock:
    """Compares the wall clock (Unix time) with the monotonic one."""

    def __init__(
        self, wall_ns: Callable[[], int] = time.time_ns, mono_ns: Callable[[], int] = time.monotonic_ns
    ) -> None:
        self._wall_ns, self._mono_ns = wall_ns, mono_ns
        self._last_offset_ns = self.offset_ns()

    def offset_ns(self) -> int:
        """Return the current Unix time minus monotonic time, ns."""
        before = self._mono_ns()
        wall = self._wall_ns()
        # The mean of two readings: being descheduled between them would shift every sample of the session.
        return wall - (before + self._mono_ns()) // 2

    def step_ns(self) -> int:
        """Return the step of the wall clock since the last call, or 0.  Call it about once a second."""
        offset = self.offset_ns()
        step = offset - self._last_offset_ns
        self._last_offset_ns = offset
        return step if abs(step) >= STEP_NS else 0
