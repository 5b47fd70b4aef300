"""Measured against twin: error, normalised error, rolling RMSE and fit per signal, innovations, and their alarms.

Rule 1: a window holds samples of one uninterrupted time in step; an interruption empties it.
Rule 2: sums are kept incrementally and recomputed from the stored values once per window.  So rounding never
        accumulates over more than one window: after a week the figures are those of a fresh start.
Rule 3: a figure that does not exist is NaN, never 0.
Rule 4: an alarm that no sample has judged for some time ends without a decision.  For the innovation this time is a
        window.  Errors are not judged while the twin settles, so it is a window and the longest settling time.
"""

from __future__ import annotations

import math
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from protocol.bus import board51_pb2 as pb
from twin.compiled import kernel
from twin.mirror.monitor.alarms import PLACES, UNCHANGED, clear_window, decide, end, message

# error, normalised, rolling RMSE, rolling mean, fit %, window full
Figures: TypeAlias = tuple[float, float, float, float, float, bool]

X, I_C, U_C, NIS = 0, 1, 2, 3  # rows of the windows: errors of three signals, and the NIS
SQUARE, Y, Y_SQUARE, VALUE = 0, 1, 2, 3  # columns of `ring`, and of `sums` over the window
UNSEEN = 4  # in `counts`, one for each alarm: samples in a row that did not judge it
HOLD = 7  # in `counts`: how many such samples end an alarm on errors
ORIGIN = 4  # in `sums`: the signal's first value in the window, subtracted so that squares keep their digits
ALARMS = ("innovation", "divergence-x", "divergence-i_c")


class Windows(NamedTuple):
    """The arrays of `Comparison`, as the kernels take them."""

    ring: NDArray[np.float64]  # (value^2, y, y^2, value) by X, I_C, U_C, NIS, shape (4, window, 4)
    sums: NDArray[np.float64]  # over the window, and ORIGIN, shape (4, 5)
    counts: NDArray[np.int64]  # of samples taken since the window was emptied, UNSEEN and HOLD, shape (8,)
    totals: NDArray[np.float64]  # over all time, shape (4, 4)
    alarms: NDArray[np.float64]  # shape (3, PLACES)


@kernel
def push(ring: NDArray[np.float64], sums: NDArray[np.float64], count: int, value: float, y: float) -> None:
    """Put (value^2, y, y^2, value) into slot count % n of `ring`, shape (n, 4), and update the sums, sums[:4]."""
    n = ring.shape[0]
    slot = count % n
    if count >= n:
        for column in range(ORIGIN):
            sums[column] -= ring[slot, column]
    ring[slot, SQUARE] = value * value
    ring[slot, Y] = y
    ring[slot, Y_SQUARE] = y * y
    ring[slot, VALUE] = value
    for column in range(ORIGIN):
        sums[column] += ring[slot, column]
    # Once per window: at each sample this pass would cost too much, and without it rounding errors would accumulate.
    if slot == n - 1:
        for column in range(ORIGIN):
            total = 0.0
            for k in range(n):
                total += ring[k, column]
            sums[column] = total


@kernel
def rolling_mean(
    ring: NDArray[np.float64], sums: NDArray[np.float64], counts: NDArray[np.int64], row: int, value: float
) -> float:
    """Add one finite value and return the mean of the window, or of all values if they are fewer."""
    push(ring[row], sums[row], counts[row], value, 0.0)
    counts[row] += 1
    mean: float = max(sums[row, VALUE], 0.0) / min(counts[row], ring.shape[1])
    return mean


@kernel
def figures(w: Windows, row: int, measured: float, twin: float, std: float, in_step: bool) -> Figures:
    """Take one sample of one signal, if in step, and return its figures; NaN restarts the signal's window."""
    ring, sums, counts, totals, _ = w
    n = ring.shape[1]
    error = measured - twin
    if not math.isfinite(error):
        counts[row] = 0
        sums[row] = 0.0
    elif in_step:
        if counts[row] == 0:
            sums[row, ORIGIN] = measured
        push(ring[row], sums[row], counts[row], error, measured - sums[row, ORIGIN])
        counts[row] += 1
        totals[row, 0] += 1.0
        totals[row, 1] += error
        totals[row, 2] += error * error
    held = min(counts[row], n)
    full = bool(counts[row] >= n)
    # NaN, not 0: proto3 cannot leave out a number, and a 0 would be a perfect twin in a plot.
    rmse = math.nan
    bias = math.nan
    fit = math.nan
    if held > 0:
        # Values that leave the window are subtracted, so a sum of squares may round to just below 0.
        mean_square = max(sums[row, SQUARE], 0.0) / held
        rmse = math.sqrt(mean_square)
        bias = sums[row, VALUE] / held
        mean = sums[row, Y] / held
        variance = sums[row, Y_SQUARE] / held - mean * mean
        if full and variance > 0.0:
            fit = 100.0 * (1.0 - math.sqrt(mean_square / variance))
    return error, error / std, rmse, bias, fit, full


