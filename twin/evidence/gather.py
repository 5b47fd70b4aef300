"""A campaign as one series of flagged samples, including the ball at rest at the stops.

Rule 1: positions at which the ball was held are stops only if all recordings agree on them.  A ball on a platform, at
        another height each time, gives lift-off currents (8) only.
Rule 2: the series has either the recordings for fitting or those for judging, never both.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from protocol.campaign import Plant
from twin.estimation.contact import (
    OPEN_LOOP,
    at_converter_end,
    bounces,
    converter_step,
    held_samples,
    min_noise,
    on_stops,
    outside_range,
    range_ends,
    stop_readings,
)
from twin.estimation.innovations import FLIES, FOLLOWS, RESTS_HIGH, RESTS_LOW, RESTS_UNSEEN, USE_I, USE_X, Series
from twin.estimation.prepare import Usage, prepare
from twin.estimation.record import BoolArray, FloatArray, Record, runs
from twin.estimation.structures import EQUAL_NOISE, Samples
from twin.evidence.lost_rows import bridged, mark
from twin.evidence.noise_levels import Noise
from twin.evidence.starting.liftoff import LiftOff, equilibria, lift_offs
from twin.settings import diagnosis as settings


@dataclass(frozen=True, slots=True, kw_only=True)
class Evidence:
    """The prepared recordings of one use (fit or judge) of a campaign."""

    series: Series
    t: FloatArray  # s, of each sample of the series, shape (n,)
    records: tuple[Record, ...] = ()
    usages: tuple[Usage, ...] = ()
    statics: tuple[LiftOff, ...] = ()  # points of force balance that are not in the series
    low_m: float | None = None  # reading at the lower stop; None: unknown
    high_m: float | None = None  # reading at the upper stop; None: unknown
    notes: tuple[str, ...] = ()
    noise: Noise | None = None  # noise levels of the instruments, if they differ
    noise_ratio: FloatArray = field(default_factory=lambda: EQUAL_NOISE)  # as in `Samples`

    @property
    def samples(self) -> Samples:
        """The series in the form of the filter."""
        s = self.series
        return Samples(self.t, s.step, s.u, s.i, s.x, s.flags, self.noise_ratio)

    def names(self) -> list[str]:
        """Return the names of the recordings."""
        return [record.name for record in self.records]


def gather(records: Sequence[Record], plant: Plant, stops: tuple[float | None, float | None] | None = None) -> Evidence:
    """Prepare the recordings of one use.

    `stops` are the readings at the lower and the upper stop if they are known from other recordings, m.
    """
    every_record = tuple(records)
    rows = [bridged(record) for record in every_record]
    records = [record for record, _ in rows]
    held = [held_samples(record, plant) for record in records]
    notes: list[str] = []
    # In this order: what is held does not need the stops, the stops need what is held, and platforms need the stops.
    blind = range_ends(records, held)
    noise_shows = min_noise(records) > converter_step(records)
    visible = [is_held & ~np.isin(record.x, blind) for record, is_held in zip(records, held, strict=True)]
    low, high = stop_readings(records, visible, plant, notes) if stops is None else stops
    lifted = [_on_platform(record, is_held, low, blind, plant) for record, is_held in zip(records, held, strict=True)]
    if stops is None and any(lifted):
        # The resting places of a ball that was lifted off a platform are not stops of the other recordings.
        retained = [index for index, platform in enumerate(lifted) if not platform]
        low, high = stop_readings(
            [records[index] for index in retained], [visible[index] for index in retained], plant, notes
        )
    departures = [point.i_c_a for point in lift_offs(list(records), plant)]
    common = _Common(
        plant=plant,
        low_m=low,
        high_m=high,
        blind_m=blind,
        noise_shows=noise_shows,
        lifts_at_a=settings.LIFTS_SHARE * min(departures) if departures else None,
    )
    parts: list[Series] = []
    times: list[FloatArray] = []
    usages: list[Usage] = []
    for number, (record, lost) in enumerate(rows):
        if record.kind == "equilibria":
            continue
        series, t, usage = _prepared(record, lost, held[number], lifted[number], common)
        usages.append(usage)
        if len(series):
            parts.append(replace(series, recording=np.full(len(series), number, np.int32)))
            times.append(t)
    platform = [record for record, is_lifted in zip(records, lifted, strict=True) if is_lifted]
    statics = [*equilibria(list(records), plant), *lift_offs(platform, plant)]
    return Evidence(
        records=every_record,
        series=Series.joined(parts),
        t=np.concatenate(times) if times else np.empty(0),
        usages=tuple(usages),
        statics=tuple(statics),
        low_m=low,
        high_m=high,
        notes=tuple(notes),
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class _Common:
    """The findings on which all recordings agree."""

    plant: Plant
    low_m: float | None  # readings at the stops
    high_m: float | None
    blind_m: list[float]  # readings at the ends of the sensor's range
    noise_shows: bool  # whether the noise of x is larger than a step of its converter
    lifts_at_a: float | None  # i_c from which the ball may rise


def _prepared(
    record: Record, lost: BoolArray, is_held: BoolArray, is_lifted: bool, common: _Common
) -> tuple[Series, FloatArray, Usage]:
    """Return (the flagged samples of a recording with bridged rows, their times, how they are used).

    `lost` and `is_held`, shape (n,), say which of its rows were lost and which have the ball held.  `is_lifted`: off a
    platform.
    """
    plant, low, high = common.plant, common.low_m, common.high_m
    on_stop = on_stops(record, is_held & ~np.isin(record.x, common.blind_m), low, high, plant)
    if is_lifted:
        on_stop = (on_stop[0] & False, on_stop[1] & False)
    flies = record.kind == "sawtooth" and not is_lifted
    scale, shift = _rescaling(low, high, plant)
    rescaled = replace(record, x=(record.x - shift) * scale, kind="prbs" if flies else record.kind)
    # `prepare` finds contacts by the nominal travel.  Rescaled readings show it the stops there, and the original
    # readings go into the series: a scale must stay for the causes to explain.
    series, (usage,) = prepare([rescaled], plant)
    usage.kind = record.kind
    flags, x, t = series.flags.copy(), series.x.copy(), np.zeros(len(series))
    n = len(record.t) if len(series) and record.has("u_c", "i_c") and len(record.t) > 1 else 0
    if n:
        x[:n] = np.where(np.isfinite(record.x), record.x, 0.0)
        t[:n] = np.where(np.isfinite(record.t), record.t, 0.0)
        cut = at_converter_end(record.x) if common.noise_shows else np.zeros(n, np.bool_)
        row_flags = flags[:n]
        _flag(row_flags, record, rescaled.kind, is_held, common.blind_m, plant)
        _flag_rest(row_flags, record, on_stop, cut)
        if not is_lifted:
            unseen = outside_range(record, is_held, common.blind_m)
            row_flags[unseen & (row_flags & FLIES == 0)] |= np.uint16(RESTS_UNSEEN)
        if rescaled.kind in OPEN_LOOP:
            # Between bounces the speed is unknown, and so is its effect on the current.
            row_flags[row_flags & (FLIES | RESTS_LOW | RESTS_HIGH | RESTS_UNSEEN) == 0] &= np.uint16(~USE_I & 0xFFFF)
        mark(row_flags, record.u_c, lost)
    if record.kind == "amplifier-step" and common.lifts_at_a is not None:
        _until_lifted(flags, series, common.lifts_at_a)
    return replace(series, flags=flags, x=x), t, usage


def _flag(
    flags: NDArray[np.uint16], record: Record, kind: str, is_held: BoolArray, blind: list[float], plant: Plant
) -> None:
    """Clear the flags of readings that are not used, in place; `flags`: of the samples of `record`, shape (n,)."""
    no_flight = np.uint16(~(FLIES | USE_X) & 0xFFFF)
    flags[at_converter_end(record.i_c)] &= np.uint16(~USE_I & 0xFFFF)
    flags[np.isin(record.x, blind)] &= no_flight
    flags[bounces(record, plant)] &= no_flight
    if kind in OPEN_LOOP:
        _trim(flags)
    flags[is_held & (flags & FLIES != 0)] &= no_flight
    # If the paper's model has the coil too low, a single sample near the pole has a score of 32 000 in K_c (others at
    # most 60); it dominates the fit and makes the score tests meaningless.
    flags[(plant.x_max_m - record.x < settings.POLE_SHARE * plant.travel_m) & (flags & FLIES != 0)] &= no_flight


def _flag_rest(flags: NDArray[np.uint16], record: Record, on_stop: tuple[BoolArray, BoolArray], cut: BoolArray) -> None:
    """Set the flags of readings at a stop, in place; `cut`: where the converter's end cuts off the noise of x."""
    for mask, bit in zip(on_stop, (RESTS_LOW, RESTS_HIGH), strict=True):
        rests = mask & (flags & FLIES == 0) & np.isfinite(record.x)
        flags[rests] |= np.uint16(bit)
        flags[rests & ~cut] |= np.uint16(USE_X)


