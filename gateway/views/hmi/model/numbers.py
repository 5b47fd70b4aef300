"""An alarm of the twin in numbers: by how much the rig differs from its model, and how often noise would.  Pure."""

from __future__ import annotations

import math

from gateway.views.hmi.texts import text_of
from protocol.bus import board51_pb2 as pb

_DIRECTED = 0.5  # share of the rms that the mean must be, to speak of more or less
_SIGNALS = {  # field, scale to the unit, and the texts: measured above the model, below it, or just different
    "divergence-i_c": (
        "i_c_a", 1.0, "A", "divergence.current_above", "divergence.current_below", "divergence.current",
    ),
    "divergence-x": (
        "x_m", 1e6, "\u00b5m", "divergence.position_above", "divergence.position_below", "divergence.position",
    ),
}  # fmt: skip
SPOKEN = ("divergence-i_c", "divergence-x", "innovation")  # alarms that have numbers, the plainest first


def in_numbers(name: str, since: str, divergence: pb.Divergence) -> str:
    """Return a sentence with numbers on an active alarm.

    Args:
        name: of the alarm.
        since: time of day at which it came, for people.
        divergence: the newest one.

    Returns:
        The sentence; empty where the divergence has no number for this alarm.
    """
    if name == "innovation":
        if not (divergence.innovation_valid and divergence.nis_mean > 0.0):
            return ""
        times = math.sqrt(divergence.nis_mean / 2.0)  # two degrees of freedom
        return text_of("divergence.innovation", since=since, times=_times(times))
    if name not in _SIGNALS or divergence.sync != "in-step":
        return ""
    field, scale, unit, above, below, differ = _SIGNALS[name]
    signal: pb.SignalDivergence = getattr(divergence, field)
    sigma = abs(signal.error / signal.normalised) if signal.normalised else 0.0
    if not sigma > 0.0 or not signal.rolling_rmse > 0.0:
        return ""
    if abs(signal.rolling_mean) >= _DIRECTED * signal.rolling_rmse:
        key, size = above if signal.rolling_mean > 0.0 else below, abs(signal.rolling_mean)
    else:
        key, size = differ, signal.rolling_rmse
    times = signal.rolling_rmse / sigma
    return text_of(key, size=f"{_digits(size * scale)} {unit}", since=since, times=_times(times))


def _times(times: float) -> str:
    return f"{times:.0f}" if times >= 9.5 else f"{times:.1f}"


def _digits(value: float) -> str:
    return f"{value:.0f}" if value >= 100.0 else f"{value:.2g}"
