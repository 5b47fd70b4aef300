"""Outliers by the filter: whitened innovations that a right model would exceed once in 5e8 samples."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from twin.estimation.innovations import USE_I, USE_X, Series
from twin.estimation.record import FloatArray

GATE = 6.0  # standard deviations of an outlier


def gate(series: Series, white: FloatArray, recording_count: int) -> tuple[Series, FloatArray]:
    """Return (the series without outliers, their number in each recording, shape (recording_count,)).

    An outlier is a whitened innovation beyond GATE whose neighbours are plausible.  A stretch of large innovations is
    retained, as it shows a wrong model or an undetected contact.

    Args:
        series: the samples.
        white: whitened innovations, shape (n, 2).
        recording_count: number of recordings.
    """
    flags = series.flags.copy()
    dropped = np.zeros(recording_count)
    for column, bit in ((0, USE_I), (1, USE_X)):
        values = np.abs(white[:, column])
        known = values[np.isfinite(values)]
        if known.size < 50:
            continue
        # The median, not the standard deviation, gives the scale: outliers would widen the limit that is to catch them.
        scale = max(float(np.median(known)) / 0.6745, 1e-12)
        del known
        wild = np.isfinite(values) & (values > GATE * max(scale, 1.0))
        # Five in eleven are no outliers of a converter: dropped, they would hide a wrong model.
        crowd = np.convolve(wild.astype(np.int8), np.ones(11, np.int8), mode="same") > 4
        wild &= ~crowd
        flags[wild] &= np.uint16(~bit & 0xFFFF)
        np.add.at(dropped, series.recording[wild], 1)
    return replace(series, flags=flags), dropped
