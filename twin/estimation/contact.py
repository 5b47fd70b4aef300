"""Contact of the ball in a recording: held, at rest at a stop, bouncing, or at the end of the sensor's range.

Rule: the data show contact, not the nominal position of a stop: a sensor with an offset or a wrong scale shows the
      stops elsewhere.  In open loop the ball is unstable: if it stays within its noise for 50 ms, something holds it.
      A line in the spectrum of the reading, as of the mains, counts as noise.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from protocol.campaign import Plant
from twin.distributions import robust_spread
from twin.estimation.periodogram import highest_hz, periodogram
from twin.estimation.prepare import scatter
from twin.estimation.record import BoolArray, FloatArray, Record, runs

HELD_SAMPLES = 25  # 50 ms: four times the time constant of the unstable pole
HELD_SCALES = 10.0  # largest spread of x while held, over the sensor noise
BOUNCE_SAMPLES = 5  # 10 ms, the length of the moving average; a bounce takes longer
BOUNCE_MARGIN = 10  # samples at rest before and after a bounce
BOUNCE_SCALES = 10.0  # smallest height of a bounce, over the spread of the moving average in the same rest
STOP_SHARE = 0.25  # of the travel: largest apparent displacement of a stop
AGREE_SHARE = 0.06  # of the travel: largest difference of one stop between recordings (crosstalk, drift)
EDGE_SAMPLES = 4  # left out at both ends of a rest, where the ball still moves
HOVERS_SHARE = 0.02  # of the travel: a rest farther from the recording's other rests is not at the stop
CLIPPED_SHARE = 0.8  # of the samples of a rest
MIN_NOISE_M = 1e-7  # with less noise, the reading of any ball at rest is constant
TURNS = 5.0  # of g: mean over four intervals
CLEAR_STEP = 6.0  # of the noise, between successive readings
END_SHARE = 0.15  # share of readings within 50 ms at the converter's end from which noise is cut off: its mean is not 0
END_REACH = 6.0  # of the noise: within this distance of the converter's end, noise may be cut off
PILE_SAMPLES = 250  # fewest readings near the end for a decision
PILE_SHARE = 0.04  # share of them at the very end; noise that is not cut off has its extreme once in thousands
OPEN_LOOP = ("sawtooth", "prbs", "free")


def held_samples(record: Record, plant: Plant) -> BoolArray:
    """Return whether the ball is held at each sample, shape (n,): in open loop, x within its noise for 50 ms."""
    n = len(record.t)
    # Open loop only: a controller holds a free ball as still as a stop does, while in open loop a free ball is
    # unstable.
    if record.kind not in OPEN_LOOP or n < 2 * HELD_SAMPLES or not record.has("x"):
        return np.zeros(n, np.bool_)
    x = record.x
    known = np.isfinite(x)
    x = np.interp(np.arange(n), np.flatnonzero(known), x[known])
    # The range within a window, not its standard deviation: a slow rise of an unstable ball has a small one at first.
    spread = np.ptp(_windows(x, HELD_SAMPLES), axis=1)
    sigma = max(scatter(x), 1e-4 * plant.travel_m)
    # A line of the sensor is not motion, either: 20 um of mains would hide a ball at rest, and with it the noise.
    # Not under a random input, which shakes a ball on its stop: that may look like a line.
    swing_m = 0.0 if record.kind == "prbs" else _swing(x, record.interval_s)
    core = spread <= HELD_SCALES * sigma + 2.0 * swing_m
    held = _windows(core, HELD_SAMPLES).any(axis=1)  # all samples of a still window are held
    held &= known
    for piece in _rests(held, x, HELD_SCALES * sigma):
        held[piece] &= ~_bounces(record.i_c[piece], x[piece], held[piece], sigma)
    follows_reference = np.abs(x - record.x_ref) < 0.03 * plant.travel_m  # NaN compares False
    # A ball that follows its reference was in closed loop after all, where a standstill does not mean contact.
    if record.kind == "free" and record.has("x_ref") and np.mean(follows_reference) > 0.5:
        held[:] = False
    return np.asarray(held)


def _windows(values: NDArray[Any], size: int) -> NDArray[Any]:
    """Return the values about each one, shape (n, size), size odd; mirrored beyond the ends."""
    # Not scipy.ndimage: its import takes a fifth of a second of each command of the twin.
    return sliding_window_view(np.pad(values, size // 2, mode="symmetric"), size)


def _swing(x: FloatArray, step_s: float) -> float:
    """The amplitude of the line in the readings x that stands out most, with its harmonics, m; 0 without one."""
    if not step_s > 0.0:
        return 0.0
    # Differences, and none of a ball that moves: they would hide the line of one at rest, or be one.
    steps = np.diff(x)
    moves = np.abs(steps) > CLEAR_STEP * robust_spread(steps)
    spectrum = periodogram([np.where(_windows(moves, HELD_SAMPLES).any(axis=1), np.nan, steps)], step_s)
    if spectrum is None:
        return 0.0
    lowest_hz = 1.0 / (HELD_SAMPLES * step_s)  # of a slower line, a window sees a part only
    lines = [at for at in spectrum.harmonics(lowest_hz, highest_hz(step_s)) if at is not None]
    gain = 2.0 * np.sin(np.pi * spectrum.frequency_hz[lines] * step_s)  # of a difference
    return float(sum(spectrum.amplitude(at) / g for at, g in zip(lines, gain, strict=True)))


def _rests(held: BoolArray, x: FloatArray, tolerance_m: float) -> list[slice]:
    """The rests; two that only a bounce separates (at most 50 ms, same height) are one."""
    rests: list[slice] = []
    for piece in runs(held, HELD_SAMPLES):
        last = rests[-1] if rests else None
        if last is not None and piece.start - last.stop < HELD_SAMPLES:
            if abs(float(np.median(x[piece]) - np.median(x[last]))) < tolerance_m:
                rests[-1] = slice(last.start, piece.stop)
                continue
        rests.append(piece)
    return rests


def _bounces(i_c: FloatArray, x: FloatArray, held: BoolArray, sigma: float) -> BoolArray:
    """Return where a ball at rest moves briefly, shape (n,), by less than HELD_SCALES allows.

    Just before lift-off a changing force raises the ball by some ten micrometres.
    """
    # The line over the current takes out crosstalk: else a changing current would look like a ball that moves.
    rest_m = line_over(i_c[held], x[held])(i_c) if np.isfinite(i_c).all() else np.median(x[held])
    off = _windows(x - rest_m, BOUNCE_SAMPLES).mean(axis=1)
    spread = max(robust_spread(off[held]), sigma / np.sqrt(BOUNCE_SAMPLES))
    away = np.abs(off) > BOUNCE_SCALES * spread
    for piece in runs(away, 1):
        # Without rest on both sides it is a lift-off or a landing.
        away[piece] = piece.start >= BOUNCE_MARGIN and len(x) - piece.stop >= BOUNCE_MARGIN
    return np.asarray(away)


def line_over(i_c: FloatArray, x: FloatArray) -> np.polynomial.Polynomial:
    """Fit a line to the readings at rest over the current, m over A: its slope is the sensor's crosstalk."""
    return np.polynomial.Polynomial.fit(i_c, x, 1 if np.ptp(i_c) > 0.0 else 0)


