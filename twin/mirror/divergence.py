"""Measured against twin: error, normalised error, rolling RMSE and fit per signal, innovations, and what they alarm.

Rule 1: windows hold samples of one uninterrupted time in step; whatever interrupts it empties them.
Rule 2: sums are kept incrementally and recomputed from the stored values once per window, so rounding never accumulates
        over more than one window: after a week the figures are those of a fresh start.
Rule 3: a figure that does not exist is NaN, never 0.
"""

from __future__ import annotations

import math
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from protocol.bus import board51_pb2 as pb
from twin.compiled import kernel
from twin.mirror.alarms import WindowAlarm
from twin.mirror.expected import Expectation
from twin.mirror.regime import Regime

Triple: TypeAlias = tuple[float, float, float]  # of x, i_c, u_c in m, A, V
Figures: TypeAlias = tuple[float, float, float, float, bool]  # error, normalised, rolling RMSE, fit %, window full


@kernel
def push(ring: NDArray[np.float64], sums: NDArray[np.float64], count: int, square: float, y: float) -> None:
    """Put (square, y, y^2) into slot count % n of `ring`, shape (n, 3), keeping its column `sums`, shape (3,)."""
    n = ring.shape[0]
    slot = count % n
    if count >= n:
        for column in range(3):
            sums[column] -= ring[slot, column]
    ring[slot, 0] = square
    ring[slot, 1] = y
    ring[slot, 2] = y * y
    for column in range(3):
        sums[column] += ring[slot, column]
    if slot == n - 1:
        for column in range(3):
            total = 0.0
            for k in range(n):
                total += ring[k, column]
            sums[column] = total


@kernel
def push_and_mean(ring: NDArray[np.float64], sums: NDArray[np.float64], count: int, square: float) -> float:
    """`push` of a square alone; returns its mean over the window."""
    push(ring, sums, count, square, 0.0)
    mean: float = max(sums[0], 0.0) / min(count + 1, ring.shape[0])
    return mean


@kernel
def figures(
    ring: NDArray[np.float64],
    sums: NDArray[np.float64],
    origin: NDArray[np.float64],
    counts: NDArray[np.int64],
    totals: NDArray[np.float64],
    signal: int,
    measured: float,
    twin: float,
    std: float,
    in_step: bool,
) -> Figures:
    """Take one sample of one signal, if in step, and return its figures; NaN restarts the signal's window.

    ring, shape (3, n, 3); sums, shape (3, 3); origin and counts, shape (3,): of the signal's first sample in the
    window (squares of values near 0 keep their digits) and of the samples taken; totals, shape (3, 3): samples in
    step, sum of errors, sum of their squares, never cleared.
    """
    n = ring.shape[1]
    error = measured - twin
    if not math.isfinite(error):
        counts[signal] = 0
        sums[signal] = 0.0
    elif in_step:
        if counts[signal] == 0:
            origin[signal] = measured
        push(ring[signal], sums[signal], counts[signal], error * error, measured - origin[signal])
        counts[signal] += 1
        totals[signal, 0] += 1.0
        totals[signal, 1] += error
        totals[signal, 2] += error * error
    held = min(counts[signal], n)
    full = counts[signal] >= n
    rmse = math.nan
    fit = math.nan
    if held > 0:
        mean_square = max(sums[signal, 0], 0.0) / held
        rmse = math.sqrt(mean_square)
        mean = sums[signal, 1] / held
        variance = sums[signal, 2] / held - mean * mean
        if full and variance > 0.0:
            fit = 100.0 * (1.0 - math.sqrt(mean_square / variance))
    return error, error / std, rmse, fit, full


@kernel
def all_figures(
    ring: NDArray[np.float64],
    sums: NDArray[np.float64],
    origin: NDArray[np.float64],
    counts: NDArray[np.int64],
    totals: NDArray[np.float64],
    measured: Triple,
    twin: Triple,
    std: Triple,
    in_step: bool,
) -> tuple[Figures, Figures, Figures]:
    """`figures` of x, i_c and u_c."""
    return (
        figures(ring, sums, origin, counts, totals, 0, measured[0], twin[0], std[0], in_step),
        figures(ring, sums, origin, counts, totals, 1, measured[1], twin[1], std[1], in_step),
        figures(ring, sums, origin, counts, totals, 2, measured[2], twin[2], std[2], in_step),
    )


