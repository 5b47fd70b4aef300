"""The probes of the score test: small values of each cause, and values at which these data would show it."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from twin.estimation.innovations import FLIES, FOLLOWS, Series
from twin.model.causes.cause import Cause
from twin.settings import diagnosis as settings


def probes_of(cause: Cause, series: Series) -> tuple[float, ...]:
    """Return the values of the cause's strength at which its signature is computed."""
    usual, measured = cause.strength.probes, cause.measured_probes
    if measured is not None:
        # A limit acts only where it is reached, so its probes are shares of what these recordings show.  A fixed probe
        # might touch no sample.
        size = _SIZES[measured.of](series)
        at = tuple(size * factor for factor in measured.times) if size > 0.0 else ()
        return at if math.isinf(cause.strength.neutral) else (*usual, *(value for value in at if value > usual[0]))
    return (*usual, settings.SMALL_PROBE * usual[0]) if "displaces" in cause.traits else usual


def largest_current(series: Series) -> float:
    """Return the current i_c under the largest inputs, A."""
    known = np.flatnonzero(np.isfinite(series.i) & (series.u > 0.0))
    if len(known) < settings.PROBE_SAMPLES:
        return 0.0
    # The median of the top half per cent: the single largest reading is mostly noise.
    top = np.sort(series.i[known])
    return float(np.median(top[-max(len(top) // 200, settings.PROBE_SAMPLES) :]))


def fastest_change(series: Series) -> float:
    """The largest rate of i_c over `RATE_SPAN_S`, or over one interval where that is longer, A/s."""
    best = 0.0
    broken = np.cumsum(series.flags & FOLLOWS == 0)
    for interval in np.unique(series.step[series.step > 0.0]):
        # Over a fixed time, not over one sample: at 25 kHz the difference of two samples is all noise.
        lag = max(round(settings.RATE_SPAN_S / float(interval)), 1)
        if lag >= len(series.i):
            continue
        same = (broken[lag:] == broken[:-lag]) & (series.step[lag:] == interval)
        if same.sum() >= settings.PROBE_SAMPLES:
            rates = np.abs(series.i[lag:] - series.i[:-lag])[same] / (lag * float(interval))
            # The fifth largest, not the largest, which is the one with most noise.
            best = max(best, float(np.sort(rates)[-settings.PROBE_SAMPLES // 4]))
    return best


def _sampling_interval(series: Series) -> float:
    flown = series.step[(series.flags & FLIES != 0) & (series.step > 0.0)]
    return float(np.median(flown)) if len(flown) else 0.0


_SIZES: dict[str, Callable[[Series], float]] = {
    "largest-current": largest_current,
    "fastest-change": fastest_change,
    "sampling-interval": _sampling_interval,
}
