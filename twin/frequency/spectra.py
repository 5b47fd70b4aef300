"""Fourier coefficients of a part, in bands around the excited frequencies, and the ratios that they give.

In closed loop the noise is fed back into u_c.  So the direct ratio S_yu / S_uu is biased, towards -1 / law where noise
moves the loop more than the excitation does.  The reference r of the excitation is independent of the noise.  The ratio
of two regressions on r is therefore consistent for any noise and control law (joint input-output estimate):

    H = S_ar / S_br = sum A_m R_m* / sum B_m R_m*          m: the bins of a band, 2 q + 1

    - Pintelon and Schoukens, System Identification: A Frequency Domain Approach, 2nd ed., sections 2.6 and 7.2
    - Soderstrom and Stoica, System Identification, chapter 10
    - Ljung, System Identification: Theory for the User, 2nd ed., sections 6.4 and 13.5

If H is right, E_m = A_m - H B_m is noise and nothing else.  Its variance about the regression on r gives the band:
|sum E_m R_m*|^2 / (s^2 sum |R_m|^2) is F(2, 2 nu) distributed, nu the degrees of freedom of s^2.

The variance comes from the neighbouring bins of one transform of the whole part.  With a periodic reference (multisine)
they contain no excitation: the bin of a harmonic contains r, and the 2 q bins beside it contain the noise.  With a
chirp or a PRBS all bins of a band contain r, and the residual of the regression is the noise.  Blocks (single periods,
or Welch segments) give too large a variance here.  The noise of an unstable plant carries a large state from one block
into the next.  It enters the two blocks with opposite signs, so it increases their scatter and cancels in their mean.
In simulated loops, the bands from blocks contained a right model in 95 to 99.9 % of the cases instead of 95 %.

The state at both ends of the part adds a term that is smooth over frequency.  It is a straight line over the band, and
is estimated together with H (local polynomial method of Pintelon and Schoukens, section 7.2.2).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twin.estimation.record import FloatArray
from twin.frequency.excitation import Part

ComplexArray = NDArray[np.complex128]

SETTLE_S = 0.6  # left out at the beginning of a periodic part: the loop's answer to its start
REACH = 6  # q: bins of a band on either side
SHORTEST_REACH = 2  # with fewer periods nothing is left for the noise
STRAIGHT = 2  # numbers of the straight line
WEAK = {True: 0.03, False: 0.3}  # share of the largest |R| below which a frequency is not excited; periodic or not


@dataclass(frozen=True, slots=True, kw_only=True)
class Spectra:
    """Coefficients of the signals in bands around F frequencies; arrays of shape (K, F), K = 2 q + 1 bins."""

    f_hz: FloatArray  # the middle of each band, shape (F,)
    bins_hz: FloatArray
    r: ComplexArray  # reference, m; 0 between the harmonics of a periodic one
    u: ComplexArray  # V
    i: ComplexArray  # A
    x: ComplexArray  # m

    @property
    def dof(self) -> float:
        """The complex degrees of freedom of a variance."""
        return float(len(self.r) - 1 - STRAIGHT)

    def on_r(self, signal: ComplexArray) -> ComplexArray:
        """Return the regression of a signal on r, shape (F,)."""
        return self._fitted(signal)[0]

    def variance(self, signal: ComplexArray) -> FloatArray:
        """Return the variance of `on_r(signal)`, E|error|^2, shape (F,)."""
        _, noise, gain = self._fitted(signal)
        return np.asarray(noise * gain)

    def coherence(self, signal: ComplexArray) -> FloatArray:
        """Return the part of the signal's power in the band that follows r, 0 to 1, shape (F,)."""
        slope, noise, gain = self._fitted(signal)
        follows = np.abs(slope) ** 2 / gain
        return np.asarray(follows / np.maximum(follows + noise, 1e-300))

    def _fitted(self, signal: ComplexArray) -> tuple[ComplexArray, FloatArray, FloatArray]:
        """Return (regression on r, variance of the noise of a bin, its factor in the variance of the regression)."""
        line = _straight(len(self.r))
        r, y = (both - line @ (line.T @ both) for both in (self.r, signal))
        power = np.sum(np.abs(r) ** 2, axis=0)
        slope = np.sum(y * r.conj(), axis=0) / power
        noise = np.sum(np.abs(y - slope * r) ** 2, axis=0) / self.dof
        return np.asarray(slope), np.asarray(noise), np.asarray(1.0 / power)


def _straight(count: int) -> FloatArray:
    """An orthonormal basis of the straight lines over a band, shape (count, 2)."""
    # Centred, so that it is orthogonal to the constant: a projection is then two products, without a matrix to solve.
    ramp = np.arange(count) - 0.5 * (count - 1)
    return np.column_stack((np.full(count, count**-0.5), ramp / np.linalg.norm(ramp)))


def spectra(signals: FloatArray, part: Part, interval_s: float) -> Spectra | None:
    """Return the coefficients of a part.

    Args:
        signals: x_ref, u_c, i_c, x of the part, SI units, shape (4, n).
        part: its period.
        interval_s: sampling interval, s.

    Returns:
        None if the part is too short, or its reference does not move.
    """
    step = 0  # bins from one harmonic to the next
    reach = REACH
    if part.period:
        first = part.period * int(np.ceil(SETTLE_S / (part.period * interval_s)))
        step = (signals.shape[1] - first) // part.period
        reach = min(REACH, step - 1)
        # Whole periods: each harmonic is one bin then, and nothing leaks into the bins of the noise.
        signals = signals[:, first : first + step * part.period]
    n = signals.shape[1]
    if reach < SHORTEST_REACH or n < 8 * REACH:
        return None
    coefficients = np.fft.rfft(signals - signals.mean(axis=1, keepdims=True), axis=1) * 2.0 / n
    # Bin 0 is the mean, the last one the Nyquist frequency, where there is no phase.
    middles = np.arange(step or reach + 1, n // 2 - reach, step or 2 * reach + 1)
    bands = middles + np.arange(-reach, reach + 1)[:, None]
    r = coefficients[0][bands]
    size = np.abs(r[reach]) if part.period else np.sqrt(np.mean(np.abs(r) ** 2, axis=0))
    # Frequencies that are hardly excited are left out: their ratio would be noise over noise.
    excited = size > WEAK[bool(part.period)] * size.max(initial=0.0)
    if not excited.any():
        return None
    if part.period:
        r[np.arange(len(r)) != reach] = 0.0  # up to rounding of the transform
    u, i, x = (coefficients[k][bands][:, excited] for k in (1, 2, 3))
    return Spectra(
        f_hz=middles[excited] / (n * interval_s),
        bins_hz=bands[:, excited] / (n * interval_s),
        r=r[:, excited],
        u=u,
        i=i,
        x=x,
    )