def bounces(record: Record, plant: Plant) -> BoolArray:
    """Return where the ball reverses faster than its weight allows, shape (n,): it has hit a stop.

    A slow or delayed sensor shows such a bounce below the stop; its few readings would dominate the likelihood.
    """
    x, step_s = record.x, record.interval_s
    hit = np.zeros(len(x), np.bool_)
    if len(x) < 7 or not step_s > 0.0:
        return hit
    sigma = scatter(x[np.isfinite(x)])
    steps = np.diff(x)
    # Two clear steps each way: a single wrong reading gives one step each way.
    up, down = np.minimum(steps[:-1], steps[1:]), np.minimum(-steps[:-1], -steps[1:])
    clear = np.minimum(up[:-4], down[4:]) > CLEAR_STEP * sigma
    # Mean slopes over two intervals before and after: their difference is an acceleration, compared with the weight's.
    change = ((x[2:-4] - x[:-6]) + (x[4:-2] - x[6:])) / (2.0 * step_s)
    min_change = TURNS * plant.gravity_m_s2 * 4.0 * step_s + CLEAR_STEP * sigma / step_s
    even = np.convolve(np.abs(np.diff(record.t) - step_s) < 0.5 * step_s, np.ones(6), mode="valid") == 6.0
    hit[3:-3] = clear & (change > min_change) & even
    return np.asarray(_windows(hit, 3).any(axis=1))


