"""The amplitude spectrum of even samples, some of which are missing.  Pure.

Rule 1: a sine of amplitude A shows A at its frequency, whatever that is.  The Hann window with four times as many
        frequencies as samples errs by 1.5 % at most; without these a sine between two frequencies would lose 15 %.
Rule 2: few missing samples are interpolated; with more than MISSING of them there is no spectrum.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

MISSING = 0.02  # share of the samples
_PAD = 4
_PER_DECADE = 200  # bands: 1.2 % of the frequency, or a pixel
_MAIN_LOBE = 2.0  # half width of the window's main lobe, in 1 / span: below it lies what the mean leaves


def even(t_s: FloatArray, values: FloatArray, *, end_s: float, step_s: float, count: int) -> FloatArray:
    """Return `count` values at the interval `step_s` up to `end_s`, NaN where none was taken, shape (count,).

    Args:
        t_s: times of the samples, s, shape (n,).
        values: of the samples, shape (n,).
        end_s: time of the last value, s.
        step_s: sampling interval, s.
        count: of the values to return.
    """
    index = np.rint((t_s - end_s) / step_s).astype(np.int64) + count - 1
    valid = (index >= 0) & (index < count)
    series = np.full(count, np.nan)
    series[index[valid]] = values[valid]
    return series


def missing(values: FloatArray) -> float:
    """Return the share of the values that are missing, 0 to 1."""
    return float(np.mean(~np.isfinite(values)))


def amplitudes(values: FloatArray, step_s: float) -> tuple[FloatArray, FloatArray]:
    """Return (frequencies in Hz, amplitudes in the unit of the values), without the mean and what lies beside it.

    Args:
        values: even samples, shape (n,), NaN where missing; n at least 8, one of them finite.
        step_s: sampling interval, s.
    """
    k = np.arange(len(values))
    known = np.isfinite(values)
    filled = np.interp(k, k[known], values[known])
    window = 0.5 - 0.5 * np.cos(2.0 * np.pi * k / len(values))
    filled -= np.average(filled, weights=window)
    transform = np.fft.rfft(filled * window, _PAD * len(values))
    frequency_hz = np.fft.rfftfreq(_PAD * len(values), step_s)
    resolved = frequency_hz >= _MAIN_LOBE / (len(values) * step_s)
    return np.asarray(frequency_hz[resolved], np.float64), np.abs(transform[resolved]) * (2.0 / window.sum())


def in_bands(frequency_hz: FloatArray, amplitude: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return (middle frequencies, largest amplitudes) of bands as wide as a pixel of a logarithmic axis.

    Args:
        frequency_hz: rising, above 0, shape (n,).
        amplitude: shape (n,).
    """
    band = np.floor(_PER_DECADE * np.log10(frequency_hz))
    first = np.flatnonzero(np.diff(band, prepend=band[0] - 1.0))
    last = np.append(first[1:], len(band)) - 1
    return np.sqrt(frequency_hz[first] * frequency_hz[last]), np.maximum.reduceat(amplitude, first)
