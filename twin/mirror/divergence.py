"""Measured against twin: error, normalised error, rolling RMSE and fit per signal, innovations, and what they alarm.

Rule 1: windows hold samples of one uninterrupted time in step; whatever interrupts it empties them.
Rule 2: sums are kept incrementally and recomputed from the stored values once per window, so rounding never accumulates
        over more than one window: after a week the figures are those of a fresh start.
Rule 3: a figure that does not exist is NaN, never 0.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from protocol.bus import board51_pb2 as pb
from twin.compiled import kernel
from twin.mirror.alarms import WindowAlarm
from twin.mirror.expected import Expectation
from twin.mirror.regime import Regime


@kernel
def push(ring: NDArray[np.float64], sums: NDArray[np.float64], count: int, a: float, b: float, c: float) -> None:
    """Put the row (a, b, c) into slot count % n of `ring`, shape (n, 3); keep `sums`, shape (3,), over the window."""
    n = ring.shape[0]
    slot = count % n
    if count >= n:
        for column in range(3):
            sums[column] -= ring[slot, column]
    ring[slot, 0] = a
    ring[slot, 1] = b
    ring[slot, 2] = c
    for column in range(3):
        sums[column] += ring[slot, column]
    if slot == n - 1:
        for column in range(3):
            total = 0.0
            for k in range(n):
                total += ring[k, column]
            sums[column] = total


class Window:
    """The last `length` samples of one signal."""

    def __init__(self, length: int) -> None:
        self._length = length
        self._ring = np.zeros((length, 3))
        self._sums = np.zeros(3)
        self._count = 0
        self._origin = 0.0

    def clear(self) -> None:
        """Forget everything: what follows is not continuous with what was."""
        self._count = 0
        self._sums[:] = 0.0

    def add(self, *, square: float, measured: float) -> None:
        """Take one sample, finite: the square whose mean is wanted, and the signal itself."""
        if self._count == 0:
            self._origin = measured  # squares of values near 0 keep their digits
        y = measured - self._origin
        push(self._ring, self._sums, self._count, square, y, y * y)
        self._count += 1

    @property
    def full(self) -> bool:
        """Whether the window has its full length."""
        return self._count >= self._length

    def mean_square(self) -> float:
        """Over the samples so far; NaN without any."""
        return max(float(self._sums[0]), 0.0) / min(self._count, self._length) if self._count else math.nan

    def fit_percent(self) -> float:
        """100 (1 - |error| / |y - mean y|) over a full window in which the signal moves; else NaN."""
        if not self.full:
            return math.nan
        variance = float(self._sums[2]) / self._length - (float(self._sums[1]) / self._length) ** 2
        return 100.0 * (1.0 - math.sqrt(self.mean_square() / variance)) if variance > 0.0 else math.nan


class Comparison:
    """Windows and alarms of one board."""

    def __init__(self) -> None:
        self.error_alarms = (WindowAlarm("divergence-x", window=2), WindowAlarm("divergence-i_c", window=2))
        self.innovation_alarm = WindowAlarm("innovation", window=2)
        self.start(2)

    def start(self, window: int) -> None:
        """Empty windows of `window` ticks."""
        self._x, self._i, self._u, self._nis = (Window(window) for _ in range(4))
        for alarm in self.error_alarms:
            alarm.clear_window(window=window)
        self.innovation_alarm.clear_window(window=window)

    def interrupt(self) -> None:
        """The twin is not where it was: nothing before this may be averaged with what comes."""
        for window in (self._x, self._i, self._u):
            window.clear()
        for alarm in self.error_alarms:
            alarm.clear_window()

    def drop_alarms(self) -> list[pb.Alarm]:
        """The mode has changed: alarms of the mode before are over."""
        ended = [alarm.drop() for alarm in (*self.error_alarms, self.innovation_alarm)]
        return [alarm for alarm in ended if alarm is not None]

    def free(
        self,
        into: pb.Divergence,
        *,
        measured: tuple[float, float, float],
        twin: tuple[float, float, float],
        expected: Expectation,
        in_step: bool,
        judge: bool,
    ) -> list[pb.Alarm]:
        """Fill in the free twin's part: (x, i_c, u_c) in m, A, V; NaN where not measured.

        `in_step` lets the windows take the sample, `judge` lets the alarm have its say too.
        """
        targets = (into.x_m, into.i_c_a, into.u_c_v)
        for k, window in enumerate((self._x, self._i, self._u)):
            error = measured[k] - twin[k]
            if not math.isfinite(error):
                window.clear()
            elif in_step:
                window.add(square=error * error, measured=measured[k])
            signal = targets[k]
            signal.error = error
            signal.normalised = error / expected.std[k]
            signal.rolling_rmse = math.sqrt(window.mean_square())
            signal.fit_percent = window.fit_percent()
            signal.window_full = window.full
        if not (judge and in_step):
            return []
        changes = []
        for k, alarm in enumerate(self.error_alarms):
            if math.isfinite(targets[k].normalised):
                changes.append(alarm.add(targets[k].normalised ** 2, on=expected.on[k], off=expected.off[k]))
        return [change for change in changes if change is not None]

    def innovation(
        self, into: pb.Divergence, regime: Regime, *, n_i: float, n_x: float, nis: float, valid: bool
    ) -> pb.Alarm | None:
        """Fill in the observer's part."""
        into.innovation_i_c_a = n_i
        into.innovation_x_m = n_x
        into.nis = nis
        into.innovation_valid = valid
        if not valid:
            into.nis_mean = math.nan
            self._nis.clear()
            self.innovation_alarm.clear_window()
            return None
        self._nis.add(square=nis, measured=0.0)
        into.nis_mean = self._nis.mean_square()
        return self.innovation_alarm.add(nis, on=regime.nis_on, off=regime.nis_off)
