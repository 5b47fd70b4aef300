"""Lines in the spectrum of a residual, tested against the spectrum around them.  The one detector of lines.

An ordinate of the periodogram of noise is exponential and independent of the others; the sum over K stretches is
Gamma(K).  Its share g of the M ordinates around it is then Beta(K, K (M - 1)), whatever the level of the noise there.
This is the test of R. A. Fisher, Proceedings of the Royal Society A 125, 1929, for several stretches and a spectrum
that is not flat (P. Whittle, Trabajos de Estadistica 3, 1952).

Rule 1: all frequencies that were tried count (Bonferroni), so that noise has a line with LINE_CHANCE at most.  The
        grid is finer than the resolution and its ordinates depend on each other, which makes the test stricter.
Rule 2: a missing reading is NaN and counts as the mean of its stretch.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from twin.distributions import log_beta_above
from twin.estimation.innovations import FOLLOWS, Series
from twin.estimation.record import BoolArray, FloatArray, runs
from twin.model.causes.sensor_line import HARMONICS, LARGEST_RATIO
from twin.settings import diagnosis as settings

_PAD = 1 << 16
TRIED = _PAD // 2  # frequencies
_REGULAR = 0.02  # share of the interval by which a sample may be late


@dataclass(frozen=True, slots=True, kw_only=True)
class Periodogram:
    """The sum of the periodograms of several stretches; arrays of shape (n,)."""

    frequency_hz: FloatArray
    power: FloatArray  # |X|^2 over the readings of each stretch, summed
    share: FloatArray  # of the power of all independent ordinates of the neighbourhood
    ordinates: FloatArray  # M, independent ones in the neighbourhood
    stretches: int  # K
    samples: float  # readings of a stretch, on average

    def amplitude(self, at: int) -> float:
        """Return the amplitude of a sinusoid with this ordinate, in the unit of the residual."""
        # A sinusoid of amplitude A over n readings has |X|^2 = (A n / 2)^2.
        return math.sqrt(4.0 * float(self.power[at]) / (self.stretches * self.samples))

    def line(self, low_hz: float, high_hz: float, *, tried: int = TRIED) -> int | None:
        """Return the ordinate between two frequencies that stands out most; None if noise may have made it.

        `tried`: frequencies of which this is the best.
        """
        inside = np.flatnonzero((self.frequency_hz >= low_hz) & (self.frequency_hz <= high_hz))
        if not len(inside):
            return None
        at = int(inside[np.argmax(self.share[inside])])
        return at if self.log_chance(at, tried=tried) < math.log(settings.LINE_CHANCE) else None

    def harmonics(self, low_hz: float, high_hz: float) -> tuple[int | None, ...]:
        """Return the ordinates of the strongest line, at its first HARMONICS multiples; empty without a line.

        The first is the lowest.  None: this multiple does not stand out.
        """
        at = self.line(low_hz, high_hz)
        if at is None:
            return ()
        for divisor in range(HARMONICS, 1, -1):  # the strongest may be a harmonic itself
            below = self._near(float(self.frequency_hz[at]) / divisor, low_hz, high_hz)
            if below is not None and LARGEST_RATIO * self.amplitude(below) > self.amplitude(at):
                at = below
                break
        first_hz = float(self.frequency_hz[at])
        return (at, *(self._near(k * first_hz, low_hz, high_hz) for k in range(2, HARMONICS + 1)))

    def _near(self, frequency_hz: float, low_hz: float, high_hz: float) -> int | None:
        """Return the significant ordinate at a multiple or a fraction of a frequency that is nearly known."""
        if not low_hz < frequency_hz < high_hz:
            return None
        width_hz = settings.LINE_WIDTH_HZ
        # Only the frequencies near the multiples were tried here, so the correction is smaller than that of a free
        # search.
        tried = max(round(2.0 * HARMONICS * width_hz / float(self.frequency_hz[1])), 1)
        return self.line(frequency_hz - width_hz, frequency_hz + width_hz, tried=tried)

    def log_chance(self, at: int, *, tried: int = TRIED) -> float:
        """Return ln of the probability that noise has such an ordinate among those tried, at most 0."""
        others = self.stretches * (float(self.ordinates[at]) - 1.0)
        # In logarithms: a strong line has a chance below the smallest number.
        chance = log_beta_above(min(float(self.share[at]), 1.0 - 1e-12), self.stretches, others)
        return min(chance + math.log(tried), 0.0)


def highest_hz(step_s: float) -> float:
    """Return the highest frequency of a line; at the end of a spectrum it has no neighbours."""
    return settings.LINE_NYQUIST_SHARE * 0.5 / step_s


def spectrum_of(series: Series, values: FloatArray, known: BoolArray, step_s: float) -> Periodogram | None:
    """The periodogram of a channel over all stretches of a series at the usual interval; None without any.

    Args:
        series: the samples.
        values: of the channel, shape (n,).
        known: which of them count, shape (n,).
        step_s: the usual interval, s.
    """
    values = np.where(known, values, np.nan)
    return periodogram([values[piece] for piece in unbroken(series, step_s)], step_s)


def unbroken(series: Series, step_s: float) -> list[slice]:
    """The stretches of a series at the usual interval that are long enough for a spectrum."""
    regular = np.abs(series.step - step_s) < _REGULAR * step_s
    return runs(np.asarray(regular & (series.flags & FOLLOWS != 0)), settings.LINE_SAMPLES)


def periodogram(stretches: Sequence[FloatArray], step_s: float) -> Periodogram | None:
    """The periodogram of stretches of a residual; None without any of LINE_SAMPLES readings.

    Args:
        stretches: unbroken, each of shape (n,), NaN where a reading is missing; only the first 65536 samples count.
        step_s: the sampling interval, s.
    """
    parts = [part[:_PAD] for part in stretches]
    counts = [int(np.count_nonzero(np.isfinite(part))) for part in parts]
    enough = [(part, count) for part, count in zip(parts, counts, strict=True) if count >= settings.LINE_SAMPLES]
    if not enough:
        return None
    frequencies = np.fft.rfftfreq(_PAD, step_s)
    power = np.zeros(len(frequencies))
    for part, count in enough:
        known = np.nan_to_num(part - np.nanmean(part))
        # Padded to a fixed length: stretches of different lengths then share their frequencies, and can be summed.
        power += np.abs(np.fft.rfft(known, _PAD)) ** 2 / count
    samples = float(np.mean([count for _, count in enough]))
    width = max(round(settings.LINE_NEIGHBOURS_HZ / float(frequencies[1])), 3)
    total, around = _sums(power, width), _sums(np.ones(len(power)), width)
    ordinates = np.maximum(around * float(frequencies[1]) * samples * step_s, 2.0)  # near an end there are fewer
    return Periodogram(
        frequency_hz=np.asarray(frequencies, np.float64),
        power=power,
        share=power / np.maximum(total / around * ordinates, 1e-300),
        ordinates=ordinates,
        stretches=len(enough),
        samples=samples,
    )


def _sums(values: FloatArray, width: int) -> FloatArray:
    """The sum of each value and of `width` values on either side, fewer at the ends, shape (n,)."""
    until = np.concatenate(([0.0], np.cumsum(values)))
    k = np.arange(len(values))
    return np.asarray(until[np.minimum(k + width + 1, len(values))] - until[np.maximum(k - width, 0)])
