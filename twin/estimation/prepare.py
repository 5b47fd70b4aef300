"""Turn recordings into one series of flagged samples: gaps, contacts with the stops, clipped readings and outliers.

Rule 1: nothing is interpolated.  Unusable readings are left out of the filter's correction; an unknown input starts a
        new piece.
Rule 2: the number of samples left out is reported for each recording (`Usage`).
Rule 3: a sawtooth gives lift-off currents (`twin/evidence/starting/liftoff.py`).  Its x is not used here, because
        before lift-off the ball may rest on anything at any height.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from protocol.campaign import Plant
from twin.distributions import robust_spread
from twin.estimation.innovations import CAPTURED, FLIES, FOLLOWS, USE_I, USE_X, Series
from twin.estimation.record import BoolArray, FloatArray, Record, intervals, runs

CONTACT_SHARE = 0.01  # of the travel: a ball nearer to a stop is in contact
REST_SHARE = 0.05  # of the travel: a plateau this near to a stop is the stop, read with a sensor offset
REST_SAMPLES = 25
REACH = 1.3  # times the last or next change of x: largest motion within an interval, with acceleration
FLIGHT_SAMPLES = 8  # a shorter flight determines nothing but its own initial state
SPIKE_SCALES = 12.0  # of the robust spread about the neighbours: more is a bit error, not motion
CLIPPED_RUN = 6  # equal extreme readings in a row are at the converter's end
CUT_SHARE, CUT_FEWEST = 0.01, 25  # share and number of samples at the lowest i_c if that is the converter's end
CUT_INPUT_SHARE = 0.02  # of the largest u_c: a smaller input is zero
BLOCK_SAMPLES = 20_000  # chains are cut here, so that the memory does not grow with the recording
_CAPTURE_LEAD = 20  # samples of a capture before the step


@dataclass(slots=True, kw_only=True)
class Usage:
    """The use of one recording's samples."""

    name: str
    kind: str
    samples: int = 0
    pieces: int = 0  # chains without a gap
    flights: int = 0  # stretches away from the stops
    flight_samples: int = 0
    contact_samples: int = 0
    steep_samples: int = 0  # in flight, but nearer to x_max than `min_gap_m`
    clipped: int = 0
    cut: int = 0  # readings of i_c near zero, where the converter cuts off the negative half of the noise
    outliers: int = 0
    gaps: int = 0
    captures: int = 0
    input_delay: int = 0  # samples by which u_c acts later than recorded; corrected


def prepare(records: list[Record], plant: Plant, *, min_gap_m: float = 0.0) -> tuple[Series, list[Usage]]:
    """The series of all recordings that have u_c and i_c, and the usage of each recording.

    Args:
        records: of `read_campaign`.
        plant: travel and x_max.
        min_gap_m: samples with the ball nearer to x_max, m, are not in flight.
    """
    parts: list[Series] = []
    usages: list[Usage] = []
    for number, record in enumerate(records):
        usage = Usage(name=record.name, kind=record.kind, samples=len(record.t), captures=len(record.captures))
        usages.append(usage)
        if record.kind == "equilibria":
            continue
        if record.has("u_c", "i_c") and len(record.t) > 1:
            parts.append(_series(record, plant, usage, number, min_gap_m))
        parts.extend(_captures(record, number))
    return parts[0] if len(parts) == 1 else Series.joined(parts), usages


def flights(record: Record, plant: Plant, *, min_samples: int = FLIGHT_SAMPLES) -> list[slice]:
    """Return the stretches of at least `min_samples` samples in which the ball is free and no sample is missing."""
    _, follows = intervals(record.t)
    free = in_flight(record.x, plant) & np.isfinite(record.t)
    return [
        slice(piece.start + a.start, piece.start + a.stop)
        for piece in runs(free, min_samples)
        for a in _split(follows[piece], min_samples)
    ]


