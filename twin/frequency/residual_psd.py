"""The spectrum of the innovations against the model's noise: flat, of size 1, if model and noise model are right.

Innovations are whitened by the filter's own covariance (`twin/estimation/innovations.py`).  Spectrum: Welch with Hann
segments that overlap by half, scaled so that white noise of the stated size gives 1.  K segments give
36 K^2 / (19 K - 1) degrees of freedom of a chi-square (Percival and Walden, Spectral Analysis for Physical
Applications, section 6.17).  Unlike the responses this needs no excitation, and reaches to half the sampling rate.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.signal import welch

from twin.distributions import chi2_below, chi2_quantile
from twin.estimation.family import holm
from twin.estimation.record import FloatArray, runs
from twin.estimation.rollout import SETTLE_S
from twin.validation.source import Filtered

SEGMENT_S = 0.5
BINS = 3  # from one tested bin to the next: a Hann window makes nearer ones dependent
LEVEL = 0.05


@dataclass(frozen=True, slots=True, kw_only=True)
class ResidualSpectrum:
    """The spectrum of one channel's innovations; arrays of shape (F,)."""

    channel: str  # i_c | x
    f_hz: FloatArray
    power: FloatArray  # 1 under a right model
    low: float  # 95 % of one frequency
    high: float
    wrong_hz: FloatArray  # where it differs from 1, by Holm's method over all frequencies


def residual_spectra(filtered: Sequence[Filtered]) -> tuple[ResidualSpectrum, ...]:
    """Return the spectra of i_c and x over all recordings together; a channel without long stretches is left out."""
    spectra = (_spectrum(filtered, column, name) for column, name in ((0, "i_c"), (1, "x")))
    return tuple(spectrum for spectrum in spectra if spectrum is not None)


def _spectrum(filtered: Sequence[Filtered], column: int, name: str) -> ResidualSpectrum | None:
    total, segments, f_hz = np.zeros(1), 0, np.empty(0)
    for run in filtered:
        T_s = run.source.record.interval_s
        # Even: only then the last bin is the Nyquist frequency, which is left out below.
        length = 2 * round(SEGMENT_S / T_s / 2)
        if len(f_hz) and len(f_hz) != length // 2 - 1:
            continue  # another sampling time
        settle = round(SETTLE_S / T_s)
        for piece in runs(np.isfinite(run.white[:, column]), settle + length):
            e = run.white[piece.start + settle : piece.stop, column]
            count = (len(e) - length) // (length // 2) + 1
            # Not one periodogram: its scatter is as large as its value, however long the recording is.
            f, power = welch(e, fs=1.0 / T_s, nperseg=length, detrend=False)
            # Without bin 0 and the Nyquist frequency: their coefficients are real, with half the degrees of freedom.
            f_hz = f[1:-1]
            total = np.asarray(total + count * power[1:-1] / (2.0 * T_s))
            segments += count
    if segments < 2:
        return None
    power = np.asarray(total / segments)
    dof = 36.0 * segments**2 / (19.0 * segments - 1.0)
    tail = chi2_below(dof * power, dof)
    tested = slice(1, None, BINS)
    # Both tails: too little power is wrong as well, as where the noise is stated too large.
    wrong = np.array(holm((2.0 * np.minimum(tail, 1.0 - tail)[tested]).tolist(), LEVEL), np.bool_)
    low, high = (chi2_quantile(tail_p, dof) / dof for tail_p in (0.025, 0.975))
    return ResidualSpectrum(channel=name, f_hz=f_hz, power=power, low=low, high=high, wrong_hz=f_hz[tested][wrong])
