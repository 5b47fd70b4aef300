"""A second rig and a second board, written from equations alone: nothing of emulator or twin.

What differs from `gateway/emulator/plant/physics.py` although it is meant to be the same effect:

- integration: operators split, each solved exactly (amplifier, field, sensor: exponentials) or implicitly (drag, dry
  friction), 10 us a step; an impact reflects the overshoot instead of being searched for;
- amplifier-gain-drift: the resistance grows, gain K_A / (1 + loss w), not K_A (1 - loss w); its time constant is the
  rig's, 20 to 45 s;
- core-saturation: field i_0 tanh(i/i_0) with i_0 = i_s sqrt(2/3): the same departure from i as i / sqrt(1 + (i/i_s)^2)
  to third order, 1 % less at lift-off with i_s = 1.5 A;
- position-sensor-nonlinearity: half a sine of height bow instead of a parabola: 5 % of bow between them at most;
- periodic-disturbance: frequency and phase are the rig's, 5 to 11 Hz;
- prbs and multisine come from a generator of random numbers, the law computes in floating point.

Effects that the catalogue does not know are in the same equations; `outside.py` names them.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple, ParamSpec, TypeVar, cast

import numba
import numpy as np
from numpy.typing import NDArray

from tests.harness.diagnose.hidden_campaign import (
    CAPTURE_COUNT,
    CAPTURE_PRE,
    CAPTURE_S,
    MIDDLE_M,
)

FloatArray = NDArray[np.float64]
P = ParamSpec("P")
R = TypeVar("R")

TICK_S = 2e-3
STEP_S = 10e-6
RING = 4096  # steps of memory: 41 ms, twice the longest delay
SLOWEST_REBOUND_M_S = 1e-3
MODE_HZ, MODE_DAMPING = 35.0, 0.05  # lateral-resonance
RIPPLE_HZ = 100.0  # supply-ripple: twice the mains
PATCH_M, PATCH_HALF_WIDTH_M = 2.4e-3, 0.15e-3  # friction-patch
WIRE_FROM_M = 2.5e-3  # wire-spring: slack below
DRIFT_TIME_S = 40.0  # sensor-warm-up
SAG_TIME_S = 1.5  # supply-sag
FILM_M = 0.5e-3  # squeeze-film: its reach above the lower stop
BOW_TO_A = 1.5  # current-bow: a reading is right at 0 and here
LOOP_TURN_A = 0.12
HUM_HZ = 50.0  # sensor-hum

# 12-bit converters like the board's: (offset, one count)
CURRENT_ADC = (0.0, 2.0 / 4096)
POSITION_ADC = (-54.4e-6, 5.0 / 4096 / 855.0)
INPUT_DAC = (0.0, 5.0 / 4096)


class Numbers(NamedTuple):
    """Rig and effects; SI units, names of effects where they are their strength."""

    m: float
    g: float
    travel: float
    plane: float  # x of the pole of the force
    gap_mid: float
    K_c: float
    K_A: float
    T_A: float
    b: float
    bounce: float
    i_max: float
    loss: float
    heating_s: float
    slew: float
    dead_zone: float
    amplifier_offset: float
    growth: float
    emf: float
    delay_steps: int
    exponent: float
    saturation: float  # 0: none, else i_0
    residual: float
    eddy: float
    drag2: float
    friction: float
    force: float
    shake: float
    shake_hz: float
    shake_phase: float
    x_offset: float
    x_gain: float
    bow: float
    x_lag: float
    crosstalk: float
    i_offset: float
    i_gain: float
    sampling_steps: int
    # outside the catalogue
    hysteresis: float
    loop: float
    stick: float
    warm_up: float
    wire: float
    resonance: float
    ripple: float
    patch: float
    contact: float
    spring: float
    sag: float
    hum: float
    octave: float
    shake_octave: float  # share of a second harmonic
    film: float
    i_bow: float


def njit(function: Callable[P, R]) -> Callable[P, R]:
    return cast("Callable[P, R]", numba.njit(cache=True)(function))


# What the rig remembers, in one array: i_c, field, x, v, warmth, sensor, hysteresis, position and speed of the lateral
# mode, reading that is held, contact (1 good, 0 bad), mean current of the supply
COIL, F, X, V, W, S, H, Q, QV, HELD, CONTACT, LOAD = range(12)


@njit
def reading(x: float, i: float, t: float, c: Numbers) -> float:
    """Return the reading that the position sensor tends to, m."""
    bowed = x + c.bow * math.sin(math.pi * min(max(x / c.travel, 0.0), 1.0))
    warm = c.warm_up * (1.0 - math.exp(-t / DRIFT_TIME_S)) if c.warm_up != 0.0 else 0.0
    hum = c.hum * math.sin(2.0 * math.pi * HUM_HZ * t) if c.hum != 0.0 else 0.0
    hum += c.octave * math.sin(4.0 * math.pi * HUM_HZ * t + 1.0) if c.octave != 0.0 else 0.0
    return c.x_gain * bowed + c.x_offset + c.crosstalk * i + warm + hum


@njit
def lift(x: float, field: float, c: Numbers) -> float:
    """Magnetic force (3), N."""
    field += c.residual
    if c.saturation > 0.0:
        field = c.saturation * math.tanh(field / c.saturation)
    gap = c.plane - x
    force = c.K_c * (field / gap) ** 2
    return force if c.exponent == 2.0 else force * math.exp((c.exponent - 2.0) * math.log(c.gap_mid / gap))


@njit
def pass_time(
    y: FloatArray, k: int, count: int, u: float, c: Numbers, inputs: FloatArray, i_past: FloatArray, x_past: FloatArray
) -> int:
    """`count` steps with u held; returns the number of the step reached."""
    h = STEP_S
    field_share = 1.0 - math.exp(-h / c.eddy) if c.eddy > 0.0 else 1.0
    sensor_share = 1.0 - math.exp(-h / c.x_lag) if c.x_lag > 0.0 else 1.0
    decay = math.exp(-h / c.T_A)
    mode = 2.0 * math.pi * MODE_HZ
    for _ in range(count):
        t = k * h
        inputs[k % RING] = u
        drive = inputs[(k - c.delay_steps) % RING]
        if c.ripple != 0.0:
            drive *= 1.0 + c.ripple * math.sin(2.0 * math.pi * RIPPLE_HZ * t)
        i, x, v = y[COIL], y[X], y[V]
        gap = c.plane - x

        # (1) with the heated coil, solved exactly over the step
        gain = c.K_A / (1.0 + c.loss * y[W])
        if y[CONTACT] == 0.0:
            gain *= 1.0 - c.contact
        gain *= 1.0 - c.sag * y[LOAD]
        goal = gain * max(drive - c.dead_zone, 0.0) + c.amplifier_offset
        goal = min(max(goal, 0.0), c.i_max)
        goal -= c.emf * i * v * (c.gap_mid / gap) ** 2
        if c.growth != 0.0:
            bottom, top = 1.0 / c.plane, 1.0 / (c.plane - c.travel)
            decay = math.exp(-h / (c.T_A * (1.0 + c.growth * (1.0 / gap - bottom) / (top - bottom))))
        change = (goal - i) * (1.0 - decay)
        change = min(max(change, -c.slew * h), c.slew * h)
        i_new = min(i + change, max(c.i_max, i))
        i_mean = 0.5 * (i + i_new)
        y[COIL] = i_new
        y[W] += h / c.heating_s * (i_mean * i_mean - y[W])
        y[LOAD] += h / SAG_TIME_S * (i_mean - y[LOAD])

        # the field in the gap: play or loop (hysteresis), then the lag of eddy currents
        if c.hysteresis > 0.0:
            y[H] = min(max(y[H], i_new - c.hysteresis), i_new + c.hysteresis)
            source = y[H]
        elif c.loop > 0.0:  # of Bouc and Wen, order 2, beta = gamma = 1/2
            rise = (i_new - i) / LOOP_TURN_A
            y[H] += rise * (1.0 - (y[H] * y[H] if y[H] * rise > 0.0 else 0.0))
            source = i_new - c.loop * y[H]
        else:
            source = i_new
        before = y[F]
        y[F] = before + (source - before) * field_share
        field = 0.5 * (before + y[F])

        # (6): half a drift, a kick with drag taken implicitly and friction as a projection, half a drift
        x_half = x + 0.5 * h * v
        force = lift(x_half, field, c) - c.m * c.g + c.force
        if c.shake != 0.0:
            turn = 2.0 * math.pi * c.shake_hz * (t + 0.5 * h) + c.shake_phase
            force += c.shake * (math.sin(turn) + c.shake_octave * math.sin(2.0 * turn + 1.0))
        if c.wire != 0.0 and x_half > WIRE_FROM_M:
            force -= c.wire * (x_half - WIRE_FROM_M) ** 3
        force -= c.spring * x_half
        film = c.film * (FILM_M / (x_half + FILM_M)) ** 3 if c.film != 0.0 else 0.0
        drag = 0.5 * h * (c.b + film + c.drag2 * abs(v)) / c.m
        v_new = (v * (1.0 - drag) + h * force / c.m) / (1.0 + drag)
        dry = c.friction
        if c.patch != 0.0 and abs(x_half - PATCH_M) < PATCH_HALF_WIDTH_M:
            dry += c.patch
        if dry > 0.0:
            grip = h * dry / c.m
            v_new = 0.0 if abs(v_new) <= grip else v_new - math.copysign(grip, v_new)
        x_new = x_half + 0.5 * h * v_new
        over = x_new if x_new < 0.0 else x_new - c.travel if x_new > c.travel else 0.0
        if over != 0.0:
            stop = x_new - over
            if v_new * over > 0.0 and abs(v_new) > SLOWEST_REBOUND_M_S:
                v_new *= -c.bounce
                x_new = stop - c.bounce * over
            else:
                v_new = 0.0 if v_new * over > 0.0 else v_new
                x_new = stop
        y[X], y[V] = x_new, v_new

        if c.resonance != 0.0:
            # symplectic Euler: the mode is driven by the ball's acceleration
            y[QV] += h * (-mode * mode * y[Q] - 2.0 * MODE_DAMPING * mode * y[QV] + c.resonance * (v_new - v) / h)
            y[Q] += h * y[QV]

        y[S] += (reading(x_new, i_new, t, c) + y[Q] - y[S]) * sensor_share
        k += 1
        i_past[k % RING] = y[COIL]
        x_past[k % RING] = y[S]
    return k


@njit
def convert(value: float, offset: float, lsb: float) -> float:
    """A 12-bit converter there and back."""
    return offset + lsb * min(max(math.floor((value - offset) / lsb + 0.5), 0.0), 4095.0)


@njit
def sense(
    y: FloatArray, k: int, c: Numbers, i_past: FloatArray, x_past: FloatArray, i_noise: float, x_noise: float
) -> tuple[float, float]:
    """(i_c, x) after the converters."""
    at = (k - c.sampling_steps) % RING
    x = x_past[at] + x_noise
    if c.stick > 0.0:
        if abs(x - y[HELD]) > c.stick:
            y[HELD] = x
        x = y[HELD]
    i = i_past[at] * (1.0 + c.i_bow * (1.0 - i_past[at] / BOW_TO_A))
    i = c.i_gain * i + c.i_offset + i_noise
    return convert(i, CURRENT_ADC[0], CURRENT_ADC[1]), convert(x, POSITION_ADC[0], POSITION_ADC[1])


@njit
def run_ticks(
    y: FloatArray,
    k: int,
    u: float,
    closed: bool,
    signal: FloatArray,
    law: FloatArray,
    memory: FloatArray,
    noise: FloatArray,
    wrong_bit: FloatArray,
    good_contact: FloatArray,
    c: Numbers,
    inputs: FloatArray,
    i_past: FloatArray,
    x_past: FloatArray,
    out: FloatArray,
) -> tuple[int, float]:
    """Ticks of 2 ms: time passes, the sensors are read, the input for the next 2 ms is set.

    Args:
        y: What the rig remembers; updated.
        k: Steps done.
        u: Input in force, V.
        closed: Whether the law runs (else u = signal).
        signal: x_ref in m or u_c in V, shape (n,).
        law: (K [4], i_0, x_0, u_0) of (13), (18), (19).
        memory: (integral, x before, whether there is one); updated.
        noise: Of i_c in A and x in m, shape (n, 2).
        wrong_bit: Counts of x toggled by an error, shape (n,).
        good_contact: 1 or 0, shape (n,).
        c: Numbers.
        inputs: Ring of inputs.
        i_past: Ring of currents.
        x_past: Ring of positions.
        out: t, u_c, i_c, x, x_ref, shape (n, 5); filled.

    Returns:
        (steps done, input in force).
    """
    steps = round(TICK_S / STEP_S)
    for n in range(len(signal)):
        y[CONTACT] = good_contact[n]
        k = pass_time(y, k, steps, u, c, inputs, i_past, x_past)
        i_m, x_m = sense(y, k, c, i_past, x_past, noise[n, 0], noise[n, 1])
        if wrong_bit[n] > 0.0:
            count = round((x_m - POSITION_ADC[0]) / POSITION_ADC[1])
            up = (count // int(wrong_bit[n])) % 2 == 0
            x_m += POSITION_ADC[1] * (wrong_bit[n] if up else -wrong_bit[n])
        if closed:
            speed = (x_m - memory[1]) / TICK_S if memory[2] > 0.0 else 0.0
            e = signal[n] - x_m
            demand = law[6] - (law[0] * (i_m - law[4]) + law[1] * (x_m - law[5]) + law[2] * speed + law[3] * memory[0])
            u = convert(min(max(demand, 0.0), 5.0), INPUT_DAC[0], INPUT_DAC[1])
            # the integral rests while it would push further into the limit; more of it means more input
            if not ((demand > 5.0 and -law[3] * e > 0.0) or (demand < 0.0 and -law[3] * e < 0.0)):
                memory[0] += e * TICK_S
            memory[1], memory[2] = x_m, 1.0
        else:
            u = signal[n]
        out[n, 0], out[n, 1], out[n, 2], out[n, 3] = k * STEP_S, u, i_m, x_m
        out[n, 4] = signal[n] if closed else MIDDLE_M
    return k, u


@njit
def capture_samples(
    y: FloatArray,
    k: int,
    u_from: float,
    u_to: float,
    noise: FloatArray,
    c: Numbers,
    inputs: FloatArray,
    i_past: FloatArray,
    x_past: FloatArray,
    out: FloatArray,
) -> int:
    """i_c every 40 us, the step at sample CAPTURE_PRE, whose sample still shows what was before."""
    k = pass_time(y, k, round(20e-3 / STEP_S), u_from, c, inputs, i_past, x_past)
    for n in range(CAPTURE_COUNT):
        u = u_to if n >= CAPTURE_PRE else u_from
        i_m, _ = sense(y, k, c, i_past, x_past, noise[n, 0], noise[n, 1])
        out[n, 0], out[n, 1], out[n, 2] = k * STEP_S, u, i_m
        k = pass_time(y, k, round(CAPTURE_S / STEP_S), u, c, inputs, i_past, x_past)
    return k
