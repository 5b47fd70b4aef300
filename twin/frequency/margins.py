"""Margins of a loop gain that is known at some frequencies: gain, phase, modulus; with intervals by draws.

The loop is broken at u_c.  Between the frequencies ln |L| and the phase are interpolated over ln f (PCHIP: Fritsch and
Carlson, SIAM J. Numer. Anal. 17, 1980).  A margin whose frequency lies outside the measured ones is not measured.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import PchipInterpolator

from twin.estimation.record import FloatArray
from twin.frequency.spectra import ComplexArray

DRAWS = 400
POINTS = 600
SHARE = 0.8  # of the draws that must have a margin for it to have an interval


@dataclass(frozen=True, slots=True, kw_only=True)
class Margins:
    """Margins of one loop; NaN where it has none within its frequencies."""

    gain_low: float  # factor below 1 on L at which it becomes unstable
    gain_high: float  # factor above 1
    phase_deg: float
    modulus: float  # smallest |1 + L|, the reciprocal of the largest |S|


@dataclass(frozen=True, slots=True, kw_only=True)
class Margin:
    """A margin with its 95 % interval, NaN where it has none."""

    value: float
    low: float
    high: float


def margins_of(f_hz: FloatArray, loop: ComplexArray) -> Margins:
    """Return the margins of L, shape (F,), at rising frequencies, shape (F,)."""
    if len(f_hz) < 3:
        return Margins(gain_low=np.nan, gain_high=np.nan, phase_deg=np.nan, modulus=np.nan)
    at = np.log(f_hz)
    grid = np.linspace(at[0], at[-1], POINTS)
    # PCHIP and no cubic spline, which overshoots between few points and would add crossings of 1.
    size = PchipInterpolator(at, np.log(np.abs(loop)))(grid)
    # The phase about -180 degrees, so that a crossing of the negative real axis is a change of sign.
    phase = PchipInterpolator(at, np.unwrap(np.angle(-loop)))(grid)
    turned = phase - 2.0 * np.pi * np.round(phase / (2.0 * np.pi))  # -pi to pi; 0 on the negative real axis
    at_unity = turned[_changes(size)]
    crossing = _changes(turned)
    at_minus = np.exp(-size[crossing[np.abs(turned[crossing]) < 1.0]])  # without the jumps from pi to -pi
    # The crossings nearest to a factor of 1: on the way to a farther one the loop is unstable already.
    return Margins(
        gain_low=float(at_minus[at_minus < 1.0].max(initial=-np.inf)) if (at_minus < 1.0).any() else np.nan,
        gain_high=float(at_minus[at_minus > 1.0].min(initial=np.inf)) if (at_minus > 1.0).any() else np.nan,
        phase_deg=float(np.degrees(np.abs(at_unity).min())) if len(at_unity) else np.nan,
        modulus=float(np.abs(1.0 - np.exp(size + 1j * phase)).min()),
    )


def _changes(values: FloatArray) -> NDArray[np.intp]:
    """Return the indices before each change of sign."""
    return np.asarray(np.flatnonzero((values[1:] > 0.0) != (values[:-1] > 0.0)))


def with_intervals(f_hz: FloatArray, loop: ComplexArray, draws: list[ComplexArray]) -> dict[str, Margin]:
    """Return the margins of `loop` by name, with the 2.5 and 97.5 % quantiles of those of the draws."""
    nominal = asdict(margins_of(f_hz, loop))
    drawn = [asdict(margins_of(f_hz, item)) for item in draws]
    result = {}
    for name, value in nominal.items():
        several = np.array([item[name] for item in drawn])
        several = several[np.isfinite(several)]
        # The quantiles of the few draws that have the margin would be too narrow.
        enough = np.isfinite(value) and len(several) >= SHARE * len(drawn) > 0
        low, high = np.quantile(several, [0.025, 0.975]) if enough else (np.nan, np.nan)
        result[name] = Margin(value=float(value), low=float(low), high=float(high))
    return result
