"""Rows for lost samples, so that the filter continues across them.

A filter that starts again after a gap treats u_c as a number without history.  But the board computed u_c from earlier
readings, so it contains the noise of the first reading after the gap.  With one sample in ten lost, this produced a
constant force of six standard errors from nothing.  Each start also favours the model with fewer unknowns there.

Rule 1: up to `LONGEST` lost samples in a row get rows, within a flight.  More remain a gap, and so do several over
        which u_c jumps.
Rule 2: the row holds no reading.  The filter (`twin/estimation/ekf`) estimates its u_c from the current of the next
        sample.  Under a delay longer than an interval it takes the sample after that.  If that is lost, too, the
        previous u_c remains, with the uncertainty of an unknown one.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from twin.estimation.innovations import FLIES, FOLLOWS, LOST
from twin.estimation.propagate import UNKNOWN_INPUT_V
from twin.estimation.record import REGULAR_SHARE, BoolArray, FloatArray, Record, runs

LONGEST = 3  # lost samples in a row; with one sample in ten lost, more follow one in ten thousand


def bridged(record: Record) -> tuple[Record, BoolArray]:
    """Return (the recording with rows for lost samples; which rows those are, shape (n,))."""
    steps, interval = np.diff(record.t), record.interval_s
    with np.errstate(invalid="ignore"):
        intervals = np.maximum(np.rint(steps / interval), 1.0)
        regular = np.abs(steps - intervals * interval) <= intervals * REGULAR_SHARE * interval
        # The current of the next sample tells the last of several unknown inputs, not when u_c jumped before it.
        steady = (intervals == 2.0) | (np.abs(np.diff(record.u_c)) <= UNKNOWN_INPUT_V)
        rows = np.where(regular & steady & (intervals <= LONGEST + 1), intervals - 1.0, 0.0).astype(np.intp)
    # If the sampling time varies on purpose, a longer interval is not a lost sample.
    if not rows.any() or np.count_nonzero(regular & (intervals == 1.0)) < 0.5 * len(steps):
        return record, np.zeros(len(record.t), np.bool_)
    before = np.repeat(np.arange(len(steps)), rows)  # the sample before each lost one
    lost = np.zeros(len(record.t) + len(before), np.bool_)
    lost[before + 1 + np.arange(len(before))] = True
    order = np.arange(1, len(before) + 1) - np.searchsorted(before, before)  # of each within its gap, from 1
    times, unread = record.t[before] + order * steps[before] / (rows[before] + 1), np.full(len(before), np.nan)
    return replace(
        record,
        t=_with(record.t, lost, times),
        u_c=_with(record.u_c, lost, record.u_c[before]),
        i_c=_with(record.i_c, lost, unread),
        x=_with(record.x, lost, unread),
        x_ref=_with(record.x_ref, lost, record.x_ref[before]),
    ), lost


def _with(values: FloatArray, lost: BoolArray, inserted: FloatArray) -> FloatArray:
    result = np.empty(len(lost))
    result[~lost], result[lost] = values, inserted
    return result


def mark(flags: NDArray[np.uint16], lost: BoolArray) -> None:
    """Flag the rows of lost samples within flights; the other rows become gaps.

    `flags`, shape (n,), are changed in place.  The first and the last row are not `lost`, shape (n,).
    """
    for gap in runs(lost):
        around = flags[gap.start - 1 : gap.stop + 1]
        if (around & FLIES != 0).all() and (around[1:] & FOLLOWS != 0).all():
            flags[gap] |= LOST
        else:
            flags[gap] = 0
            flags[gap.stop] &= np.uint16(~FOLLOWS & 0xFFFF)


def between(values: FloatArray, lost: BoolArray) -> None:
    """Interpolate the values of lost samples between their neighbours, in place, for figures and quantiles."""
    rows = np.arange(len(values))
    values[lost] = np.interp(rows[lost], rows[~lost], values[~lost])