def at_converter_end(values: FloatArray) -> BoolArray:
    """Return where so many readings share the record's extreme value that noise must be cut off, shape (n,)."""
    cut = np.zeros(len(values), np.bool_)
    if len(values) < HELD_SAMPLES or not np.isfinite(values).any():
        return cut
    for end in (np.nanmin(values), np.nanmax(values)):
        # The share at the exact end value, not the distance to a nominal range: the converter's range is often not
        # known.
        cut |= _windows(values == end, HELD_SAMPLES).mean(axis=1) > END_SHARE
    return cut


def partly_cut_off(values: FloatArray) -> BoolArray:
    """Return where some noise of the (finite) readings is cut off, too little for `at_converter_end`, shape (n,).

    The error of their mean is below a tenth of the noise.
    """
    cut = np.zeros(len(values), np.bool_)
    sigma, levels = scatter(values), np.unique(values)
    if len(values) < PILE_SAMPLES or len(levels) < 2 or sigma <= np.diff(levels).min():
        return cut  # on a coarse converter every level is frequent
    reach = END_REACH * sigma
    for end in (values.min(), values.max()):
        in_reach = np.abs(values - end) <= reach
        cut |= in_reach & (in_reach.sum() >= PILE_SAMPLES) & (np.mean(values[in_reach] == end) > PILE_SHARE)
    return cut


def stop_readings(
    records: Sequence[Record], held: Sequence[BoolArray], plant: Plant, notes: list[str]
) -> tuple[float | None, float | None]:
    """Return (reading at the lower stop, at the upper stop), m; None if unknown or if the recordings disagree.

    Args:
        records: the recordings.
        held: `held_samples` of each.
        plant: travel.
        notes: receives a sentence on each disagreement.
    """
    readings: tuple[list[float], list[float]] = ([], [])
    for record, at_rest in zip(records, held, strict=True):
        levels = [float(np.median(record.x[piece])) for piece in runs(at_rest, HELD_SAMPLES)]
        for side, stop in enumerate((0.0, plant.travel_m)):
            matching = [level for level in levels if abs(level - stop) < STOP_SHARE * plant.travel_m]
            if matching:
                readings[side].append(float(np.median(matching)))
    stops: list[float | None] = []
    for side, what in enumerate(("lower", "upper")):
        levels = readings[side]
        # No mean of the two: at most one height is that of the stop, and nothing tells which.
        if levels and max(levels) - min(levels) > AGREE_SHARE * plant.travel_m:
            notes.append(f"the ball rested at different heights near the {what} stop: not used as a stop")
            levels = []
        stops.append(float(np.median(levels)) if levels else None)
    return stops[0], stops[1]


