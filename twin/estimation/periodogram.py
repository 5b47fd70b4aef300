"""Lines in the spectrum of a residual, tested against the spectrum around them.

An ordinate of the periodogram of noise is exponential and independent of the others; the sum over K stretches is
Gamma(K).  Its share g of the M ordinates around it is then Beta(K, K (M - 1)), whatever the level of the noise there.
This is the test of R. A. Fisher, Proceedings of the Royal Society A 125, 1929, for several stretches and a spectrum
that is not flat (P. Whittle, Trabajos de Estadistica 3, 1952).  All frequencies that were tried count (Bonferroni).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import beta

from twin.estimation.record import FloatArray

NEIGHBOURS_HZ = 3.0  # the spectrum on either side that an ordinate is compared with
_PAD = 1 << 16


@dataclass(frozen=True, slots=True, kw_only=True)
class Periodogram:
    """The sum of the periodograms of several stretches; arrays of shape (n,)."""

    frequency_hz: FloatArray
    power: FloatArray  # |X|^2 / n of each stretch, summed
    share: FloatArray  # of the power of all independent ordinates of the neighbourhood
    stretches: int  # K
    ordinates: float  # M, independent ones in a neighbourhood
    samples: float  # of a stretch, on average

    def amplitude(self, at: int) -> float:
        """Return the amplitude of a sinusoid with this ordinate, in the unit of the residual."""
        return math.sqrt(4.0 * float(self.power[at]) / (self.stretches * self.samples))

    def strongest(self, low_hz: float, high_hz: float) -> int | None:
        """Return the ordinate that stands out most between two frequencies."""
        inside = np.flatnonzero((self.frequency_hz >= low_hz) & (self.frequency_hz <= high_hz))
        return int(inside[np.argmax(self.share[inside])]) if len(inside) else None

    def nearest(self, frequency_hz: float) -> int:
        """Return the ordinate of a frequency."""
        return int(np.argmin(np.abs(self.frequency_hz - frequency_hz)))

    def log_chance(self, at: int, *, tried: int) -> float:
        """Return ln of the probability that noise has such an ordinate among those tried, at most 0."""
        others = self.stretches * (self.ordinates - 1.0)
        chance = float(beta.logsf(min(float(self.share[at]), 1.0 - 1e-12), self.stretches, others))
        return min(chance + math.log(tried), 0.0)


def periodogram(stretches: Sequence[FloatArray], step_s: float) -> Periodogram | None:
    """The periodogram of stretches of a residual; None without any.

    Args:
        stretches: unbroken, each of shape (n,), without NaN; only the first 65536 samples count.
        step_s: the sampling interval, s.
    """
    parts = [part[:_PAD] for part in stretches if len(part) * step_s > 2.0 / NEIGHBOURS_HZ]
    if not parts:
        return None
    frequencies = np.fft.rfftfreq(_PAD, step_s)
    power = np.zeros(len(frequencies))
    for part in parts:
        power += np.abs(np.fft.rfft(part - np.mean(part), _PAD)) ** 2 / len(part)
    samples = float(np.mean([len(part) for part in parts]))
    width = max(round(NEIGHBOURS_HZ / float(frequencies[1])), 3)
    window = np.ones(2 * width + 1)
    counts = np.convolve(np.ones(len(power)), window, mode="same")
    local_mean = np.convolve(power, window, mode="same") / counts
    ordinates = max(2.0 * NEIGHBOURS_HZ * samples * step_s, 2.0)
    return Periodogram(
        frequency_hz=np.asarray(frequencies, np.float64),
        power=power,
        share=power / np.maximum(local_mean * ordinates, 1e-300),
        stretches=len(parts),
        ordinates=ordinates,
        samples=samples,
    )