class SignalWindows:
    """The last `length` samples in step of x, i_c and u_c."""

    def __init__(self, length: int, totals: NDArray[np.float64]) -> None:
        self._totals = totals
        self._ring = np.zeros((3, length, 3))
        self._sums = np.zeros((3, 3))
        self._origin = np.zeros(3)
        self._counts = np.zeros(3, dtype=np.int64)

    def clear(self) -> None:
        """Forget everything: what follows is not continuous with what was."""
        self._sums[:] = 0.0
        self._counts[:] = 0

    def add(self, measured: Triple, twin: Triple, std: Triple, *, in_step: bool) -> tuple[Figures, Figures, Figures]:
        """Take one sample (its values may be NaN) and return the figures of the three signals."""
        return all_figures(
            self._ring, self._sums, self._origin, self._counts, self._totals, measured, twin, std, in_step
        )


class MeanWindow:
    """Rolling mean of the NIS."""

    def __init__(self, length: int) -> None:
        self._ring = np.zeros((length, 3))
        self._sums = np.zeros(3)
        self._count = 0

    def clear(self) -> None:
        """Forget everything."""
        self._sums[:] = 0.0
        self._count = 0

    def add(self, value: float) -> float:
        """Take one finite value; returns the mean over the samples so far, at most the window."""
        mean = push_and_mean(self._ring, self._sums, self._count, value)
        self._count += 1
        return mean


class Comparison:
    """Windows and alarms of one board."""

    def __init__(self) -> None:
        self.error_alarms = (WindowAlarm("divergence-x", window=2), WindowAlarm("divergence-i_c", window=2))
        self.innovation_alarm = WindowAlarm("innovation", window=2)
        # x, i_c, u_c over all time in step: samples, sum of errors, sum of squares.
        self.error_totals = np.zeros((3, 3))
        # Innovations: samples, sums of the squares of x and of i_c, sum of the NIS.
        self.innovation_totals = [0.0, 0.0, 0.0, 0.0]
        self._unseen_ticks = 0  # without a valid innovation, in a row
        self.start(2)

    def start(self, window: int) -> None:
        """Empty windows of `window` ticks."""
        self._signals, self._nis = SignalWindows(window, self.error_totals), MeanWindow(window)
        for alarm in self.error_alarms:
            alarm.clear_window(window=window)
        self.innovation_alarm.clear_window(window=window)

    def interrupt(self) -> None:
        """The twin is not where it was: nothing before this may be averaged with what comes."""
        self._signals.clear()
        for alarm in self.error_alarms:
            alarm.clear_window()

    def drop_error_alarms(self) -> list[pb.Alarm]:
        """The mode has changed: what the free twin did in the mode before is over."""
        ended = [alarm.drop() for alarm in self.error_alarms]
        return [alarm for alarm in ended if alarm is not None]

    def free(
        self,
        into: pb.Divergence,
        measured: Triple,
        twin: Triple,
        expected: Expectation,
        in_step: bool,
        judge: bool,
    ) -> list[pb.Alarm]:
        """Fill in the free twin's part: (x, i_c, u_c) in m, A, V; NaN where not measured.

        `in_step` lets the windows take the sample, `judge` lets the alarm have its say too.
        """
        figures_of = self._signals.add(measured, twin, expected.std, in_step=in_step)
        for signal, (error, normalised, rmse, fit, full) in zip(
            (into.x_m, into.i_c_a, into.u_c_v), figures_of, strict=True
        ):
            signal.error = error
            signal.normalised = normalised
            signal.rolling_rmse = rmse
            signal.fit_percent = fit
            signal.window_full = full
        changes: list[pb.Alarm] = []
        if judge and in_step:
            for k, alarm in enumerate(self.error_alarms):
                normalised = figures_of[k][1]
                if math.isfinite(normalised):
                    change = alarm.add(normalised * normalised, on=expected.on[k], off=expected.off[k])
                    if change is not None:
                        changes.append(change)
        return changes

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
            self._unseen_ticks += 1
            return self.innovation_alarm.drop() if self._unseen_ticks > regime.window else None
        self._unseen_ticks = 0
        totals = self.innovation_totals
        totals[0] += 1.0
        totals[1] += n_x * n_x
        totals[2] += n_i * n_i
        totals[3] += nis
        into.nis_mean = self._nis.add(nis)
        return self.innovation_alarm.add(nis, on=regime.nis_on, off=regime.nis_off)