def in_flight(x: FloatArray, plant: Plant) -> BoolArray:
    """Return whether the ball is free of the stops at each sample, shape (n,); a missing x repeats the previous one."""
    known = np.isfinite(x)
    if not known.any():
        return np.zeros(len(x), np.bool_)
    held = x[np.maximum.accumulate(np.where(known, np.arange(len(x)), np.argmax(known)))]
    low, high = 0.0, plant.travel_m
    margin = max(CONTACT_SHARE * plant.travel_m, 8.0 * scatter(held))
    for side, stop in ((0, 0.0), (1, plant.travel_m)):
        at_stop = held[np.abs(held - stop) < REST_SHARE * plant.travel_m]
        if at_stop.size >= REST_SAMPLES:
            # The quartile on the stop's side is not affected by a slow motion near the stop.
            level = float(np.percentile(at_stop, 25 if side == 0 else 75))
            low, high = (max(low, level), high) if side == 0 else (low, min(high, level))
    # A fast ball can hit a stop and rebound between two samples: it is in contact if, at its speed, it could have
    # reached the stop within an interval.
    jump = np.abs(np.diff(held))
    reach = np.zeros(len(held))
    for lag in (-1, 0):
        shifted = np.zeros(len(held))
        shifted[-lag : len(held) - 1 - lag] = jump
        reach = np.maximum(reach, shifted)
    clearance = margin + REACH * reach
    free = (held > low + clearance) & (held < high - clearance)
    free[1:] &= free[:-1].copy()  # the samples next to a contact belong to it
    free[:-1] &= free[1:].copy()
    return np.asarray(free)


def _split(follows: BoolArray, min_samples: int) -> list[slice]:
    starts = [0, *(int(n) for n in np.flatnonzero(~follows) if n > 0), len(follows)]
    return [slice(a, b) for a, b in pairwise(starts) if b - a >= min_samples]


def scatter(values: FloatArray) -> float:
    """Estimate the noise of a smooth signal: robust scale of its third difference over sqrt(20), its gain for noise."""
    if len(values) < 8:
        return 0.0
    # The median, not the mean square: an impact makes a few large differences, which would dominate a mean.
    third = np.diff(values, 3)
    return robust_spread(third - np.median(third)) / float(np.sqrt(20.0))


def _series(record: Record, plant: Plant, usage: Usage, number: int, min_gap_m: float) -> Series:
    step, follows = intervals(record.t)
    n = len(step)
    u_known = np.isfinite(record.u_c)
    use_i, use_x = np.isfinite(record.i_c), np.isfinite(record.x)
    clipped = _clipped(record.i_c)
    usage.clipped = int(clipped.sum())
    cut = _cut(record) & ~clipped
    usage.cut = int(np.count_nonzero(cut & use_i))
    use_i &= ~clipped & ~cut
    broken = clipped | ~u_known  # the coil current after this sample is unknown
    follows = follows.copy()
    follows[1:] &= ~broken[:-1]
    follows[0] = False
    usage.gaps = int(np.count_nonzero(~follows[1:]))
    follows[::BLOCK_SAMPLES] = False
    usage.pieces = int(np.count_nonzero(~follows))
    flies = np.zeros(n, np.bool_)
    # Before lift-off a ball may rest on anything at any height, and may creep: a sawtooth gives no flight.
    if record.has("x") and record.kind not in ("sawtooth", "amplifier-step"):
        wild = spikes(record.x, plant)
        use_x &= ~wild
        free = in_flight(np.where(wild, np.nan, record.x), plant)
        usage.contact_samples = int(np.count_nonzero(~free))
        steep = np.asarray(plant.x_max_m - np.where(free, record.x, -np.inf) < min_gap_m)
        steep[1:] |= steep[:-1].copy()  # both samples of such an interval
        steep[:-1] |= steep[1:].copy()
        steep &= free
        usage.steep_samples = int(np.count_nonzero(steep))
        free &= ~steep
        for piece in runs(free, FLIGHT_SAMPLES):
            for part in _split(follows[piece], FLIGHT_SAMPLES):
                flies[piece.start + part.start : piece.start + part.stop] = True
                usage.flights += 1
        usage.flight_samples = int(flies.sum())
        usage.outliers = int(np.count_nonzero(wild & flies))
    flags = FOLLOWS * follows + FLIES * flies + USE_I * use_i + USE_X * (use_x & flies)
    return Series(
        step=step,
        u=np.where(u_known, record.u_c, 0.0),
        i=np.where(use_i, record.i_c, 0.0),
        x=np.where(np.isfinite(record.x), record.x, 0.0),
        flags=flags.astype(np.uint16),
        recording=np.full(n, number, np.int32),
    )


