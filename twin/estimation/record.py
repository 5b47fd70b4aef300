"""A recording as arrays in SI units, the input of every estimator.

Rule 1: readers do not repair data.  A cell that is not a number becomes NaN and is counted; a time that does not rise
        ends a piece; `notes` reports both.
Rule 2: u_c of sample k is in force from sample k to k+1 (protocol/README.md, rule 6).
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime

import numpy as np
from numpy.typing import NDArray

from protocol.campaign import Kind, Use

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

REGULAR_SHARE = 0.05  # of the median: intervals this near to it are regular
GAP_REGULAR = 1.5  # times the median: a longer interval of a regular record is a lost sample with an unknown input
GAP_IRREGULAR = 10.0  # the same for a sampling time that varies on purpose


@dataclass(frozen=True, slots=True, kw_only=True)
class Capture:
    """i_c around one step of u_c at 25 kHz; the sample `step_index`, at the step, still has the current before it."""

    sample_time_s: float
    u_from_v: float
    u_to_v: float
    step_index: int
    i_c_a: FloatArray


@dataclass(frozen=True, slots=True, kw_only=True)
class Record:
    """A recording; all channels have the shape of t, (n,); a missing channel is NaN."""

    name: str
    kind: Kind
    use: Use
    t: FloatArray  # s
    u_c: FloatArray  # V, held until the next sample
    i_c: FloatArray  # A
    x: FloatArray  # m, up from the sensor
    x_ref: FloatArray  # m
    captures: tuple[Capture, ...] = ()
    instrument: str = ""  # the instrument, if the campaign file names it
    lsb: tuple[float, float] = (0.0, 0.0)  # one count of i_c in A and of x in m, if the log contains it
    notes: tuple[str, ...] = field(default=())
    # e of true interval = (1 + e) interval of the board, by the times of arrival at the computer, and its standard
    # error; None: unknown.
    clock_error: tuple[float, float] | None = None
    began_ns: int = 0  # Unix time of the first sample, ns; 0: the file does not state it

    def part(self, which: slice | BoolArray) -> Record:
        """The same with some of the samples; views for a slice."""
        channels = ("t", "u_c", "i_c", "x", "x_ref")
        return replace(self, **{channel: getattr(self, channel)[which] for channel in channels})

    def has(self, *channels: str) -> bool:
        """Return whether each of these channels holds at least one number."""
        return all(bool(np.isfinite(getattr(self, channel)).any()) for channel in channels)

    @property
    def interval_s(self) -> float:
        """Return the median sampling interval; NaN for fewer than two samples."""
        steps = np.diff(self.t)
        steps = steps[np.isfinite(steps) & (steps > 0)]
        # The median, not the mean: a lost sample doubles one interval.
        return float(np.median(steps)) if steps.size else float("nan")


def day_of(records: Iterable[Record]) -> dict[str, str]:
    """Return {"measured": day of the first recording, UTC, ISO 8601}; empty if no file states a time."""
    began = min((record.began_ns for record in records if record.began_ns), default=0)
    return {"measured": datetime.fromtimestamp(began * 1e-9, UTC).date().isoformat()} if began else {}


def intervals(t: FloatArray) -> tuple[FloatArray, BoolArray]:
    """Return (time since the previous sample in s, whether there is no gap between them), both of shape (n,).

    Intervals within 1e-3 of the median are set to the median, as a rounded time column jitters.
    """
    step = np.empty(len(t))
    step[:1] = np.nan
    step[1:] = np.diff(t)
    good = np.isfinite(step) & (step > 0)
    if not good.any():
        return np.where(good, step, 0.0), good
    median = float(np.median(step[good]))
    # A lost sample doubles the interval of a regular clock.
    on_grid = np.abs(step - np.maximum(np.rint(step / median), 1.0) * median) <= REGULAR_SHARE * median
    regular = np.count_nonzero(on_grid & good) >= 0.9 * np.count_nonzero(good)
    # Not by one limit for all clocks: where the interval varies on purpose, twice the median is no gap.
    follows = good & (step <= (GAP_REGULAR if regular else GAP_IRREGULAR) * median)
    step = np.where(np.abs(step - median) <= 1e-3 * median, median, step)
    return np.where(follows, step, 0.0), follows


def runs(mask: BoolArray, min_samples: int = 1) -> list[slice]:
    """The stretches of True in `mask` with at least `min_samples` samples."""
    padded = np.concatenate(([False], mask, [False]))
    edges = np.flatnonzero(padded[1:] != padded[:-1])
    return [slice(int(a), int(b)) for a, b in zip(edges[::2], edges[1::2], strict=True) if b - a >= min_samples]