@kernel
def unseen(alarm: NDArray[np.float64], counts: NDArray[np.int64], row: int, limit: int) -> int:
    """Count a sample that says nothing about an alarm, row `row` of ALARMS, and end the alarm after `limit`."""
    counts[UNSEEN + row] += 1
    return end(alarm) if counts[UNSEEN + row] > limit else UNCHANGED


@kernel
def judge_error(w: Windows, row: int, normalised: float, on: float, off: float, is_evidence: bool) -> int:
    """Return what this error does to its alarm, row `row` of ALARMS.

    `is_evidence`: whether the sample is in step and in closed loop.
    """
    alarm, counts = w.alarms[row], w.counts
    if not (is_evidence and math.isfinite(normalised)):
        return unseen(alarm, counts, row, counts[HOLD])
    counts[UNSEEN + row] = 0
    return decide(alarm, w.ring.shape[1], normalised * normalised, on, off)


@kernel
def judge_innovation(
    w: Windows, n_i: float, n_x: float, nis: float, valid: bool, on: float, off: float
) -> tuple[float, int]:
    """Return (mean NIS over the window, what this innovation does to its alarm)."""
    ring, sums, counts, totals, alarms = w
    alarm, window = alarms[0], ring.shape[1]
    if not valid:
        # The window holds consecutive ticks: their innovations are independent only if the filter went on.
        sums[NIS] = 0.0
        counts[NIS] = 0
        clear_window(alarm)
        return math.nan, unseen(alarm, counts, 0, window)
    counts[UNSEEN] = 0
    totals[NIS, 0] += 1.0
    totals[NIS, 1] += n_x * n_x
    totals[NIS, 2] += n_i * n_i
    totals[NIS, 3] += nis
    return rolling_mean(ring, sums, counts, NIS, nis), decide(alarm, window, nis, on, off)


class Comparison:
    """Windows, totals and alarms of one board.

    `totals`, for each signal: samples in step, sum of errors, sum of squared errors; for the innovations: samples, sum
    of squares of x, of i_c, sum of the NIS.
    """

    def __init__(self) -> None:
        self.totals = np.zeros((4, 4))
        self.alarms = np.zeros((3, PLACES))
        self.counts = np.zeros(8, dtype=np.int64)
        self.start(2, 2)

    def start(self, window: int, hold: int) -> None:
        """Begin with empty windows of `window` ticks; alarms on errors last `hold` samples that do not judge them."""
        self.ring = np.zeros((4, window, 4))
        self.sums = np.zeros((4, 5))
        self.counts[:UNSEEN] = 0
        self.counts[HOLD] = hold
        for alarm in self.alarms:
            clear_window(alarm)

    @property
    def windows(self) -> Windows:
        """Return the arrays as the kernels take them, valid until the next `start`."""
        return Windows(self.ring, self.sums, self.counts, self.totals, self.alarms)

    def interrupt(self) -> None:
        """Empty the windows of the errors: the twin has jumped, so errors before and after it are not averaged."""
        self.sums[:NIS] = 0.0
        self.counts[:NIS] = 0
        for alarm in self.alarms[1:]:
            clear_window(alarm)

    def drop_error_alarms(self) -> list[pb.Alarm]:
        """End the alarms on errors after a change of mode: they belong to the mode before."""
        return self.messages((UNCHANGED, *(end(alarm) for alarm in self.alarms[1:])))

    def drop_alarms(self, why: str) -> list[pb.Alarm]:
        """End all alarms: the comparison is over."""
        return self.messages(tuple(end(alarm) for alarm in self.alarms), why_ended=why)

    def skip(self) -> list[pb.Alarm]:
        """Count a sample that cannot be compared."""
        limits = (self.ring.shape[1], self.counts[HOLD], self.counts[HOLD])
        return self.messages(
            tuple(unseen(alarm, self.counts, row, limits[row]) for row, alarm in enumerate(self.alarms))
        )

    def forget(self, why: str) -> list[pb.Alarm]:
        """Begin with another twin: alarms end, totals begin at zero; `start` empties the windows."""
        self.totals[:] = 0.0
        self.counts[:HOLD] = 0
        return self.drop_alarms(why)

    def messages(self, changes: tuple[int, ...], *, why_ended: str = "") -> list[pb.Alarm]:
        """Return the alarm messages for all changes."""
        return [
            message(name, alarm, change, why_ended=why_ended)
            for name, alarm, change in zip(ALARMS, self.alarms, changes, strict=True)
            if change != UNCHANGED
        ]
