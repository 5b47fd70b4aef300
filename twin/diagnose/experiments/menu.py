"""The experiments of `board51 campaign run`, with the commands of each for this rig.

Names, shares and times are those of the campaign's menu (tests/twin/diagnose/experiments/test_design.py compares the
two); inputs are shares of the lift-off input, positions shares of the travel.

Rule 1: the simulation is shorter than the experiment: a periodic signal is simulated for a few periods, and its
        information is multiplied.
Rule 2: between two holds the reference moves at SLEW_M_S, as on the board.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np

from protocol.campaign import Kind
from twin.diagnose.experiments.virtual_recordings import Schedule
from twin.estimation.record import FloatArray

Shape = Literal["rectangle", "sawtooth", "prbs", "multisine", "chirp"]

SLEW_M_S = 20e-3  # the emulated board's, protocol/README.md
_PLAYED_S = 4.0  # simulated time of a signal, or one period if that is longer
_HELD_S = 1.0  # simulated time of a hold: 80 time constants of the unstable pole
_HARMONICS = range(1, 9)


@dataclass(frozen=True, slots=True, kw_only=True)
class Level:
    """A constant value."""

    value: float  # share
    duration_s: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Wave:
    """A test signal between two values."""

    shape: Shape
    low: float  # share
    high: float
    period_s: float  # for a prbs: of its clock; for a chirp: at its start
    duration_s: float
    period_end_s: float = 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Item:
    """One experiment."""

    name: str
    kind: Kind
    what: str  # instruction for the user; {low} and {high} are the range, {duration} the time
    parts: tuple[Level | Wave, ...]
    bursts: tuple[tuple[float, float], ...] = ()  # 25 kHz captures: u_c from, to; shares
    clamped: bool = False
    warms: bool = False  # useful for causes with heating only
    passes: bool = True  # whether the simulation may be shortened

    @property
    def closed_loop(self) -> bool:
        """Whether the parts are values of the reference."""
        return self.kind == "closed-loop"

    @property
    def duration_s(self) -> float:
        """Duration without the captures, s."""
        return sum(part.duration_s for part in self.parts)


def _fly(*parts: Level | Wave, x: float = 0.5) -> tuple[Level | Wave, ...]:
    return (Level(value=x, duration_s=0.3), *parts)


def _levels(*values: float, each_s: float) -> tuple[Level, ...]:
    return tuple(Level(value=value, duration_s=each_s) for value in values)


_SAME_STEPS = Wave(shape="rectangle", low=0.42, high=0.58, period_s=1.0, duration_s=4.0)

MENU: tuple[Item, ...] = (
    Item(
        name="lift-off", kind="sawtooth",
        what="raise u_c slowly from 0 to {high} until the ball leaves its rest, several times",
        parts=(Wave(shape="sawtooth", low=0.0, high=1.1, period_s=3.0, duration_s=10.0),),
    ),
    Item(
        name="rest", kind="amplifier-step",
        what="record the ball at rest with the coil off and at two constant inputs up to {high}",
        parts=(Level(value=0.0, duration_s=1.5), *_levels(0.3, 0.6, each_s=1.5)),
    ),
    Item(
        name="amplifier-steps", kind="amplifier-step", parts=(),
        what="step u_c between {low} and {high}, the ball at rest, and capture i_c at 25 kHz",
        bursts=((0.0, 0.1), (0.1, 0.35), (0.35, 0.6), (0.6, 0.85), (0.85, 0.35), (0.6, 0.35), (0.1, 0.85), (0.35, 0.1)),
    ),
    Item(
        name="prbs-open-loop", kind="prbs",
        what="let a random u_c between {low} and {high} throw the ball from stop to stop for {duration}",
        parts=(Wave(shape="prbs", low=0.05, high=1.2, period_s=0.02, duration_s=8.0),),
    ),
    Item(
        name="steps", kind="closed-loop",
        what="step the reference between {low} and {high} for {duration}",
        parts=_fly(Wave(shape="rectangle", low=0.42, high=0.58, period_s=1.0, duration_s=8.0)),
    ),
    Item(
        name="wide-steps", kind="closed-loop",
        what="step the reference over half the travel, between {low} and {high}, for {duration}",
        parts=_fly(Wave(shape="rectangle", low=0.27, high=0.73, period_s=1.4, duration_s=8.4)),
    ),
    Item(
        name="multisine", kind="closed-loop",
        what="let the reference follow eight sines at once between {low} and {high} for {duration}",
        parts=_fly(Wave(shape="multisine", low=0.35, high=0.65, period_s=2.0, duration_s=10.0)),
    ),
    Item(
        name="prbs-reference", kind="closed-loop",
        what="let the reference jump at random between {low} and {high} for {duration}",
        parts=_fly(Wave(shape="prbs", low=0.42, high=0.58, period_s=0.08, duration_s=8.0)),
    ),
    Item(
        name="chirp", kind="closed-loop",
        what="let the reference swing between {low} and {high}, from 0.5 Hz up to 10 Hz in {duration}",
        parts=_fly(Wave(shape="chirp", low=0.47, high=0.53, period_s=2.0, period_end_s=0.1, duration_s=15.0)),
    ),
    Item(
        name="holds", kind="closed-loop",
        what="hold the ball for 2.5 s at each of seven heights from {low} to {high}",
        parts=_levels(0.1, 0.22, 0.35, 0.48, 0.61, 0.74, 0.87, each_s=2.5),
    ),
    Item(
        name="slow-ramp", kind="closed-loop",
        what="raise the reference slowly from {low} to {high}, two times in {duration}",
        parts=_fly(Wave(shape="sawtooth", low=0.28, high=0.72, period_s=10.0, duration_s=20.0)),
    ),
    Item(
        name="warm-run", kind="closed-loop", warms=True, passes=False,
        what="step the reference, hold the ball at {low} for a minute so that the coil warms up, step again",
        parts=_fly(_SAME_STEPS, Level(value=0.1, duration_s=60.0), Level(value=0.5, duration_s=0.5), _SAME_STEPS),
    ),
    Item(
        name="blocked-ball", kind="amplifier-step", clamped=True,
        what="clamp the ball (a shim between ball and coil housing) and step u_c between {low} and {high}",
        parts=_levels(0.2, 0.6, 1.1, 0.8, 0.4, each_s=1.0), bursts=((0.1, 1.1), (1.1, 0.5), (0.5, 0.1)),
    ),
)  # fmt: skip


def schedule_of(item: Item, *, lift_off_v: float, travel_m: float, tick_s: float) -> tuple[Schedule, float]:
    """(the simulated commands, duration of the experiment over that of the simulation).

    Args:
        item: of the menu.
        lift_off_v: lift-off input, the unit of inputs, V.
        travel_m: travel, the unit of positions, m.
        tick_s: T_s, s.
    """
    unit = travel_m if item.closed_loop else lift_off_v
    played = [_shortened(part) if item.passes else part for part in item.parts]
    pieces: list[FloatArray] = []
    for part in played:
        values = _values(part, tick_s) * unit
        if item.closed_loop and isinstance(part, Level) and pieces:
            values = _approached(float(pieces[-1][-1]), values, SLEW_M_S * tick_s)
        pieces.append(values)
    schedule = Schedule(
        name=item.name,
        kind=item.kind,
        command=np.concatenate(pieces) if pieces else np.empty(0),
        closed_loop=item.closed_loop,
        clamped_m=0.0 if item.clamped else None,
        bursts=tuple((u_from * unit, u_to * unit) for u_from, u_to in item.bursts),
    )
    shorter = sum(part.duration_s for part in played)
    return schedule, item.duration_s / shorter if shorter > 0.0 else 1.0


def sentence(item: Item, *, lift_off_v: float, travel_m: float) -> str:
    """The instruction for the user, with the values for this rig; arguments as in `schedule_of`."""
    values = [value for pair in item.bursts for value in pair]
    for part in item.parts:
        values += [part.value] if isinstance(part, Level) else [part.low, part.high]
    scale, unit = (1e3 * travel_m, "mm") if item.closed_loop else (lift_off_v, "V")
    low, high = (f"{end * scale:.2g} {unit}" for end in (min(values), max(values)))
    return item.what.format(low=low, high=high, duration=f"{item.duration_s:.0f} s")


def _shortened(part: Level | Wave) -> Level | Wave:
    if isinstance(part, Level):
        return Level(value=part.value, duration_s=min(part.duration_s, _HELD_S))
    return Wave(
        shape=part.shape,
        low=part.low,
        high=part.high,
        period_s=part.period_s,
        duration_s=min(part.duration_s, max(_PLAYED_S, part.period_s) if part.shape != "sawtooth" else part.period_s),
        period_end_s=part.period_end_s,
    )


def _values(part: Level | Wave, tick_s: float) -> FloatArray:
    n = round(part.duration_s / tick_s)
    if isinstance(part, Level):
        return np.full(n, part.value)
    t = tick_s * np.arange(n, dtype=np.float64)
    middle, half = 0.5 * (part.low + part.high), 0.5 * (part.high - part.low)
    turns = t / part.period_s
    match part.shape:
        case "rectangle":
            wave = np.where(turns % 1.0 < 0.5, 1.0, -1.0)
        case "sawtooth":
            wave = 2.0 * (turns % 1.0) - 1.0
        case "prbs":
            chips = np.random.default_rng(1).integers(0, 2, int(turns[-1]) + 1) if n else np.empty(0, np.int64)
            wave = 2.0 * chips[turns.astype(int)] - 1.0
        case "multisine":
            wave = sum((np.sin(2.0 * math.pi * (h * turns - h * (h - 1) / 16.0)) for h in _HARMONICS), np.zeros(n))
            wave /= np.max(np.abs(wave))
        case "chirp":
            rate = 1.0 / part.period_s + (1.0 / part.period_end_s - 1.0 / part.period_s) * t / (2.0 * part.duration_s)
            wave = np.sin(2.0 * math.pi * rate * t)
    return np.asarray(middle + half * wave)


def _approached(start: float, values: FloatArray, most: float) -> FloatArray:
    """The constant `values`, approached from `start` in steps of at most `most`."""
    way = np.sign(values[0] - start) * most * np.arange(1, len(values) + 1) + start
    return np.asarray(np.minimum(way, values) if values[0] > start else np.maximum(way, values))
