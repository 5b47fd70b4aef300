"""Where the screen looks at each cause: small values, and for limits those at which these data would show one.

A limit far above what was recorded does nothing, one far below contradicts everything: only near the largest current,
the fastest change that was recorded is its signature anything like the effect.
"""

from __future__ import annotations

import numpy as np

from twin.estimation.innovations import FLIES, FOLLOWS, Series
from twin.model.causes.cause import Cause

_FACTORS = (1.02, 1.0, 0.98, 0.93)
_RATE_FACTORS = (1.3, 1.0, 0.7, 0.4)
_RATE_SPAN_S = 4e-4  # over which a rate of change is taken: in one sample of a capture it is all noise
_DELAY_STEPS = (0.5, 1.5)  # sampling intervals: the likelihood of a delay has a kink at every whole one
# The places of coil, stop and sensor are one but for bends: in the signature of a wide probe those hide the difference.
FINE = ("air-gap-offset", "position-sensor-offset")
_FINE_PART = 0.02
_ENOUGH = 20


def probes_of(cause: Cause, series: Series) -> tuple[float, ...]:
    """Values of the cause's strength at which its signature is taken."""
    if cause.name == "current-limit":
        most = largest_current(series)
        return tuple(most * factor for factor in _FACTORS) if most > 0.0 else ()
    if cause.name == "slew-rate-limit":
        fastest = fastest_change(series)
        return tuple(fastest * factor for factor in _RATE_FACTORS) if fastest > 0.0 else ()
    if cause.name in ("actuation-delay", "sampling-delay"):
        flown = series.step[(series.flags & FLIES != 0) & (series.step > 0.0)]
        interval = float(np.median(flown)) if len(flown) else 0.0
        more = [interval * steps for steps in _DELAY_STEPS if interval * steps > cause.strength.probes[0]]
        return (*cause.strength.probes, *more)
    if cause.name in FINE:
        return (*cause.strength.probes, _FINE_PART * cause.strength.probes[0])
    return cause.strength.probes


def largest_current(series: Series) -> float:
    """What i_c comes to under the largest inputs, A."""
    known = np.flatnonzero(np.isfinite(series.i) & (series.u > 0.0))
    if len(known) < _ENOUGH:
        return 0.0
    top = np.sort(series.i[known])
    return float(np.median(top[-max(len(top) // 200, _ENOUGH) :]))


def fastest_change(series: Series) -> float:
    """The largest rate of i_c over `_RATE_SPAN_S`, or over one interval where that is longer, A/s."""
    best = 0.0
    broken = np.cumsum(series.flags & FOLLOWS == 0)
    for interval in np.unique(series.step[series.step > 0.0]):
        lag = max(round(_RATE_SPAN_S / float(interval)), 1)
        if lag >= len(series.i):
            continue
        same = (broken[lag:] == broken[:-lag]) & (series.step[lag:] == interval)
        if same.sum() >= _ENOUGH:
            rates = np.abs(series.i[lag:] - series.i[:-lag])[same] / (lag * float(interval))
            best = max(best, float(np.sort(rates)[-_ENOUGH // 4]))
    return best
