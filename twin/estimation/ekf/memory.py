"""The filter's constants and memory, as one record that its kernels share.

Compiled code passes a record by address.  A tuple of as many arrays updates all their reference counts at each call.
That took ten times as long as a step with known Jacobian.  Matrices have room for all states; the first m are used.
"""

from __future__ import annotations

import math
from functools import cache
from typing import Any, Protocol, cast

import numpy as np
from numpy.typing import NDArray

from twin.compiled import Packed, inlined
from twin.estimation.structures import NoiseLevels, System
from twin.model.causes import (
    amplifier_gain_drift,
    current_sensor_gain,
    current_sensor_lag,
    current_sensor_offset,
    eddy_current_lag,
    magnetic_hysteresis,
    position_sensor_lag,
    position_sensor_offset,
    second_time_constant,
)
from twin.model.causes.catalogue import OFFSETS
from twin.model.causes.cause import PLACES
from twin.model.causes.sensor_line import HARMONICS, MEMORY_S, harmonics
from twin.model.causes.wander import MINUTE_S
from twin.model.extended import (
    CORE,
    FIELD,
    I_C,
    I_COLOUR,
    I_LINES,
    I_SENSOR,
    LOOP,
    RATE,
    SECOND,
    SENSOR,
    STATES,
    WANDER,
    WARMTH,
    X_COLOUR,
    X_LINES,
    Base,
    V,
    X,
)

Floats = NDArray[np.float64]
_WANDERS = {offset: WANDER + k for k, (offset, _) in enumerate(OFFSETS)}
_NAMED = {
    "field": FIELD,
    "sensor": SENSOR,
    "rate": RATE,
    "second": SECOND,
    "core": CORE,
    "i_sensor": I_SENSOR,
    "warmth": WARMTH,
    "loop": LOOP,
    "x_offset": _WANDERS[position_sensor_offset.OFFSET],
    "i_offset": _WANDERS[current_sensor_offset.OFFSET],
    "i_colour": I_COLOUR,
    "x_colour": X_COLOUR,
}


class Memory(Protocol):
    """A model, its noise, and the memory of the filter; m states are in the covariance."""

    paper: Floats  # tuple(Base), shape (8,); not "base", which each numpy record has
    c: Floats  # the causes' parameters with what has wandered so far (`wandered`), shape (PLACES,)
    closed_form: bool  # as in `System`
    moments: Floats  # of `transition.py`, shape (9,)
    moments_s: float  # interval that the moments are for, s
    r_i: float  # variance of the white noise of a reading of i_c, A^2
    r_x: float  # of x, m^2
    v_i: float  # of the coloured noise
    v_x: float
    tau_i: float  # its correlation time, s
    tau_x: float
    share_x: float  # of this noise that the instrument of a reading of x shows, 1 for the usual one
    noise_i_c: Floats  # r_i, v_i, tau_i of other recordings, and of captures and those as fast, shape (6,)
    q_i: float  # of the disturbance of i_c, A^2/s
    q_a: float  # of the acceleration, constant over an interval, m^2/s^4
    low_m: float  # position of the ball at the lower stop
    high_m: float  # at the upper stop
    m: int
    places: NDArray[np.int64]  # indices of the m states in the state, I_C, X, V first
    field: int  # place in the covariance; -1: not in it (likewise the next eleven)
    sensor: int
    rate: int
    second: int
    core: int
    i_sensor: int
    warmth: int
    loop: int  # of the iron's hysteresis
    x_offset: int  # of the states that wander
    i_offset: int
    i_colour: int  # of coloured noise
    x_colour: int
    lasting: int  # place of the first state that a flight leaves as it is: lagging currents, warmth, loop, noise
    wandering: int  # place of the first that wanders
    coloured: int  # place of the first of coloured noise
    lines: int  # place of the first of the lines, which are last
    lines_count: int
    pulse: Floats  # angular frequency of each line, rad/s
    v_line: Floats  # variance at the beginning of a recording
    q_line: Floats  # its growth per s
    h_line: Floats  # derivatives of the reading of x by the lines, 0 elsewhere, shape (STATES,)
    usual: Floats  # c without what has wandered, shape (PLACES,)
    offsets: NDArray[np.int64]  # place in c of each state that wanders
    q_w: Floats  # of the wandering, in the square of its unit per s
    first: int  # first sample of this chain
    in_flight: bool
    readings: int  # of x in this flight, after the first
    y: Floats  # the state, shape (STATES,)
    previous: Floats  # the state at the previous sample
    moved: Floats  # working array
    back: Floats  # working array
    gains: Floats  # Kalman gains of the last readings of i_c and x, shape (2, STATES)
    reuses_gains: bool  # they come from another run, and there is no covariance
    h_i: Floats  # derivatives of the reading of i_c
    h_x: Floats  # derivatives of the reading of x
    P: Floats  # covariance, shape (STATES, STATES)
    F: Floats  # Jacobian d state / d previous state
    G: Floats  # working array


