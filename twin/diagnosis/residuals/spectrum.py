"""Spectrum of prediction errors one sample ahead; that of a right model is white at the noise floor."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from twin.distributions import chi2_quantile
from twin.estimation.record import FloatArray, runs

SEGMENT_S = 1.0
MIN_SEGMENTS = 4  # segments


@dataclass(frozen=True, slots=True, kw_only=True)
class Spectrum:
    """The one-sided amplitude spectral densities, m/sqrt(Hz), shape (n,)."""

    frequency_hz: FloatArray
    baseline: FloatArray
    extended: FloatArray
    floor: float
    spread: tuple[float, float]  # 95 % interval of each value, as factors
    segments: int


def spectrum(errors_m: FloatArray, floor_m: float, tick_s: float) -> Spectrum | None:
    """Estimate by Welch (1967): mean over unbroken segments of a second, Hann window, 50 % overlap.

    Args:
        errors_m: one sample ahead, baseline and extended, shape (2, n), NaN without a prediction.
        floor_m: root mean square error due to sensor noise, m.
        tick_s: the sampling interval, s.

    Returns:
        The spectrum; None with too few segments.
    """
    length = 2 * max(round(0.5 * SEGMENT_S / tick_s), 8)
    known = np.asarray(np.isfinite(errors_m).all(axis=0))
    starts = [
        start for piece in runs(known, length) for start in range(piece.start, piece.stop - length + 1, length // 2)
    ]
    if len(starts) < MIN_SEGMENTS:
        return None
    window = np.hanning(length)
    rows = np.array(starts)[:, None] + np.arange(length)
    densities = []
    for errors in errors_m:
        # P. D. Welch, The use of fast Fourier transform for the estimation of power spectra, 1967.  One periodogram of
        # the whole would scatter by its own size however long it is.
        power = np.abs(np.fft.rfft(errors[rows] * window, axis=1)) ** 2
        densities.append(np.sqrt(2.0 * tick_s / float(window @ window) * power.mean(axis=0)))
    # 11 half-overlapping Hann segments have the variance of 9 independent ones [Welch 1967].
    freedom = 2.0 * len(starts) * 9.0 / 11.0
    return Spectrum(
        frequency_hz=np.arange(1, length // 2 + 1) / (length * tick_s),
        baseline=densities[0][1:],
        extended=densities[1][1:],
        # White noise of this variance is flat up to the highest frequency, 1 / (2 T), so its one-sided density is 2 T
        # sigma^2.
        floor=floor_m * np.sqrt(2.0 * tick_s),
        spread=(
            float(np.sqrt(freedom / chi2_quantile(0.975, freedom))),
            float(np.sqrt(freedom / chi2_quantile(0.025, freedom))),
        ),
        segments=len(starts),
    )