def _on_platform(record: Record, is_held: BoolArray, low: float | None, blind: list[float], plant: Plant) -> bool:
    """Tell whether a sawtooth lifts the ball off a platform and not off the lower stop.

    A ball that rests below the range of its sensor (`blind`) is at the stop.
    """
    below = np.isin(record.x, [end for end in blind if end < 0.5 * plant.travel_m])
    at_stop = on_stops(record, is_held & ~np.isin(record.x, blind), low, None, plant)[0] | (is_held & below)
    return record.kind == "sawtooth" and not at_stop.any()


def _until_lifted(flags: NDArray[np.uint16], series: Series, lifts_at: float) -> None:
    """Leave out i_c after a step of the amplifier has lifted the ball, as its motion is unknown."""
    chain = chains(series)
    for number in np.unique(chain):
        in_chain = np.flatnonzero(chain == number)
        # By the current, as a step of the amplifier need not have x.  What follows would count the ball's motion as an
        # error of (1).
        over = np.flatnonzero(series.i[in_chain] > lifts_at)
        if len(over):
            after_lift = in_chain[
                np.cumsum(series.step[in_chain]) > series.step[in_chain][: over[0] + 1].sum() + settings.STAYS_S
            ]
            flags[after_lift] &= np.uint16(~USE_I & 0xFFFF)


def _trim(flags: NDArray[np.uint16]) -> None:
    """Take TRIM_SAMPLES off both ends of each flight between stops, as a lagging sensor shows the impact later."""
    for piece in runs(np.asarray(flags & FLIES != 0)):
        # A fixed number, not the lag of the model: all models must be judged by the same samples.
        begin, end = piece.start + settings.TRIM_SAMPLES, piece.stop - settings.TRIM_SAMPLES
        for part in (slice(piece.start, begin), slice(end, piece.stop)):
            flags[part] &= np.uint16(~(FLIES | USE_X) & 0xFFFF)


def _rescaling(low: float | None, high: float | None, plant: Plant) -> tuple[float, float]:
    """Return (scale, shift) that map the readings at the stops to 0 and the travel, for the search for contact."""
    # By both stops where both are known.  With one of them the scale is taken for right, and only the offset is
    # removed.
    if low is not None and high is not None:
        return plant.travel_m / (high - low), low
    if low is not None:
        return 1.0, low
    return 1.0, 0.0 if high is None else high - plant.travel_m


def chains(series: Series) -> FloatArray:
    """Return the number of the unbroken chain of each sample, shape (n,)."""
    return np.cumsum(series.flags & FOLLOWS == 0)