def states_in(c: Floats, noise: NoiseLevels) -> int:
    """The number m of active states under the causes c, shape (PLACES,), and this noise."""
    return len(active_states(c)) + len(_colours(noise)) + 2 * len(_lines(c))


def _colours(noise: NoiseLevels) -> list[int]:
    """The states of coloured noise."""
    coloured = noise.tau_i_c_s > 0.0 or noise.tau_i_c_captured_s > 0.0, noise.tau_x_s > 0.0
    return [state for state, lives in zip((I_COLOUR, X_COLOUR), coloured, strict=True) if lives]


def _lines(c: Floats) -> list[tuple[int, float, float]]:
    """The lines under the causes c: (first of the two states, frequency in Hz, amplitude in A or m)."""
    return [
        (first + 2 * k, *line)
        for column, first in enumerate((I_LINES, X_LINES))
        for k, line in enumerate(harmonics(c, column))
    ]


def active_states(c: Floats) -> list[int]:
    """The states of the model that are independent under the causes c, shape (PLACES,); I_C, X, V first."""
    conditions = (
        (FIELD, c[eddy_current_lag.TAU] > 0.0),
        (SENSOR, c[position_sensor_lag.TAU] > 0.0),
        (RATE, c[position_sensor_lag.TAU] > 0.0 and c[position_sensor_lag.SECOND] > 0.0),
        (SECOND, c[second_time_constant.SHARE] != 0.0),
        (CORE, c[eddy_current_lag.TAU] > 0.0 and c[eddy_current_lag.SLOW] > 0.0),
        (I_SENSOR, c[current_sensor_lag.TAU] > 0.0),
        (WARMTH, c[amplifier_gain_drift.LOSS] != 0.0),
        (LOOP, c[magnetic_hysteresis.HALF_WIDTH] > 0.0),
        *((WANDER + k, c[wander] > 0.0) for k, (_, wander) in enumerate(OFFSETS)),
    )
    return [I_C, X, V, *(state for state, lives in conditions if lives)]


@cache
def _fields() -> np.dtype[np.void]:
    vector, square = (STATES,), (STATES, STATES)
    numbers = ("moments_s", "r_i", "r_x", "v_i", "v_x", "tau_i", "tau_x", "share_x", "q_i", "q_a", "low_m", "high_m")
    counts = ("m", *_NAMED, "lasting", "wandering", "coloured", "first", "readings", "lines", "lines_count")
    vectors = ("y", "previous", "moved", "back", "h_i", "h_x", "h_line")
    fields: list[Any] = [("paper", float, (len(Base._fields),)), *((name, float, (PLACES,)) for name in ("c", "usual"))]
    fields += [(name, float) for name in numbers] + [(name, np.int64) for name in counts]
    fields += [("places", np.int64, vector), ("offsets", np.int64, vector), ("q_w", float, vector)]
    fields += [("moments", float, (9,)), ("noise_i_c", float, (6,)), ("gains", float, (2, STATES))]
    fields += [(name, float, (2 * HARMONICS,)) for name in ("pulse", "v_line", "q_line")]
    fields += [(name, np.bool_) for name in ("closed_form", "in_flight", "reuses_gains")]
    fields += [(name, float, vector) for name in vectors] + [(name, float, square) for name in ("P", "F", "G")]
    return np.dtype(fields, align=True)