def range_ends(records: Sequence[Record], held: Sequence[BoolArray]) -> list[float]:
    """Return the ends of the position sensor's range, m: a ball at rest beyond one gives that reading without noise."""
    # Decided from all recordings: one with the ball beyond the range shows no noise, whatever noise its sensor has.
    if min_noise(records) < MIN_NOISE_M:
        return []
    blind = set()
    for record, at_rest in zip(records, held, strict=True):
        for piece in runs(at_rest, HELD_SAMPLES):
            ends = float(np.nanmin(record.x)), float(np.nanmax(record.x))
            blind |= {end for end in ends if np.mean(record.x[piece] == end) > CLIPPED_SHARE}
    return sorted(blind)


def outside_range(record: Record, held: BoolArray, blind: Sequence[float]) -> BoolArray:
    """Return where the ball is held beyond its sensor's range (`blind`, of `range_ends`), shape (n,); i_c is valid."""
    mask = np.zeros(len(record.t), np.bool_)
    at_end = np.isin(record.x, blind)
    for piece in runs(held, HELD_SAMPLES):
        if np.mean(at_end[piece]) > CLIPPED_SHARE:
            mask[piece.start + EDGE_SAMPLES : piece.stop - EDGE_SAMPLES] = True
    return mask


def min_noise(records: Sequence[Record]) -> float:
    """Return the smallest noise of the position among the recordings, m, without the extreme readings of each."""
    levels = []
    for x in (record.x[np.isfinite(record.x)] for record in records):
        # Readings at the converter's end have no noise, and many of them would make the sensor seem quiet.
        between = x[(x != x.min()) & (x != x.max())] if len(x) else x
        levels += [scatter(between)] if len(between) >= HELD_SAMPLES else []
    return min(levels, default=0.0)


def converter_step(records: Sequence[Record]) -> float:
    """Return the position converter's resolution, m: the smallest difference of two readings; 0 if all are equal."""
    differences = []
    for record in records:
        steps = np.diff(np.unique(record.x[np.isfinite(record.x)]))
        differences += [float(steps.min())] if len(steps) else []
    return min(differences, default=0.0)


def on_stops(
    record: Record, held: BoolArray, low: float | None, high: float | None, plant: Plant
) -> tuple[BoolArray, BoolArray]:
    """Return where the ball rests at the (lower, upper) stop, each of shape (n,).

    Args:
        record: the recording.
        held: of `held_samples`.
        low: reading at the lower stop, m; None: unknown.
        high: reading at the upper stop, m; None: unknown.
        plant: travel.
    """
    masks = []
    for stop in (low, high):
        mask = np.zeros(len(record.t), np.bool_)
        pieces = runs(held, HELD_SAMPLES) if stop is not None else []
        matching = [
            p for p in pieces if abs(float(np.median(record.x[p])) - (stop or 0.0)) < AGREE_SHARE * plant.travel_m
        ]
        for piece in _lying(record, matching, plant):
            mask[piece.start + EDGE_SAMPLES : piece.stop - EDGE_SAMPLES] = True
        masks.append(mask)
    return masks[0], masks[1]


def _lying(record: Record, pieces: Sequence[slice], plant: Plant) -> list[slice]:
    """The rests at the stop, without those of a ball that hovers beside it.

    At the stop the readings lie on a line over i_c, whose slope is the sensor's crosstalk.
    """
    if len(pieces) < 2:
        return list(pieces)
    i_c, x = (np.concatenate([values[piece] for piece in pieces]) for values in (record.i_c, record.x))
    known = np.isfinite(i_c) & np.isfinite(x)
    if known.sum() < HELD_SAMPLES:
        return list(pieces)
    # The other rests decide, not the noise alone: a disturbed ball hovered above its stop within ten times the noise.
    # Its few readings changed the log-likelihood by thousands.
    line = line_over(i_c[known], x[known])
    off = [abs(float(np.nanmedian(record.x[piece] - line(record.i_c[piece])))) for piece in pieces]
    return [piece for piece, distance in zip(pieces, off, strict=True) if not distance > HOVERS_SHARE * plant.travel_m]