def _clipped(values: FloatArray) -> BoolArray:
    clipped = np.zeros(len(values), np.bool_)
    if not np.isfinite(values).any():
        return clipped
    top = np.nanmax(values)
    spread = np.nanmax(values) - np.nanmin(values)
    for piece in runs(np.asarray(values >= top), CLIPPED_RUN):
        # A signal at its converter's end arrives there from below; a noiseless constant signal is not clipped.
        before = values[max(piece.start - 1, 0)]
        if top - before > 1e-3 * spread and spread > 0:
            clipped[piece] = True
    return clipped


def _cut(record: Record) -> BoolArray:
    """Return the readings of i_c near its lowest value, if that value is frequent under zero input, shape (n,).

    A unipolar converter cuts off negative noise, so the mean of its readings at 0 A is not zero and would bias the fit.
    """
    known = np.isfinite(record.i_c) & np.isfinite(record.u_c)
    if not known.any():
        return np.zeros(len(record.t), np.bool_)
    lowest = np.min(record.i_c[known])
    pile = known & (record.i_c == lowest)
    idle = np.median(record.u_c[pile]) <= CUT_INPUT_SHARE * max(float(np.max(record.u_c[known])), 0.0)
    if not idle or np.count_nonzero(pile) < max(CUT_FEWEST, CUT_SHARE * len(record.t)):
        return np.zeros(len(record.t), np.bool_)
    # All readings within the noise go, not the cut ones alone: without those, the others would be too high on average.
    reach = 6.0 * scatter(record.i_c[known])
    return np.asarray(known & (record.i_c <= lowest + reach) & (record.u_c <= np.max(record.u_c[pile])))


def spikes(x: FloatArray, plant: Plant) -> BoolArray:
    """Return outliers, shape (n,): single readings far off the cubic of their four neighbours, more than these are.

    Readings near a possible impact are excepted, as an impact is not smooth either.
    """
    wild = np.zeros(len(x), np.bool_)
    if len(x) < 16:
        return wild
    off = np.zeros(len(x))
    off[2:-2] = np.abs(x[2:-2] - (4.0 * (x[1:-3] + x[3:-1]) - x[:-4] - x[4:]) / 6.0)
    off = np.where(np.isfinite(off), off, 0.0)
    steps = np.abs(np.diff(x))
    steps = steps[np.isfinite(steps) & (steps > 0)]
    count = float(np.min(steps)) if steps.size else 0.0
    # At least one count of the converter: a smaller scale would take its rounding for outliers.
    scale = max(robust_spread(off[off > 0]) if (off > 0).any() else 0.0, count)
    # Only the largest of neighbours: a wrong reading puts those beside it off their own cubic, too.
    wild[1:-1] = (off[1:-1] > SPIKE_SCALES * scale) & (off[1:-1] >= off[:-2]) & (off[1:-1] >= off[2:])
    middle, difference = 0.5 * (x[:-2] + x[2:]), np.abs(x[2:] - x[:-2])
    clear = difference + 2.0 * CONTACT_SHARE * plant.travel_m
    wild[1:-1] &= (middle > clear) & (middle < plant.travel_m - clear)
    return wild


def captured(record: Record) -> int:
    """Return the number of samples of its captures in the series; they follow all others."""
    return sum(len(capture.i_c_a) - max(capture.step_index - _CAPTURE_LEAD, 0) for capture in record.captures)


def _captures(record: Record, number: int) -> list[Series]:
    series = []
    for capture in record.captures:
        first = max(capture.step_index - _CAPTURE_LEAD, 0)
        i = capture.i_c_a[first:]
        n = len(i)
        u = np.full(n, capture.u_to_v)
        u[: capture.step_index - first] = capture.u_from_v
        flags = np.full(n, FOLLOWS + USE_I + CAPTURED, np.uint16)
        flags[0] = USE_I + CAPTURED
        series.append(
            Series(
                step=np.full(n, capture.sample_time_s),
                u=u,
                i=np.asarray(i, dtype=float),
                x=np.zeros(n),
                flags=flags,
                recording=np.full(n, number, np.int32),
            )
        )
    return series
