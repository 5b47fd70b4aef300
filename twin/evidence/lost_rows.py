"""A row for every single lost sample, so that the filter continues across it.

A filter that starts again after a gap treats u_c as a number without history.  But the board computed u_c from earlier
readings, so it contains the noise of the first reading after the gap.  With one sample in ten lost, this produced a
constant force of six standard errors from nothing.

Rule 1: only single lost samples within a flight get a row.  Several in a row remain a gap, as the data do not tell
        which of the unknown inputs moved the ball.
Rule 2: the row holds no reading.  The filter (`twin/estimation/ekf`) estimates its u_c from the current of the next
        sample.  Under a delay longer than an interval it takes the sample after that; if that is lost, too, a guess
        remains.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from twin.estimation.innovations import FLIES, FOLLOWS, LOST
from twin.estimation.record import REGULAR_SHARE, BoolArray, FloatArray, Record


def bridged(record: Record) -> tuple[Record, BoolArray]:
    """Return (the recording with a row for each single lost sample; which rows those are, shape (n,))."""
    steps, interval = np.diff(record.t), record.interval_s
    with np.errstate(invalid="ignore"):
        # Single lost samples only: the input of one is determined by the next reading of i_c, two would share it.
        single = np.flatnonzero(np.abs(steps - 2.0 * interval) <= 2.0 * REGULAR_SHARE * interval)
        even = np.count_nonzero(np.abs(steps - interval) <= REGULAR_SHARE * interval)
    lost = np.zeros(len(record.t) + len(single), np.bool_)
    # If the sampling time varies on purpose, a longer interval is not a lost sample.
    if not len(single) or even < 0.5 * len(steps):
        return record, np.zeros(len(record.t), np.bool_)
    lost[single + 1 + np.arange(len(single))] = True
    middle, missing = record.t[single] + interval, np.full(len(single), np.nan)
    return replace(
        record,
        t=_with(record.t, lost, middle),
        u_c=_with(record.u_c, lost, record.u_c[single]),
        i_c=_with(record.i_c, lost, missing),
        x=_with(record.x, lost, missing),
        x_ref=_with(record.x_ref, lost, record.x_ref[single]),
    ), lost


def _with(values: FloatArray, lost: BoolArray, inserted: FloatArray) -> FloatArray:
    result = np.empty(len(lost))
    result[~lost], result[lost] = values, inserted
    return result


def mark(flags: NDArray[np.uint16], lost: BoolArray) -> None:
    """Flag the rows of lost samples within flights; the other rows become gaps.

    `flags`, shape (n,), are changed in place.  The first and the last row are not `lost`, shape (n,).
    """
    for n in np.flatnonzero(lost):
        around = flags[n - 1 : n + 2]
        if (around & FLIES != 0).all() and (around[1:] & FOLLOWS != 0).all():
            flags[n] |= LOST
        else:
            flags[n] = 0
            flags[n + 1] &= np.uint16(~FOLLOWS & 0xFFFF)


def between(values: FloatArray, lost: BoolArray) -> None:
    """Replace the value of each lost sample by the mean of its neighbours, in place, for figures and quantiles."""
    rows = np.flatnonzero(lost)
    values[rows] = 0.5 * (values[rows - 1] + values[rows + 1])