def memory_for(system: System) -> Memory:
    """The record of a filter before its first sample."""
    records = np.zeros(1, _fields())
    record: Any = records[0]
    c, noise, places = system.c, system.noise, active_states(system.c)
    coloured = len(places)
    places += _colours(noise)
    lines = _lines(c)
    record["lines"], record["lines_count"] = len(places), len(lines)
    places += [state for first, _, _ in lines for state in (first, first + 1)]
    record["paper"], record["closed_form"] = system.base, system.closed_form
    record["c"] = record["usual"] = c
    record["noise_i_c"][:3] = _split(noise.sigma_i_c_a, noise.white_i_c, noise.tau_i_c_s)
    record["noise_i_c"][3:] = _split(noise.sigma_i_c_a, noise.white_i_c_captured, noise.tau_i_c_captured_s)
    record["r_i"], record["v_i"], record["tau_i"] = record["noise_i_c"][:3]
    record["share_x"] = 1.0
    record["r_x"], record["v_x"], record["tau_x"] = _split(noise.sigma_x_m, noise.white_x, noise.tau_x_s)
    record["q_i"], record["q_a"] = (
        noise.process_i_c_a * noise.process_i_c_a / noise.tick_s,
        noise.process_a_m_s2 * noise.process_a_m_s2,
    )
    record["low_m"], record["high_m"] = system.stops.low_m, record["paper"][-1] + system.stops.high_m
    record["m"] = len(places)
    record["places"][: len(places)] = places
    for name, state in _NAMED.items():
        record[name] = places.index(state) if state in places else -1
    record["wandering"], record["coloured"] = sum(state < WANDER for state in places), coloured
    record["lasting"] = record["wandering"] - sum(state in places for state in (SECOND, CORE, I_SENSOR, WARMTH, LOOP))
    for k, state in enumerate(places[record["wandering"] : coloured]):
        offset, wander = OFFSETS[state - WANDER]
        record["offsets"][k], record["q_w"][k] = offset, c[wander] ** 2 / MINUTE_S
    record["h_i"][max(record["i_sensor"], 0)] = c[current_sensor_gain.GAIN]
    if record["i_offset"] >= 0:
        record["h_i"][record["i_offset"]] = 1.0
    if record["i_colour"] >= 0:
        record["h_i"][record["i_colour"]] = 1.0
    for n, (state, frequency, amplitude) in enumerate(lines):
        is_current, place = state < X_LINES, record["lines"] + 2 * n
        record["h_i" if is_current else "h_line"][place] = 1.0
        record["pulse"][n], record["v_line"][n] = 2.0 * math.pi * frequency, 0.5 * amplitude**2
        record["q_line"][n] = record["r_i" if is_current else "r_x"] * noise.tick_s / MEMORY_S**2
    return cast(Memory, records.view(np.recarray)[0])


def _split(sigma: float, white: float, tau_s: float) -> tuple[float, float, float]:
    """Return (variance of the white noise, of the coloured noise, its correlation time in s)."""
    if tau_s > 0.0:
        return white * sigma * sigma, (1.0 - white) * sigma * sigma, tau_s
    return sigma * sigma, 0.0, 0.0


@inlined
def wandered(f: Memory, y: Floats) -> None:
    """Set c to what the causes are in state y."""
    for k in range(f.wandering, f.coloured):
        index = f.offsets[k - f.wandering]
        f.c[index] = f.usual[index] + y[f.places[k]]


@inlined
def see_instrument(f: Memory, fast: bool) -> None:
    """The noise of i_c from here on: of a capture or a recording as fast, or not."""
    begin = 3 if fast else 0
    f.r_i, f.v_i, f.tau_i = f.noise_i_c[begin], f.noise_i_c[begin + 1], f.noise_i_c[begin + 2]


@inlined
def scale_noise(f: Memory, fast: bool, r_x: float, ratio_i: float, ratio_x: float) -> None:
    """The noise of a reading whose instrument has these ratios of variances; `r_x`: of x, where the ratio is 1."""
    f.r_i, f.r_x = f.noise_i_c[3 if fast else 0] * ratio_i, r_x * ratio_x
    if f.i_colour >= 0:
        f.h_i[f.i_colour] = math.sqrt(ratio_i)
    f.share_x = math.sqrt(ratio_x)


@inlined
def base_of(memory: Memory) -> Packed:
    """The paper's parameters, tuple(Base)."""
    b = memory.paper
    return b[0], b[1], b[2], b[3], b[4], b[5], b[6], b[7]
