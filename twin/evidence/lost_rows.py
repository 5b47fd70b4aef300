"""Rows for lost samples, so that the filter continues across them.

A filter that starts again after a gap treats u_c as a number without history.  But the board computed u_c from earlier
readings, so it contains the noise of the first reading after the gap.  With one sample in ten lost, this produced a
constant force of six standard errors from nothing.  Each start also favours the model with fewer unknowns there.

Rule 1: up to `LONGEST` lost samples in a row get rows, within a flight, and at rest where u_c is the same before and
        after.  More remain a gap, and so do several over which u_c jumps.
Rule 2: the row holds no reading: i_c and x are interpolated for the search for contact, for figures and quantiles, and
        not used.  In flight the filter (`twin/estimation/ekf`) estimates its u_c from the current of the next sample.
        Under a delay longer than an interval it takes the sample after that.  If that is lost, too, the previous u_c
        remains, with the uncertainty of an unknown one.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from twin.estimation.innovations import FLIES, FOLLOWS, LOST, USE_I, USE_X
from twin.estimation.propagate import UNKNOWN_INPUT_V
from twin.estimation.record import REGULAR_SHARE, BoolArray, FloatArray, Record, runs
from twin.evidence.noise_levels import RESTS

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
    return replace(
        record,
        t=np.insert(record.t, before + 1, record.t[before] + order * steps[before] / (rows[before] + 1)),
        u_c=np.insert(record.u_c, before + 1, record.u_c[before]),
        i_c=_between(record.i_c, lost),
        x=_between(record.x, lost),
        x_ref=np.insert(record.x_ref, before + 1, record.x_ref[before]),
    ), lost


def _between(values: FloatArray, lost: BoolArray) -> FloatArray:
    """Return the values with interpolated ones in the rows that are `lost`, shape (n,)."""
    result = np.full(len(lost), np.nan)
    result[~lost] = values
    known = np.flatnonzero(np.isfinite(result))
    if len(known) > 1:
        from scipy.interpolate import Akima1DInterpolator  # slow to import

        # H. Akima, J. ACM 17, 1970: as exact as a cubic, and a jump makes no waves.  Straight lines would be outliers
        # of a ball in fast motion.
        between = Akima1DInterpolator(known, result[known])(np.flatnonzero(lost))
        # Not beyond the readings: else those at the end of the converter's range would not be its end any more.
        result[lost] = np.clip(between, np.nanmin(values), np.nanmax(values))
    return result


def mark(flags: NDArray[np.uint16], u_c: FloatArray, lost: BoolArray) -> None:
    """Flag the rows of lost samples within flights, and at rest if u_c did not change over them.

    The other rows become gaps.  `flags`, shape (n,), are changed in place.  The first and the last row are not `lost`,
    shape (n,).
    """
    flags[lost] = flags[lost] & (0xFFFF - USE_I - USE_X) | LOST
    for gap in runs(lost):
        around = flags[gap.start - 1 : gap.stop + 1]
        flies = (around & FLIES != 0).all()
        rests = np.bitwise_and.reduce(around) & RESTS != 0 and u_c[gap.start - 1] == u_c[gap.stop]
        if not (flies or rests) or not (around[1:] & FOLLOWS != 0).all():
            flags[gap] = LOST
            flags[gap.stop] &= 0xFFFF - FOLLOWS
