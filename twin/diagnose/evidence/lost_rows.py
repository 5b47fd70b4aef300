"""A row for every single lost sample, so that what was read before it is not forgotten behind it.

A filter that begins anew behind a gap takes u_c for a number that nothing is known about.  But the board computed it
from readings that are lost, and from those before: it tells about the noise of the first reading behind the gap.  With
one sample in ten lost that made a constant force of six standard errors out of nothing.

Rule 1: one missing sample between two of a flight; more of them in a row stay a gap, as behind them nobody can tell
        which of the unknown inputs moved the ball.
Rule 2: the row holds no reading.  Its u_c is unknown: `ekf.py` asks the current of the next sample for it, or of
        the one behind that under a delay longer than an interval; where that one is lost, too, a guess remains.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from twin.estimation.innovations import FLIES, FOLLOWS, LOST
from twin.estimation.record import REGULAR_SHARE, BoolArray, FloatArray, Record


def bridged(record: Record) -> tuple[Record, BoolArray]:
    """(the recording with a row for each single lost sample; which rows those are, shape (n,))."""
    steps, interval = np.diff(record.t), record.interval_s
    with np.errstate(invalid="ignore"):
        single = np.flatnonzero(np.abs(steps - 2.0 * interval) <= 2.0 * REGULAR_SHARE * interval)
        even = np.count_nonzero(np.abs(steps - interval) <= REGULAR_SHARE * interval)
    lost = np.zeros(len(record.t) + len(single), np.bool_)
    # Where the sampling time varies on purpose, a longer interval lost nothing.
    if not len(single) or even < 0.5 * len(steps):
        return record, np.zeros(len(record.t), np.bool_)
    lost[single + 1 + np.arange(len(single))] = True
    middle, nothing = record.t[single] + interval, np.full(len(single), np.nan)
    return replace(
        record,
        t=_with(record.t, lost, middle),
        u_c=_with(record.u_c, lost, record.u_c[single]),
        i_c=_with(record.i_c, lost, nothing),
        x=_with(record.x, lost, nothing),
        x_ref=_with(record.x_ref, lost, record.x_ref[single]),
    ), lost


def _with(values: FloatArray, lost: BoolArray, there: FloatArray) -> FloatArray:
    result = np.empty(len(lost))
    result[~lost], result[lost] = values, there
    return result


def mark(flags: NDArray[np.uint8], lost: BoolArray) -> None:
    """Flag the rows of lost samples within flights; the others are gaps again.

    Args:
        flags: of a recording's samples, shape (n,), changed in place.
        lost: rows without a sample, shape (n,); neither the first nor the last.
    """
    for n in np.flatnonzero(lost):
        around = flags[n - 1 : n + 2]
        if (around & FLIES != 0).all() and (around[1:] & FOLLOWS != 0).all():
            flags[n] |= LOST
        else:
            flags[n] = 0
            flags[n + 1] &= np.uint8(~FOLLOWS & 0xFF)


def between(values: FloatArray, lost: BoolArray) -> None:
    """Put the mean of its neighbours where a sample was lost, in place: for pictures and quantiles."""
    rows = np.flatnonzero(lost)
    values[rows] = 0.5 * (values[rows - 1] + values[rows + 1])
