"""A campaign as one series of flagged samples, with what the ball says while it lies at a stop.

Rule 1: contact is told by the data, not by the number 0: a sensor with an offset or a wrong scale shows the stops at
        other places, and that is evidence.  In open loop an unstable ball that stays within its noise for 50 ms is
        held.
Rule 2: places where it was held are stops only if all recordings agree on them; a ball that rested on a platform at
        another height each time gives lift-off currents (8) and nothing else.
Rule 3: a judge recording never enters the series of the fit, and the other way round.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import maximum_filter1d, minimum_filter1d, uniform_filter1d

from protocol.campaign import Plant
from twin.diagnose.bridge import between, bridged, mark
from twin.diagnose.filter import RESTS_HIGH, RESTS_LOW, RESTS_UNSEEN
from twin.identify.innovations import FLIES, FOLLOWS, USE_I, USE_X, Series
from twin.identify.liftoff import LiftOff, equilibria, lift_offs
from twin.identify.prepare import Usage, prepare
from twin.identify.record import BoolArray, FloatArray, Record, runs

HELD_SAMPLES = 25  # 50 ms: four times the time constant of the unstable pole
HELD_SCALES = 10.0  # of the sensor noise, largest spread while held
NEAR_SHARE = 0.25  # of the travel: as far as a stop may seem displaced
AGREE_SHARE = 0.06  # of the travel: by this much the same stop may differ between recordings (crosstalk, drift)
TRIM_SAMPLES = 2
LIFTS_SHARE = 0.97  # of the current at which the ball left its rest
STAYS_S = 3e-3  # after that current is reached: it has risen 10 um by then
POLE_SHARE = 0.06  # of the travel below x_max, where (3) has its pole: no flight is judged there
EDGE_SAMPLES = 4  # left out at both ends of a rest: the ball rocks
HOVERS_SHARE = 0.02  # of the travel: so far from where it reads in the same recording's other rests, it does not lie
RESTLESS = 5.0  # of the median window's sum of squares: of ten thousand windows of noise none reaches it
CLIPPED_SHARE = 0.8  # of a rest
NOISE_LEAST_M = 1e-7  # with less, a ball at rest has one reading wherever it rests
TURNS = 5.0  # of g, on the mean over three intervals
END_SHARE = 0.15  # of readings within 50 ms at the converter's end: the noise is cut off there, and its mean is not 0
NEAR_END = 6.0  # of the noise: so far from the end a reading may be one of those whose noise is cut off there
PILE_SAMPLES = 250  # as many readings near the end tell
PILE_SHARE = 0.04  # of them at the very end: noise that is not cut off has its lowest reading once in thousands
_LINE = np.arange(HELD_SAMPLES) - (HELD_SAMPLES - 1) / 2.0
_OPEN_LOOP = ("sawtooth", "prbs", "free")


@dataclass(frozen=True, slots=True, kw_only=True)
class Evidence:
    """What one use (fit or judge) of a campaign says."""

    records: tuple[Record, ...]
    series: Series
    t: FloatArray  # s, of each sample of the series, shape (n,)
    usages: tuple[Usage, ...]
    statics: tuple[LiftOff, ...]  # points of force balance that are not in the series
    low_m: float | None  # reading at the lower stop; None: not seen
    high_m: float | None
    notes: tuple[str, ...]

    def names(self) -> list[str]:
        """Of the recordings."""
        return [record.name for record in self.records]


def gather(records: Sequence[Record], plant: Plant, stops: tuple[float | None, float | None] | None = None) -> Evidence:
    """The series of these recordings.

    Args:
        records: of one use.
        plant: mass, travel, x_max.
        stops: readings at the stops where other recordings have shown them already.
    """
    given = tuple(records)
    rows = [bridged(record) for record in given]
    records = [record for record, _ in rows]
    held = [held_samples(record, plant) for record in records]
    notes: list[str] = []
    blind = _range_ends(records, held)
    noise_shows = _noise(records) > _count(records)
    seen = [still & ~np.isin(record.x, blind) for record, still in zip(records, held, strict=True)]
    low, high = _stops(records, seen, plant, notes) if stops is None else stops
    lifted = [_on_platform(record, still, low, plant) for record, still in zip(records, seen, strict=True)]
    if stops is None and any(lifted):
        # Wherever a ball ends that jumped off a platform, it is no stop of the other recordings.
        kept = [place for place, platform in enumerate(lifted) if not platform]
        low, high = _stops([records[place] for place in kept], [seen[place] for place in kept], plant, notes)
    parts: list[Series] = []
    times: list[FloatArray] = []
    usages: list[Usage] = []
    platform: list[Record] = []
    departures = [point.i_c_a for point in lift_offs(list(records), plant)]
    lifts_at = LIFTS_SHARE * min(departures) if departures else None
    for number, (record, still) in enumerate(zip(records, held, strict=True)):
        if record.kind == "equilibria":
            continue
        on_stop = _on(record, seen[number], low, high, plant)
        if lifted[number]:
            platform.append(record)
            on_stop = (on_stop[0] & False, on_stop[1] & False)
        flies = record.kind == "sawtooth" and not lifted[number]
        scale, shift = _rescaling(low, high, plant)
        told = replace(record, x=(record.x - shift) * scale, kind="prbs" if flies else record.kind)
        series, (usage,) = prepare([told], plant)
        usage.kind = record.kind
        usages.append(usage)
        if not len(series):
            continue
        flags, i, x, t = series.flags.copy(), series.i.copy(), series.x.copy(), np.zeros(len(series))
        n = len(record.t) if record.has("u_c", "i_c") and len(record.t) > 1 else 0
        x[:n] = np.where(np.isfinite(record.x), record.x, 0.0)
        t[:n] = np.where(np.isfinite(record.t), record.t, 0.0)
        if n:
            own = flags[:n]
            own[at_converter_end(record.i_c)] &= np.uint8(~USE_I & 0xFF)
            own[np.isin(record.x, blind)] &= np.uint8(~(FLIES | USE_X) & 0xFF)
            cut = at_converter_end(record.x) if noise_shows else np.zeros(n, np.bool_)
            own[bounces(record, plant)] &= np.uint8(~(FLIES | USE_X) & 0xFF)
            if told.kind in _OPEN_LOOP:
                _trim(own)
            own[still & (own & FLIES != 0)] &= np.uint8(~(FLIES | USE_X) & 0xFF)
            # One such sample had a score of 32 000 in K_c, any other at most 60: where the paper's model has the
            # coil too low it decided the fit, and the screen after it named anything.
            own[(plant.x_max_m - record.x < POLE_SHARE * plant.travel_m) & (own & FLIES != 0)] &= np.uint8(
                ~(FLIES | USE_X) & 0xFF
            )
            for mask, bit in zip(on_stop, (RESTS_LOW, RESTS_HIGH), strict=True):
                free = own & FLIES == 0
                own[mask & free & np.isfinite(record.x)] |= np.uint8(bit)
                own[mask & free & np.isfinite(record.x) & ~cut] |= np.uint8(USE_X)
            if not lifted[number]:
                own[_unseen(record, still, blind) & (own & FLIES == 0)] |= np.uint8(RESTS_UNSEEN)
            if told.kind in _OPEN_LOOP:
                # Between bounces nobody knows the speed, and with it what a moving ball does to the current.
                own[own & (FLIES | RESTS_LOW | RESTS_HIGH | RESTS_UNSEEN) == 0] &= np.uint8(~USE_I & 0xFF)
            mark(own, rows[number][1])
            for values in (x, i):
                between(values[:n], rows[number][1])
        if record.kind == "amplifier-step" and lifts_at is not None:
            _until_lifted(flags, series, lifts_at)
        parts.append(replace(series, flags=flags, i=i, x=x, recording=np.full(len(series), number, np.int32)))
        times.append(t)
    statics = [*equilibria(list(records), plant), *lift_offs(platform, plant)]
    return Evidence(
        records=given,
        series=_join(parts),
        t=np.concatenate(times) if times else np.empty(0),
        usages=tuple(usages),
        statics=tuple(statics),
        low_m=low,
        high_m=high,
        notes=tuple(notes),
    )


def _on_platform(record: Record, still: BoolArray, low: float | None, plant: Plant) -> bool:
    """Whether a sawtooth lifts the ball off something else than the lower stop."""
    return record.kind == "sawtooth" and not _on(record, still, low, None, plant)[0].any()


def _until_lifted(flags: np.ndarray[tuple[int], np.dtype[np.uint8]], series: Series, lifts_at: float) -> None:
    """Leave out what follows once a step of the amplifier has lifted the ball: nobody recorded how it moved."""
    chain = chains(series)
    for number in np.unique(chain):
        own = np.flatnonzero(chain == number)
        over = np.flatnonzero(series.i[own] > lifts_at)
        if len(over):
            gone = own[np.cumsum(series.step[own]) > series.step[own][: over[0] + 1].sum() + STAYS_S]
            flags[gone] &= np.uint8(~USE_I & 0xFF)


def _trim(flags: np.ndarray[tuple[int], np.dtype[np.uint8]]) -> None:
    """Take TRIM_SAMPLES off both ends of each flight between stops: a slow or late sensor sees the impact later."""
    for piece in runs(np.asarray(flags & FLIES != 0)):
        for part in (slice(piece.start, piece.start + TRIM_SAMPLES), slice(piece.stop - TRIM_SAMPLES, piece.stop)):
            flags[part] &= np.uint8(~(FLIES | USE_X) & 0xFF)


def bounces(record: Record, plant: Plant) -> BoolArray:
    """Where a ball that rose falls, sooner than its weight can turn it, shape (n,): it hit a stop.

    A slow or late sensor shows such a bounce anywhere below the stop, and four readings of one decided over 30 000.
    """
    x, T = record.x, record.interval_s
    hit = np.zeros(len(x), np.bool_)
    if len(x) < 5 or not T > 0.0:
        return hit
    before, after = (x[1:-3] - x[:-4]) / T, (x[4:] - x[3:-1]) / T
    least = TURNS * plant.gravity_m_s2 * 3.0 * T + 6.0 * 2.0 * noise_of(x[np.isfinite(x)]) / T
    even = np.convolve(np.abs(np.diff(record.t) - T) < 0.5 * T, np.ones(4), mode="valid") == 4.0
    hit[2:-2] = (before > 0.0) & (after < 0.0) & (before - after > least) & even
    return np.asarray(maximum_filter1d(hit.astype(np.uint8), 3) > 0)


def held_samples(record: Record, plant: Plant) -> BoolArray:
    """Where the ball is held by something, shape (n,): open loop, and x within its noise for 50 ms."""
    n = len(record.t)
    if record.kind not in _OPEN_LOOP or n < 2 * HELD_SAMPLES or not record.has("x"):
        return np.zeros(n, np.bool_)
    x = record.x
    known = np.isfinite(x)
    x = np.interp(np.arange(n), np.flatnonzero(known), x[known])
    spread = maximum_filter1d(x, HELD_SAMPLES) - minimum_filter1d(x, HELD_SAMPLES)
    least = max(noise_of(x), 1e-4 * plant.travel_m)
    core = spread <= HELD_SCALES * least
    held = maximum_filter1d(core.astype(np.uint8), HELD_SAMPLES) > 0  # a window that is still is still at its ends
    follows_reference = np.abs(x - record.x_ref) < 0.03 * plant.travel_m  # NaN compares False
    if record.kind == "free" and record.has("x_ref") and np.mean(follows_reference) > 0.5:
        held[:] = False
    return np.asarray(held & known)


def at_converter_end(values: FloatArray) -> BoolArray:
    """Where readings stand at the lowest or highest value of the record so often that noise must be cut off there.

    Where the level at rest is some noise away from the end, 50 ms show too little of it: then among the readings near
    the end.
    """
    cut = np.zeros(len(values), np.bool_)
    if len(values) < HELD_SAMPLES or not np.isfinite(values).any():
        return cut
    reach = NEAR_END * noise_of(values[np.isfinite(values)])
    for end in (np.nanmin(values), np.nanmax(values)):
        at_end = (values == end).astype(float)
        cut |= uniform_filter1d(at_end, HELD_SAMPLES) > END_SHARE
        near = np.flatnonzero(np.abs(values - end) <= reach)
        if len(near) >= PILE_SAMPLES:
            cut[near] |= uniform_filter1d(at_end[near], PILE_SAMPLES) > PILE_SHARE
    return cut


def noise_of(x: FloatArray) -> float:
    """Standard deviation of white noise on a smooth signal, from its third difference."""
    if len(x) < 8:
        return 0.0
    third = np.diff(x, 3)
    return float(1.4826 * np.median(np.abs(third - np.median(third))) / np.sqrt(20.0))


def _stops(
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


def _range_ends(records: Sequence[Record], held: Sequence[BoolArray]) -> list[float]:
    """Readings beyond which the position sensor shows nothing: a ball at rest there reads that one, without noise."""
    if _noise(records) < NOISE_LEAST_M:
        return []
    found = set()
    for record, still in zip(records, held, strict=True):
        for piece in runs(still, HELD_SAMPLES):
            ends = float(np.nanmin(record.x)), float(np.nanmax(record.x))
            found |= {end for end in ends if np.mean(record.x[piece] == end) > CLIPPED_SHARE}
    return sorted(found)


def _unseen(record: Record, still: BoolArray, blind: Sequence[float]) -> BoolArray:
    """Where the ball is held beyond the range of its sensor, shape (n,): i_c says there what it says at any rest."""
    mask = np.zeros(len(record.t), np.bool_)
    beyond = np.isin(record.x, blind)
    for piece in runs(still, HELD_SAMPLES):
        if np.mean(beyond[piece]) > CLIPPED_SHARE:
            mask[piece.start + EDGE_SAMPLES : piece.stop - EDGE_SAMPLES] = True
    return mask


def _noise(records: Sequence[Record]) -> float:
    """Noise of position readings between the ends of their recording, m: the least that one of them shows."""
    found = []
    for x in (record.x[np.isfinite(record.x)] for record in records):
        between = x[(x != x.min()) & (x != x.max())] if len(x) else x
        found += [noise_of(between)] if len(between) >= HELD_SAMPLES else []
    return min(found, default=0.0)


def _count(records: Sequence[Record]) -> float:
    """Step of the position converter, m: the smallest between two readings; 0 without two."""
    found = []
    for record in records:
        steps = np.diff(np.unique(record.x[np.isfinite(record.x)]))
        found += [float(steps.min())] if len(steps) else []
    return min(found, default=0.0)


def _on(
    record: Record, still: BoolArray, low: float | None, high: float | None, plant: Plant
) -> tuple[BoolArray, BoolArray]:
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
    line = np.polynomial.Polynomial.fit(i_c[known], x[known], 1 if np.ptp(i_c[known]) > 0.0 else 0)
    off = [abs(float(np.nanmedian(record.x[piece] - line(record.i_c[piece])))) for piece in pieces]
    return [piece for piece, by in zip(pieces, off, strict=True) if not by > HOVERS_SHARE * plant.travel_m]


def _rescaling(low: float | None, high: float | None, plant: Plant) -> tuple[float, float]:
    """(scale, shift) that put the readings at the stops to 0 and the travel: contact is looked for there."""
    if low is not None and high is not None:
        return plant.travel_m / (high - low), low
    if low is not None:
        return 1.0, low
    return 1.0, 0.0 if high is None else high - plant.travel_m


def _join(parts: list[Series]) -> Series:
    if not parts:
        nothing = np.empty(0)
        return Series(
            step=nothing,
            u=nothing,
            i=nothing,
            x=nothing,
            flags=np.empty(0, np.uint8),
            recording=np.empty(0, np.int32),
        )
    return Series(**{name: np.concatenate([getattr(part, name) for part in parts]) for name in Series.__slots__})


def sensor_noise(evidence: Evidence) -> tuple[float | None, float | None]:
    """Standard deviations (i_c in A, x in m) at rest, where no model is needed; None where nothing rested for long."""
    squares = _rest_squares(evidence)
    result = [float(np.sqrt(total / count)) if count > 300 and total > 0 else None for total, count in squares]
    if None in result:
        clamped = _clamped_noise(evidence)
        result = [here if here is not None else other for here, other in zip(result, clamped, strict=True)]
    return result[0], result[1]


def noise_error(evidence: Evidence) -> float:
    """Standard error of ln sigma, averaged over both channels: sqrt(1 / 2n) each."""
    counts = [count for _, count in _rest_squares(evidence) if count > 300]
    return 0.5 * float(np.sqrt(sum(0.5 / count for count in counts)))


def _rest_squares(evidence: Evidence) -> list[tuple[float, int]]:
    """Sum of squares around straight lines at rest, and its degrees of freedom: i_c, x.

    A window far noisier than the others is none of rest: a current that still settles when u_c stands, a touched rig.
    """
    series = evidence.series
    rest = series.flags & (RESTS_LOW | RESTS_HIGH | RESTS_UNSEEN) != 0
    squares: tuple[list[float], list[float]] = ([], [])
    for piece in runs(rest, 2 * HELD_SAMPLES):
        for start in range(piece.start, piece.stop - HELD_SAMPLES + 1, HELD_SAMPLES):
            window = slice(start, start + HELD_SAMPLES)
            uses = series.flags[window]
            usable = ((uses & USE_I != 0).all() and np.ptp(series.u[window]) == 0.0, (uses & USE_X != 0).all())
            for place, values in ((0, series.i[window]), (1, series.x[window])):
                if not usable[place]:
                    continue
                line = np.polynomial.polynomial.polyfit(_LINE, values, 1)
                residual = values - np.polynomial.polynomial.polyval(_LINE, line)
                squares[place].append(float(residual @ residual))
    result = []
    for channel in squares:
        middle = float(np.median(channel)) if channel else 0.0
        usual = [one for one in channel if one <= RESTLESS * middle] if middle > 0.0 else channel
        result.append((sum(usual), len(usual) * (HELD_SAMPLES - 2)))
    return result


def _clamped_noise(evidence: Evidence) -> tuple[float | None, float | None]:
    """As `sensor_noise`, from a clamped ball at the heights that are flown: some sensors' noise grows with the gap."""
    series = evidence.series
    flown = series.x[series.flags & FLIES != 0]
    amplifier_only = not any(record.has("x") for record in evidence.records)
    if not len(flown) and not amplifier_only:
        return None, None
    low, high = np.quantile(flown, (0.01, 0.99)) if len(flown) else (np.inf, -np.inf)
    needed = ("u_c", "i_c") if amplifier_only else ("u_c", "i_c", "x")
    found: list[list[float]] = [[], []]
    for record in evidence.records:
        if record.kind != "amplifier-step" or not record.has(*needed):
            continue
        for start in range(HELD_SAMPLES, len(record.t) - HELD_SAMPLES + 1, HELD_SAMPLES):
            window, settled = slice(start, start + HELD_SAMPLES), slice(start - HELD_SAMPLES, start + HELD_SAMPLES)
            if np.ptp(record.u_c[settled]) != 0.0 or at_converter_end(record.i_c[window]).any():
                continue
            x = record.x[window]
            for place, values in ((0, record.i_c[window]), (1, x if low <= float(np.median(x)) <= high else x[:0])):
                if len(values) and np.isfinite(values).all():
                    line = np.polynomial.polynomial.polyfit(_LINE, values, 1)
                    residual = values - np.polynomial.polynomial.polyval(_LINE, line)
                    found[place].append(float(residual @ residual) / (HELD_SAMPLES - 2))
    result = [float(np.sqrt(np.mean(ones))) if len(ones) * HELD_SAMPLES > 300 else None for ones in found]
    return result[0], result[1]


def flying_share(series: Series) -> float:
    """Samples in flight over all."""
    return float(np.mean(series.flags & FLIES != 0)) if len(series) else 0.0


def chains(series: Series) -> FloatArray:
    """The number of the unbroken chain that each sample belongs to, shape (n,)."""
    return np.cumsum(series.flags & FOLLOWS == 0)
