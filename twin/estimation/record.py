"""A recording as arrays in SI units: what every estimator takes.

Rule 1: reading never repairs.  A cell that is not a number becomes NaN and is counted; a time that does not rise ends
        a piece; both are named in `notes`.
Rule 2: u_c of sample k is in force from sample k to k+1 (protocol/README.md, rule 6).
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from protocol.campaign import Kind, Use

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

REGULAR_SHARE = 0.05  # a sampling interval this near to the median is the same interval
GAP_REGULAR = 1.5  # intervals: a longer one in a regular record lost a sample, and with it an unknown input
GAP_IRREGULAR = 10.0  # the same where the sampling time varies on purpose


@dataclass(frozen=True, slots=True, kw_only=True)
class Capture:
    """i_c around one step of u_c at 25 kHz; the sample `step_index`, at the step, still shows what was before."""

    sample_time_s: float
    u_from_v: float
    u_to_v: float
    step_index: int
    i_c_a: FloatArray


@dataclass(frozen=True, slots=True, kw_only=True)
class Record:
    """One recording; all channels have the length of t, an absent channel is all NaN."""

    name: str
    kind: Kind
    use: Use
    t: FloatArray  # s
    u_c: FloatArray  # V, held until the next sample
    i_c: FloatArray  # A
    x: FloatArray  # m, up from the sensor
    x_ref: FloatArray  # m
    captures: tuple[Capture, ...] = ()
    instrument: str = ""  # what read it, where the campaign file says so
    lsb: tuple[float, float] = (0.0, 0.0)  # one count of i_c in A and of x in m, where the log says so
    notes: tuple[str, ...] = field(default=())

    def has(self, *channels: str) -> bool:
        """Whether each of these channels holds at least one number."""
        return all(bool(np.isfinite(getattr(self, channel)).any()) for channel in channels)

    @property
    def interval_s(self) -> float:
        """Median sampling interval; NaN for fewer than two samples."""
        steps = np.diff(self.t)
        steps = steps[np.isfinite(steps) & (steps > 0)]
        return float(np.median(steps)) if steps.size else float("nan")


def intervals(t: FloatArray) -> tuple[FloatArray, BoolArray]:
    """(time to the previous sample, whether this sample follows it without a gap), both of shape (n,).

    Jitter of a rounded time column is taken out: intervals within 1e-3 of the median are the median.
    """
    step = np.empty(len(t))
    step[:1] = np.nan
    step[1:] = np.diff(t)
    good = np.isfinite(step) & (step > 0)
    if not good.any():
        return np.where(good, step, 0.0), good
    median = float(np.median(step[good]))
    # A lost sample leaves twice the interval: a clock that beats regularly all the same.
    near = np.abs(step - np.maximum(np.rint(step / median), 1.0) * median) <= REGULAR_SHARE * median
    regular = np.count_nonzero(near & good) >= 0.9 * np.count_nonzero(good)
    follows = good & (step <= (GAP_REGULAR if regular else GAP_IRREGULAR) * median)
    step = np.where(np.abs(step - median) <= 1e-3 * median, median, step)
    return np.where(follows, step, 0.0), follows


def runs(mask: BoolArray, at_least: int = 1) -> list[slice]:
    """The stretches of True in `mask` that hold at least so many samples."""
    padded = np.concatenate(([False], mask, [False]))
    edges = np.flatnonzero(padded[1:] != padded[:-1])
    return [slice(int(a), int(b)) for a, b in zip(edges[::2], edges[1::2], strict=True) if b - a >= at_least]
