"""Outliers: single readings far from the value that their neighbours give.

An error A of one reading appears in the fourth difference as A (1, -4, 6, -4, 1).  A corner of the signal, such as an
impact or a step of the input, has another shape, because two or more readings show it.  It is retained.

Rule 1: a single reading is an outlier if its fourth difference has this shape and exceeds OUTLIER_ERRORS of the usual
        differences.  For Gaussian noise that is one reading in ten million.
Rule 2: a share of outliers up to OUTLIER_SHARE is retained.  The end of a slew limit or a bad contact may look like an
        outlier, and so small a share has no effect.
Rule 3: outliers that are left out are counted (`Usage.outliers`); no reading is corrected.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from twin.distributions import robust_spread
from twin.estimation.innovations import FLIES, USE_I, USE_X, Series
from twin.estimation.record import BoolArray, FloatArray
from twin.evidence.gather import Evidence
from twin.evidence.instruments import smooth
from twin.evidence.noise_levels import parts_of
from twin.settings import diagnosis as settings

_SPIKE = np.array([1.0, -4.0, 6.0, -4.0, 1.0])  # weights of the fourth difference
_POWER = float(_SPIKE @ _SPIKE)


def without_outliers(evidence: Evidence) -> Evidence:
    """Return the evidence without outliers of i_c and x, if their share exceeds that of rule 2."""
    series = evidence.series
    flags, usages = series.flags.copy(), [replace(usage) for usage in evidence.usages]
    usage_of = {usage.name: usage for usage in usages}
    parts = parts_of(evidence.records, series)
    for column, use in enumerate((USE_I, USE_X)):
        wild = np.zeros(len(series), np.bool_)
        for _, samples in parts:
            wild[samples] = _wild(series.part(samples), column)
        if np.count_nonzero(wild) <= settings.OUTLIER_SHARE * np.count_nonzero(series.flags & use):
            continue
        flags[wild] &= np.uint16(~use & 0xFFFF)
        for number, record in enumerate(evidence.records):
            if record.name in usage_of:
                usage_of[record.name].outliers += int(np.count_nonzero(wild & (series.recording == number)))
    if np.array_equal(flags, series.flags):
        return evidence
    return replace(evidence, series=replace(series, flags=flags), usages=tuple(usages))


def _wild(series: Series, column: int) -> BoolArray:
    """Return a mask of the outliers of one recording, shape (n,); `column`: 0 for i_c, 1 for x."""
    if len(series) < settings.OUTLIER_READINGS:
        return np.zeros(len(series), np.bool_)
    values, whole = smooth(series, column, around=2)
    off = np.full(len(values), np.nan)
    # The fourth difference: it removes a cubic, so that a moving ball leaves little, and has one large value for a
    # wrong reading.
    off[2:-2] = np.convolve(values, _SPIKE, mode="valid")
    off[~whole] = np.nan
    scaled = np.full(len(values), np.nan)
    flies = series.flags & FLIES != 0
    min_spread = _count(values) * np.sqrt(_POWER / 12.0)  # due to rounding alone
    for kind in (flies, ~flies):
        # The median, not the standard deviation: outliers must not hide themselves by widening the scale.
        usual = off[kind & whole]
        if len(usual) >= settings.OUTLIER_READINGS:
            spread = max(robust_spread(usual), min_spread)
            scaled[kind] = off[kind] / spread if spread > 0.0 else np.nan
    wild = np.abs(np.nan_to_num(scaled)) > settings.OUTLIER_ERRORS
    if column == 0:
        # A response to the input is not an outlier, even if one reading alone shows it.
        wild &= ~_steps(series.u)
    for index in np.flatnonzero(wild):
        # A single wrong reading appears in five fourth differences as 1, -4, 6, -4, 1.  Another pattern is motion.
        neighbours = scaled[index - 2 : index + 3]
        left = float(neighbours @ neighbours - (neighbours @ _SPIKE) ** 2 / _POWER)
        # Comparison with NaN is False: a reading with an unknown neighbour is not an outlier.
        wild[index] = left < settings.OUTLIER_SHAPE and abs(neighbours[2]) >= np.abs(neighbours).max()
    return np.asarray(wild)


def _steps(u: FloatArray) -> BoolArray:
    """Mark samples after an unusually large step of u_c, shape (n,): the response of i_c can have any shape."""
    change = np.abs(np.diff(u, prepend=u[:1]))
    far = change > settings.OUTLIER_ERRORS * robust_spread(change)
    return np.asarray(np.convolve(far, np.ones(settings.INPUT_SHOWS))[: len(u)] > 0.0)


def _count(values: FloatArray) -> float:
    """Return the resolution of the converter: the smallest difference of two values; 0 if all are equal."""
    steps = np.diff(np.unique(values))
    return float(steps.min()) if len(steps) else 0.0
