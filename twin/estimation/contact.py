"""What the readings of one recording say about contact: held, lying at a stop, bouncing, at the end of a range.

Rule: contact is told by the data, not by the number 0: a sensor with an offset or a wrong scale shows the stops at
      other places, and that is evidence.  In open loop an unstable ball that stays within its noise for 50 ms is held.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.ndimage import maximum_filter1d, minimum_filter1d, uniform_filter1d

from protocol.campaign import Plant
from twin.estimation.record import BoolArray, FloatArray, Record, runs

HELD_SAMPLES = 25  # 50 ms: four times the time constant of the unstable pole
HELD_SCALES = 10.0  # of the sensor noise, largest spread while held
BOUNCE_SAMPLES = 5  # 10 ms: a ball that bounces is off its place for longer
BOUNCE_APART = 10  # a bounce begins and ends at rest
BOUNCE_SCALES = 10.0  # of the mean of so many readings, as it spreads in the same rest
NEAR_SHARE = 0.25  # of the travel: as far as a stop may seem displaced
AGREE_SHARE = 0.06  # of the travel: by this much the same stop may differ between recordings (crosstalk, drift)
EDGE_SAMPLES = 4  # left out at both ends of a rest: the ball rocks
HOVERS_SHARE = 0.02  # of the travel: so far from where it reads in the same recording's other rests, it does not lie
CLIPPED_SHARE = 0.8  # of a rest
NOISE_LEAST_M = 1e-7  # with less, a ball at rest has one reading wherever it rests
TURNS = 5.0  # of g, on the mean over four intervals
CLEAR_STEP = 6.0  # of the noise, from reading to reading
END_SHARE = 0.15  # of readings within 50 ms at the converter's end: the noise is cut off there, and its mean is not 0
NEAR_END = 6.0  # of the noise: so far from the end a reading may be one of those whose noise is cut off there
PILE_SAMPLES = 250  # as many readings near the end tell
PILE_SHARE = 0.04  # of them at the very end: noise that is not cut off has its lowest reading once in thousands
OPEN_LOOP = ("sawtooth", "prbs", "free")


def held_samples(record: Record, plant: Plant) -> BoolArray:
    """Where the ball is held by something, shape (n,): open loop, and x within its noise for 50 ms."""
    n = len(record.t)
    if record.kind not in OPEN_LOOP or n < 2 * HELD_SAMPLES or not record.has("x"):
        return np.zeros(n, np.bool_)
    x = record.x
    known = np.isfinite(x)
    x = np.interp(np.arange(n), np.flatnonzero(known), x[known])
    spread = maximum_filter1d(x, HELD_SAMPLES) - minimum_filter1d(x, HELD_SAMPLES)
    least = max(noise_of(x), 1e-4 * plant.travel_m)
    core = spread <= HELD_SCALES * least
    held = maximum_filter1d(core.astype(np.uint8), HELD_SAMPLES) > 0  # a window that is still is still at its ends
    held &= known
    for piece in _rests(held, x, HELD_SCALES * least):
        held[piece] &= ~_bounces(record.i_c[piece], x[piece], held[piece], least)
    follows_reference = np.abs(x - record.x_ref) < 0.03 * plant.travel_m  # NaN compares False
    if record.kind == "free" and record.has("x_ref") and np.mean(follows_reference) > 0.5:
        held[:] = False
    return np.asarray(held)


def _rests(held: BoolArray, x: FloatArray, near_m: float) -> list[slice]:
    """Where the ball is held, those together that a bounce has cut in two: 50 ms apart at most, at one height."""
    rests: list[slice] = []
    for piece in runs(held, HELD_SAMPLES):
        last = rests[-1] if rests else None
        if last is not None and piece.start - last.stop < HELD_SAMPLES:
            if abs(float(np.median(x[piece]) - np.median(x[last]))) < near_m:
                rests[-1] = slice(last.start, piece.stop)
                continue
        rests.append(piece)
    return rests


def _bounces(i_c: FloatArray, x: FloatArray, held: BoolArray, sigma: float) -> BoolArray:
    """Where a ball that lies otherwise leaves its place for a moment, shape (n,), by less than a rest may spread.

    Just before it lifts off for good, a force that comes and goes raises it by some ten micrometres.
    """
    place = line_over(i_c[held], x[held])(i_c) if np.isfinite(i_c).all() else np.median(x[held])
    off = uniform_filter1d(x - place, BOUNCE_SAMPLES)
    spread = max(1.4826 * float(np.median(np.abs(off[held]))), sigma / np.sqrt(BOUNCE_SAMPLES))
    away = np.abs(off) > BOUNCE_SCALES * spread
    for piece in runs(away, 1):
        # A ball that does not come back to rest took off there, or came to rest.
        away[piece] = piece.start >= BOUNCE_APART and len(x) - piece.stop >= BOUNCE_APART
    return np.asarray(away)


def line_over(i_c: FloatArray, x: FloatArray) -> np.polynomial.Polynomial:
    """Reading of a ball that lies over the current, m over A: crosstalk of the sensor shows it along a line."""
    return np.polynomial.Polynomial.fit(i_c, x, 1 if np.ptp(i_c) > 0.0 else 0)


def bounces(record: Record, plant: Plant) -> BoolArray:
    """Where a ball that rose falls, sooner than its weight can turn it, shape (n,): it hit a stop.

    A slow or late sensor shows such a bounce anywhere below the stop, and four readings of one decided over 30 000.
    """
    x, step_s = record.x, record.interval_s
    hit = np.zeros(len(x), np.bool_)
    if len(x) < 7 or not step_s > 0.0:
        return hit
    sigma = noise_of(x[np.isfinite(x)])
    steps = np.diff(x)
    # Two clear steps each way: a wrong reading goes up and down, too, but by one.
    rises, falls = np.minimum(steps[:-1], steps[1:]), np.minimum(-steps[:-1], -steps[1:])
    clear = np.minimum(rises[:-4], falls[4:]) > CLEAR_STEP * sigma
    change = ((x[2:-4] - x[:-6]) + (x[4:-2] - x[6:])) / (2.0 * step_s)
    least = TURNS * plant.gravity_m_s2 * 4.0 * step_s + CLEAR_STEP * sigma / step_s
    even = np.convolve(np.abs(np.diff(record.t) - step_s) < 0.5 * step_s, np.ones(6), mode="valid") == 6.0
    hit[3:-3] = clear & (change > least) & even
    return np.asarray(maximum_filter1d(hit.astype(np.uint8), 3) > 0)


def at_converter_end(values: FloatArray) -> BoolArray:
    """Where readings stand at the lowest or highest value of the record so often that noise must be cut off there."""
    cut = np.zeros(len(values), np.bool_)
    if len(values) < HELD_SAMPLES or not np.isfinite(values).any():
        return cut
    for end in (np.nanmin(values), np.nanmax(values)):
        at_end = (values == end).astype(float)
        cut |= uniform_filter1d(at_end, HELD_SAMPLES) > END_SHARE
    return cut


def near_converter_end(values: FloatArray) -> BoolArray:
    """Where finite readings have less noise than the sensor: some of it is cut off, too little for `at_converter_end`.

    Their mean is right within a tenth of the noise.
    """
    cut = np.zeros(len(values), np.bool_)
    sigma, levels = noise_of(values), np.unique(values)
    if len(values) < PILE_SAMPLES or len(levels) < 2 or sigma <= np.diff(levels).min():
        return cut  # with a coarse converter any level is read often
    reach = NEAR_END * sigma
    for end in (values.min(), values.max()):
        near = np.abs(values - end) <= reach
        cut |= near & (near.sum() >= PILE_SAMPLES) & (np.mean(values[near] == end) > PILE_SHARE)
    return cut


def noise_of(x: FloatArray) -> float:
    """Standard deviation of white noise on a smooth signal, from its third difference."""
    if len(x) < 8:
        return 0.0
    third = np.diff(x, 3)
    return float(1.4826 * np.median(np.abs(third - np.median(third))) / np.sqrt(20.0))


def stop_readings(
    records: Sequence[Record], held: Sequence[BoolArray], plant: Plant, notes: list[str]
) -> tuple[float | None, float | None]:
    """Readings at the lower and the upper stop, where the recordings agree on them."""
    found: tuple[list[float], list[float]] = ([], [])
    for record, still in zip(records, held, strict=True):
        levels = [float(np.median(record.x[piece])) for piece in runs(still, HELD_SAMPLES)]
        for side, stop in enumerate((0.0, plant.travel_m)):
            near = [level for level in levels if abs(level - stop) < NEAR_SHARE * plant.travel_m]
            if near:
                found[side].append(float(np.median(near)))
    places: list[float | None] = []
    for side, what in enumerate(("lower", "upper")):
        levels = found[side]
        if levels and max(levels) - min(levels) > AGREE_SHARE * plant.travel_m:
            notes.append(f"the ball rested at different heights near the {what} stop: not used as a stop")
            levels = []
        places.append(float(np.median(levels)) if levels else None)
    return places[0], places[1]


def range_ends(records: Sequence[Record], held: Sequence[BoolArray]) -> list[float]:
    """Readings beyond which the position sensor shows nothing: a ball at rest there reads that one, without noise."""
    if least_noise(records) < NOISE_LEAST_M:
        return []
    found = set()
    for record, still in zip(records, held, strict=True):
        for piece in runs(still, HELD_SAMPLES):
            ends = float(np.nanmin(record.x)), float(np.nanmax(record.x))
            found |= {end for end in ends if np.mean(record.x[piece] == end) > CLIPPED_SHARE}
    return sorted(found)


def beyond_range(record: Record, still: BoolArray, blind: Sequence[float]) -> BoolArray:
    """Where the ball is held beyond the range of its sensor, shape (n,): i_c says there what it says at any rest."""
    mask = np.zeros(len(record.t), np.bool_)
    beyond = np.isin(record.x, blind)
    for piece in runs(still, HELD_SAMPLES):
        if np.mean(beyond[piece]) > CLIPPED_SHARE:
            mask[piece.start + EDGE_SAMPLES : piece.stop - EDGE_SAMPLES] = True
    return mask


def least_noise(records: Sequence[Record]) -> float:
    """Noise of position readings between the ends of their recording, m: the least that one of them shows."""
    found = []
    for x in (record.x[np.isfinite(record.x)] for record in records):
        between = x[(x != x.min()) & (x != x.max())] if len(x) else x
        found += [noise_of(between)] if len(between) >= HELD_SAMPLES else []
    return min(found, default=0.0)


def converter_step(records: Sequence[Record]) -> float:
    """Step of the position converter, m: the smallest between two readings; 0 without two."""
    found = []
    for record in records:
        steps = np.diff(np.unique(record.x[np.isfinite(record.x)]))
        found += [float(steps.min())] if len(steps) else []
    return min(found, default=0.0)


def on_stops(
    record: Record, still: BoolArray, low: float | None, high: float | None, plant: Plant
) -> tuple[BoolArray, BoolArray]:
    """Where the ball lies at the lower and at the upper stop, each of shape (n,); their readings may be unknown."""
    masks = []
    for stop in (low, high):
        mask = np.zeros(len(record.t), np.bool_)
        pieces = runs(still, HELD_SAMPLES) if stop is not None else []
        near = [p for p in pieces if abs(float(np.median(record.x[p])) - (stop or 0.0)) < AGREE_SHARE * plant.travel_m]
        for piece in _lying(record, near, plant):
            mask[piece.start + EDGE_SAMPLES : piece.stop - EDGE_SAMPLES] = True
        masks.append(mask)
    return masks[0], masks[1]


def _lying(record: Record, pieces: Sequence[slice], plant: Plant) -> list[slice]:
    """Those of the rests near a stop that are of a ball which lies: one that hovers beside it reads differently.

    A sensor with crosstalk shows one that lies along a line over i_c.
    """
    if len(pieces) < 2:
        return list(pieces)
    i_c, x = (np.concatenate([values[piece] for piece in pieces]) for values in (record.i_c, record.x))
    known = np.isfinite(i_c) & np.isfinite(x)
    if known.sum() < HELD_SAMPLES:
        return list(pieces)
    line = line_over(i_c[known], x[known])
    off = [abs(float(np.nanmedian(record.x[piece] - line(record.i_c[piece])))) for piece in pieces]
    return [piece for piece, by in zip(pieces, off, strict=True) if not by > HOVERS_SHARE * plant.travel_m]
