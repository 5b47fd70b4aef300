"""Simulation of the extended model tick by tick under the board's law or a given input, with converters.

Rule 1: sensor and process noise are those of theta.  The sigmas of theta include quantisation, which is subtracted
        before the converters add it.
Rule 2: the delays of actuation and of sampling add to one delay between u_c and the readings, as in
        `twin/estimation/propagate.py`.
Rule 3: the stops are inelastic, at the positions of theta.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from protocol.campaign import Controller, Plant
from twin.compiled import Packed, kernel
from twin.control import LawNumbers, law, rounded
from twin.estimation.propagate import input_over, propagate, see_delays
from twin.estimation.record import FloatArray, Record
from twin.inference.theta import Theta
from twin.model.causes.sensor_line import harmonics
from twin.model.equilibrium import holding_current
from twin.model.extended import (
    I_C,
    RATE,
    SENSOR,
    Base,
    V,
    X,
    lagging_reading,
    position_reading,
    reading_of_current,
    sensor_lag_s,
)
from twin.model.integration import STOPS

TICK_S = 2e-3  # of the board (15)
_NO_LAW: Packed = tuple(LawNumbers(*[0.0] * len(LawNumbers._fields)))


@dataclass(frozen=True, slots=True, kw_only=True)
class Converters:
    """Resolution of the board's converters; 0: no rounding."""

    i_lsb_a: float = 0.0
    x_lsb_m: float = 0.0
    u_lsb_v: float = 0.0
    i_from_zero: bool = True  # whether i_c below 0 A reads 0


@dataclass(frozen=True, slots=True, kw_only=True)
class Rig:
    """A simulated rig and its board."""

    theta: Theta
    plant: Plant
    controller: Controller | None = None  # of the board; None: LQI for `theta`
    tick_s: float = TICK_S  # T_s of the board, and the interval of the process noise
    u_max_v: float = math.inf  # upper limit of u_c in closed loop; the lower is 0
    converters: Converters | None = None  # of the board; None: `twelve_bits`


@dataclass(frozen=True, slots=True, kw_only=True)
class Course:
    """The commands of a simulation, and how the ball is held."""

    t: FloatArray  # s, shape (n,)
    command: FloatArray  # x_ref in m under a law, otherwise u_c in V, shape (n,)
    law: LawNumbers | None = None  # None: open loop
    clamped: bool = False  # whether the ball is held at its position
    floor_m: float | None = None  # position of a support above the lower stop; None: the ball rests on the stop
    captured: bool = False  # whether it is a capture


def run(
    rig: Rig, course: Course, y: NDArray[np.float64], rng: np.random.Generator, *, s: float = 0.0, speed: float = 0.0
) -> FloatArray:
    """Run `play` with the noise of the rig.

    Args:
        rig: the rig.
        course: the commands, n samples.
        y: the state at the first sample, shape (STATES,), changed in place.
        rng: random generator of 4 n normal numbers, and of the phases of the sensors' lines.
        s: the integral of the law at the first sample, m s.
        speed: of the reading at the first sample, m/s.

    Returns:
        u_c, the readings of i_c and x, and the true x, shape (n, 4).
    """
    theta, plant, t = rig.theta, rig.plant, course.t
    steps = twelve_bits(theta, plant) if rig.converters is None else rig.converters
    c = theta.vector()
    see_delays(c, c, course.captured)
    step = np.diff(t, prepend=t[0])
    scale = np.empty((4, len(t)))
    scale[0], scale[1] = _without_step(theta.sigma_i_c_a, steps.i_lsb_a), _without_step(theta.sigma_x_m, steps.x_lsb_m)
    # The current's disturbance is a random walk, so its variance grows with the interval.  The acceleration is constant
    # over one.
    scale[2], scale[3] = theta.process_i_c_a * np.sqrt(step / rig.tick_s), theta.process_a_m_s2
    # Drawn beforehand: the same seed gives the same noise, whatever the ball does.
    noise = scale * rng.standard_normal((4, len(t)))
    for column in range(2):
        for frequency, amplitude in harmonics(c, column):
            noise[column] += amplitude * np.sin(2.0 * math.pi * (frequency * t + rng.random()))
    out = np.empty((len(t), 4))
    play(
        tuple(theta.base(plant)),
        c,
        _NO_LAW if course.law is None else tuple(course.law),
        course.law is not None,
        course.clamped,
        (theta.stop_low_m if course.floor_m is None else course.floor_m, plant.travel_m + theta.stop_high_m),
        (steps.i_lsb_a, steps.x_lsb_m, steps.u_lsb_v, 0.0 if steps.i_from_zero else -math.inf),
        t,
        step,
        course.command,
        noise,
        y,
        s,
        speed,
        out,
    )
    return out


def _without_step(sigma: float, lsb: float) -> float:
    # Rounding is nearly uniform over a step, hence lsb^2 / 12 (B. Widrow, A study of rough amplitude quantization by
    # means of Nyquist sampling theory, 1956).
    return math.sqrt(max(sigma * sigma - lsb * lsb / 12.0, 0.0))


