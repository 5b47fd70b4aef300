"""Windows of uninterrupted flight, cut from the samples of a board.  Pure.

Rule: a window has samples with a valid innovation only.  So a coil that is switched off, a landing, a gap and a start
      are in none: the observer, which is not valid there, knows them (`twin/mirror/observer.py`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from twin.estimation.record import FloatArray
from twin.mirror.output import Output
from twin.settings.naming import MAX_SAMPLES, WINDOW_S


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Window:
    """Samples of one flight, one tick apart."""

    session: int
    from_s: float  # board's clock, first sample
    to_s: float  # last sample
    from_ns: int  # gateway's clock, first sample
    sample_time_s: float
    i_lsb_a: float  # one count of the converters; 0: unknown
    x_lsb_m: float
    readings: FloatArray  # u_c, i_c, x; shape (n, 3)


class Windows:
    """Cuts windows of WINDOW_S; faster boards fill MAX_SAMPLES and pause until the next window is due."""

    def __init__(self) -> None:
        self._rows: list[tuple[float, float, float]] = []
        self._from_s = self._due_s = 0.0
        self._from_ns = 0

    def take(
        self, output: Output, host_time_ns: int, *, sample_time_s: float, i_lsb_a: float, x_lsb_m: float
    ) -> Window | None:
        """Take a sample; the window that it completes."""
        sample = output.sample
        if output.answer is None or not output.answer[0][4]:
            self._rows.clear()
            self._due_s = 0.0
            return None
        if not self._rows:
            if sample.t_s < self._due_s:
                return None
            self._from_s, self._from_ns = sample.t_s, host_time_ns
        self._rows.append((sample.u, sample.i, sample.x))
        if len(self._rows) < min(round(WINDOW_S / sample_time_s), MAX_SAMPLES):
            return None
        readings, self._rows = np.array(self._rows), []
        # From the first sample, not the last: fast and slow boards then have the same pace.
        self._due_s = self._from_s + WINDOW_S
        return Window(
            session=sample.session,
            from_s=self._from_s,
            to_s=sample.t_s,
            from_ns=self._from_ns,
            sample_time_s=sample_time_s,
            i_lsb_a=i_lsb_a,
            x_lsb_m=x_lsb_m,
            readings=readings,
        )
