"""Virtual recordings: simulations of the extended model under the board's law, with its noise and converters.

    simulate(rig, schedule, seed=1)        a new experiment
    resimulate(rig, records, seed=1)       the experiments of a campaign again

Rule 1: a repeated experiment uses the recorded commands only (x_ref in closed loop, otherwise u_c) and the state of the
        first samples.
Rule 2: the result is determined by the seed; the noise of a recording depends on its place in the list, and not on the
        lengths of the others.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from protocol.campaign import Kind, Plant
from twin.control import LawNumbers, law
from twin.diagnosis.experiments.closed_loop import Course, Rig, converters_of, run, twelve_bits
from twin.diagnosis.experiments.designed_law import law_of
from twin.estimation.record import Capture, FloatArray, Record, intervals
from twin.evidence import sample_loss
from twin.inference.theta import Theta
from twin.model.equilibrium import at_rest, holding_current, steady_current
from twin.model.extended import (
    I_C,
    RATE,
    SENSOR,
    STATES,
    WARMTH,
    V,
    X,
    current_of_reading,
    current_reading,
    lasting_warmth,
    position_of_reading,
    position_reading,
    settle_current,
)

PLATFORM_SHARE = 0.06  # of the travel: a ball that begins a ramp higher rests on a support
BRIDGING_S = 0.2  # shorter gaps are simulated; after a longer gap the state is taken from the recording
CAPTURE_S, CAPTURE_PRE, CAPTURE_COUNT = 40e-6, 100, 1000
STATIC_ERROR = 0.003  # relative error of a steady current that was written down by hand
_HEAD = 8  # samples that give the initial state of a piece
_LIMIT_SAMPLES = 5  # equal largest inputs in a row that show a limit
_LIMIT_OVER = 1.1  # the limit over the median of u_c, at least


@dataclass(frozen=True, slots=True, kw_only=True)
class Schedule:
    """The commands of one recording, tick by tick."""

    name: str
    kind: Kind
    command: FloatArray  # x_ref in m if closed_loop, otherwise u_c in V; shape (n_ticks,)
    closed_loop: bool = False
    clamped_m: float | None = None  # position at which the ball is held
    bursts: tuple[tuple[float, float], ...] = ()  # 25 kHz captures: u_c from, to; V


def simulate(rig: Rig, schedule: Schedule, *, seed: int) -> list[Record]:
    """Simulate an experiment; the list has one recording for fitting.

    Args:
        rig: the rig and its board.
        schedule: the commands.
        seed: of the noise, and of lost samples.
    """
    rng = np.random.default_rng([seed, 0])
    theta, plant = rig.theta, rig.plant
    steps = twelve_bits(theta, plant) if rig.converters is None else rig.converters
    rig = replace(rig, converters=steps)
    command, clamped = schedule.command, schedule.clamped_m
    captures = tuple(_capture(rig, u_from, u_to, rng, clamped_m=clamped) for u_from, u_to in schedule.bursts)
    n = len(command)
    t = rig.tick_s * np.arange(n, dtype=np.float64)
    out = np.empty((n, 4))
    if n:
        first = float(command[0])
        y, s, numbers = np.zeros(STATES), 0.0, None
        if schedule.closed_loop:
            numbers = law_of(rig.controller, theta, plant, rig.tick_s, rig.u_max_v)
            y, u = at_rest(theta.base(plant), theta.vector(), first, as_reading=True)
            s = integral_at(numbers, theta, y, first, u)
        else:
            y[X] = theta.stop_low_m if clamped is None else clamped
            settle_current(theta.vector(), y, steady_current(theta.base(plant), theta.vector(), first))
        course = Course(t=t, command=command, law=numbers, clamped=clamped is not None)
        out = run(rig, course, y, rng, s=s)
    is_received = rng.random(n) >= theta.vector()[sample_loss.CAUSE.strength.index]
    x_ref = command if schedule.closed_loop else np.full(n, np.nan)
    return [
        Record(
            name=schedule.name,
            kind=schedule.kind,
            use="fit",
            t=t[is_received],
            u_c=out[is_received, 0],
            i_c=out[is_received, 1],
            x=out[is_received, 2],
            x_ref=x_ref[is_received],
            captures=captures,
            lsb=(steps.i_lsb_a, steps.x_lsb_m),
        )
    ]


def resimulate(rig: Rig, records: Sequence[Record], *, seed: int) -> list[Record]:
    """Simulate recordings again with another rig; same samples, and missing channels stay missing.

    Args:
        rig: the rig; its converters and the limit of u_c are those of the recordings.
        records: the recordings to repeat.
        seed: of the noise.
    """
    rig = replace(rig, converters=converters_of(records))
    return [_again(rig, record, np.random.default_rng([seed, number])) for number, record in enumerate(records)]


def _again(rig: Rig, record: Record, rng: np.random.Generator) -> Record:
    theta, plant = rig.theta, rig.plant
    if record.kind == "equilibria":
        return _steady(theta, plant, record, rng)
    captures = tuple(_capture(rig, old.u_from_v, old.u_to_v, rng, like=old) for old in record.captures)
    if len(record.t) < 2 or not record.has("u_c", "i_c"):
        return replace(record, captures=captures)
    clamped = record.kind == "amplifier-step"
    closed_loop = record.kind == "closed-loop" and record.has("x", "x_ref")
    i_c, x = np.full(len(record.t), np.nan), np.full(len(record.t), np.nan)
    u_c = record.u_c.copy()
    for piece in _pieces(record):
        grid = _bridged(record.t[piece])
        rows = np.searchsorted(grid, record.t[piece] - 1e-9)
        source = record.x_ref if closed_loop else record.u_c
        command = _held(source[piece], rows, len(grid))
        y, speed = _start(theta, plant, record, piece, clamped)
        numbers, s = None, 0.0
        if closed_loop:
            numbers = law_of(rig.controller, theta, plant, record.interval_s, input_limit(record))
            s = _recorded_integral(numbers, record, piece)
        floor = float(y[X]) if record.kind == "sawtooth" and y[X] > PLATFORM_SHARE * plant.travel_m else None
        course = Course(t=grid, command=command, law=numbers, clamped=clamped, floor_m=floor)
        out = run(rig, course, y, rng, s=s, speed=speed)
        i_c[piece], x[piece] = out[rows, 1], out[rows, 2]
        if closed_loop:
            u_c[piece] = out[rows, 0]
    return replace(
        record,
        u_c=u_c,
        i_c=np.where(np.isfinite(record.i_c), i_c, np.nan),
        x=np.where(np.isfinite(record.x), x, np.nan),
        captures=captures,
    )


def _capture(
    rig: Rig,
    u_from: float,
    u_to: float,
    rng: np.random.Generator,
    *,
    clamped_m: float | None = None,
    like: Capture | None = None,
) -> Capture:
    """Simulate one 25 kHz capture of a step with the ball at rest and i_c settled before it."""
    sample_s, pre, count = CAPTURE_S, CAPTURE_PRE, CAPTURE_COUNT
    if like is not None:
        sample_s, pre, count = like.sample_time_s, like.step_index, len(like.i_c_a)
    n = np.arange(count, dtype=np.float64)
    y = np.zeros(STATES)
    y[X] = rig.theta.stop_low_m if clamped_m is None else clamped_m
    settle_current(rig.theta.vector(), y, steady_current(rig.theta.base(rig.plant), rig.theta.vector(), u_from))
    course = Course(t=sample_s * n, command=np.where(n < pre, u_from, u_to), clamped=True, captured=True)
    out = run(rig, course, y, rng)
    return Capture(sample_time_s=sample_s, u_from_v=u_from, u_to_v=u_to, step_index=pre, i_c_a=out[:, 1])


def _steady(theta: Theta, plant: Plant, record: Record, rng: np.random.Generator) -> Record:
    p, c = theta.base(plant), theta.vector()
    i = np.array([holding_current(p, c, float(x)) if np.isfinite(x) else np.nan for x in record.x])
    return replace(record, i_c=i * (1.0 + STATIC_ERROR * rng.standard_normal(len(i))))


def _start(
    theta: Theta, plant: Plant, record: Record, piece: slice, clamped: bool
) -> tuple[NDArray[np.float64], float]:
    """Return the state from the first samples of a piece, shape (STATES,), and the speed of the reading, m/s."""
    p, c = theta.base(plant), theta.vector()
    head = slice(piece.start, min(piece.start + _HEAD, piece.stop))
    y, speed = np.zeros(STATES), 0.0
    i = record.i_c[head][np.isfinite(record.i_c[head])]
    settle_current(c, y, current_of_reading(c, float(i[0])) if len(i) else steady_current(p, c, 0.0))
    y[X] = theta.stop_low_m
    known = np.isfinite(record.x[head])
    if known.sum() >= 3:
        t, x = record.t[head][known], record.x[head][known]
        # A line through eight readings: the difference of two would be a speed of noise.
        line = np.polynomial.polynomial.polyfit(t - record.t[piece.start], x, 0 if clamped else 1)
        x_first = float(line[0])
        y[X] = position_of_reading(p, c, x_first, float(y[I_C]))
        speed = 0.0 if clamped else float(line[1])
        if not clamped and not 0.0 < y[X] < plant.travel_m:
            y[X], speed = min(max(y[X], theta.stop_low_m), plant.travel_m + theta.stop_high_m), 0.0
        y[V] = speed
    y[SENSOR], y[RATE] = position_reading(p, c, float(y[X]), float(y[I_C])), y[V]
    # The mean of the recording: how warm the coil was before is not known.
    warmths = [lasting_warmth(c, i) for i in record.i_c[piece].tolist() if math.isfinite(i)]
    y[WARMTH] = float(np.mean(warmths)) if warmths else 0.0
    return y, speed


def _pieces(record: Record) -> list[slice]:
    """Return the stretches without a gap over BRIDGING_S."""
    _, follows = intervals(record.t)
    steps = np.diff(record.t, prepend=np.nan)
    broken = np.flatnonzero(~(follows | ((steps > 0.0) & (steps <= BRIDGING_S)))).tolist()
    edges = [0, *(n for n in broken if n > 0), len(record.t)]
    return [slice(a, b) for a, b in pairwise(edges) if b > a]


def _bridged(t: FloatArray) -> FloatArray:
    """The times with those of lost samples inserted."""
    if len(t) < 2:
        return t
    steps = np.diff(t)
    median = float(np.median(steps))
    missing = np.maximum(np.rint(steps / median).astype(int), 1)
    if np.all(missing == 1):
        return t
    # The lost samples are simulated, too: the board ran on while the log lacked them.
    starts = np.repeat(t[:-1], missing)
    offset = np.arange(len(starts)) - np.repeat(np.cumsum(missing) - missing, missing)
    return np.append(starts + offset * np.repeat(steps / missing, missing), t[-1])


def _held(values: FloatArray, rows: NDArray[np.int64], n: int) -> FloatArray:
    """Return the values at the rows of a grid of n ticks, each held until the next finite value, shape (n,)."""
    at = np.full(n, np.nan)
    at[rows] = values
    known = np.isfinite(at)
    if not known.any():
        return np.zeros(n)
    last = np.maximum.accumulate(np.where(known, np.arange(n), int(np.argmax(known))))
    return at[last]


def integral_at(numbers: LawNumbers, theta: Theta, y: NDArray[np.float64], x_ref: float, u: float) -> float:
    """The integral with which the law gives the input u (V) at state y with the ball at rest, m s."""
    reading = current_reading(theta.vector(), float(y[I_C]))
    return _integral(numbers, reading, float(y[SENSOR]), float(y[SENSOR]), x_ref, u)


def _integral(numbers: LawNumbers, i: float, x: float, x_prev: float, x_ref: float, u: float) -> float:
    if numbers.k_s == 0.0 or not math.isfinite(u):
        return 0.0
    without, _ = law(numbers._replace(u_low=-math.inf, u_high=math.inf), i, x, x_prev, 0.0, x_ref)
    return float((u - without) / numbers.k_s)


def _recorded_integral(numbers: LawNumbers, record: Record, piece: slice) -> float:
    """The integral at the first sample of a piece, m s, from recorded readings and u_c; 0 if not determined."""
    errors = np.nan_to_num(record.x_ref[piece][:_HEAD] - record.x[piece][:_HEAD])
    for k in range(1, len(errors)):
        n = piece.start + k
        i, x, x_prev = float(record.i_c[n]), float(record.x[n]), float(record.x[n - 1])
        x_ref, u = float(record.x_ref[n]), float(record.u_c[n])
        # The first u_c between its limits: at a limit any integral beyond gives the same u_c.
        if all(map(math.isfinite, (i, x, x_prev, x_ref, u))) and numbers.u_low < u < numbers.u_high:
            integral = _integral(numbers, i, x, x_prev, x_ref, u)
            return integral - float(errors[:k].sum()) * numbers.sample_time_s
    return 0.0


def input_limit(record: Record) -> float:
    """The upper limit of u_c, V, if the law reached it; otherwise inf."""
    u = record.u_c[np.isfinite(record.u_c)]
    if len(u) < _LIMIT_SAMPLES:
        return math.inf
    top = float(u.max())
    stood = bool((np.convolve(u >= top, np.ones(_LIMIT_SAMPLES), "valid") >= _LIMIT_SAMPLES).any())
    # Without noise, a hovering ball has a constant u_c, too, but that is not a limit.
    return top if stood and top > _LIMIT_OVER * float(np.median(u)) else math.inf