@kernel
def play(
    base: Packed,
    c: NDArray[np.float64],
    law_: Packed,
    closed_loop: bool,
    clamped: bool,
    stops_m: tuple[float, float],
    lsb: tuple[float, float, float, float],
    t: NDArray[np.float64],
    step: NDArray[np.float64],
    command: NDArray[np.float64],
    noise: NDArray[np.float64],
    y: NDArray[np.float64],
    s: float,
    speed: float,
    out: NDArray[np.float64],
) -> None:
    """Fill out, shape (n, 4), with u_c, the readings of i_c and x, and the true x.

    Args:
        base: tuple(Base).
        c: the causes' parameters, shape (PLACES,).
        law_: tuple(LawNumbers); not used in open loop.
        closed_loop: whether `command` is x_ref.
        clamped: whether the ball is held at its position.
        stops_m: positions of the ball at the lower and the upper stop, m.
        lsb: steps of i_c, x and u_c, and the lowest reading of i_c; A, m, V, A.
        t: times, s, shape (n,).
        step: time since the previous sample, s, shape (n,).
        command: of each sample, in force until the next, shape (n,).
        noise: added at each sample to the readings of i_c and x and to i_c, and an acceleration during the previous
            interval; A, m, A, m/s^2, shape (4, n).
        y: the state at the first sample, shape (STATES,), changed in place.
        s: the integral of the law at the first sample, m s.
        speed: of the reading at the first sample, m/s.
        out: receives the result.
    """
    p = Base(*base)
    numbers = LawNumbers(*law_)
    lag_s = sensor_lag_s(c)
    u = out[:, 0]
    x_prev = 0.0
    for n in range(len(t)):
        if n > 0:
            held_x, sensed, rate = y[X], y[SENSOR], y[RATE]
            propagate(base, c, y, input_over(c, u, n, 0, step[n]), t[n - 1], step[n], STOPS)
            if clamped:
                y[X], y[V] = held_x, 0.0
            else:
                a, T_s = noise[3, n], step[n]
                touches = True
                # No rebound: its height would need a restitution, which the model does not have.
                if y[X] <= max(stops_m[0], 0.0) and y[V] <= 0.0:
                    y[X], y[V] = stops_m[0], 0.0
                elif y[X] >= min(stops_m[1], p.travel_m) and y[V] >= 0.0:
                    y[X], y[V] = stops_m[1], 0.0
                else:
                    touches = False
                    y[X] += 0.5 * a * T_s * T_s
                    y[V] += a * T_s
                if touches and lag_s > 0.0:
                    steady_reading = position_reading(p, c, y[X], y[I_C])
                    y[SENSOR], y[RATE] = lagging_reading(c, sensed, rate, steady_reading, T_s)
            y[I_C] += noise[2, n]
        if lag_s <= 0.0:
            y[SENSOR] = position_reading(p, c, y[X], y[I_C])
        i, x = reading_of_current(c, y) + noise[0, n], y[SENSOR] + noise[1, n]
        i, x = max(rounded(i, lsb[0]), lsb[3]), rounded(x, lsb[1])
        if n == 0:
            x_prev = x - speed * numbers.sample_time_s
        v = command[n]
        if closed_loop:
            v, s = law(numbers, i, x, x_prev, s, command[n])
            v = rounded(v, lsb[2])
        x_prev = x
        out[n, 0], out[n, 1], out[n, 2], out[n, 3] = v, i, x, y[X]


def twelve_bits(theta: Theta, plant: Plant) -> Converters:
    """Return 12-bit converters: x over 1.25 times the travel, i_c and u_c over 1.25 times those of lift-off."""
    i = holding_current(theta.base(plant), theta.vector(), 0.0)
    i = i if math.isfinite(i) else 1.0
    return Converters(
        i_lsb_a=1.25 * i / 4096, x_lsb_m=1.25 * plant.travel_m / 4096, u_lsb_v=1.25 * i / theta.K_A / 4096
    )


def converters_of(records: Sequence[Record]) -> Converters:
    """The converters' steps, from the log or as the smallest differences of readings."""

    def smallest(channel: str) -> float:
        steps = []
        for record in records:
            values = getattr(record, channel)
            distinct = np.unique(values[np.isfinite(values)])
            if len(distinct) > 2 and record.kind != "equilibria":
                gaps = np.diff(distinct)
                gaps = gaps[gaps > 1e-6 * (distinct[-1] - distinct[0])]
                steps.append(float(np.min(gaps)))
        return min(steps, default=0.0)

    logged = [record.lsb for record in records if record.lsb != (0.0, 0.0)]
    i_lsb, x_lsb = logged[0] if logged else (smallest("i_c"), smallest("x"))
    lowest = [np.nanmin(r.i_c) for r in records if r.has("i_c") and r.kind != "equilibria"]
    lowest += [np.min(capture.i_c_a) for r in records for capture in r.captures]
    return Converters(
        i_lsb_a=i_lsb, x_lsb_m=x_lsb, u_lsb_v=smallest("u_c"), i_from_zero=bool(min(lowest, default=0.0) >= 0.0)
    )
