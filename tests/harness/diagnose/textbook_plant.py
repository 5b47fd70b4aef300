"""A third rig: each effect as `forms.py` says, under the second plant's board; nothing of emulator or twin.

Operators split, 10 us a step: lags and the amplifier exactly (exponentials), the ball semi-implicitly.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from gateway.emulator.plant.constants import PlantConstants
from tests.harness.diagnose.forms import FORMS
from tests.harness.diagnose.hidden_campaign import (
    CAPTURE_COUNT,
    CAPTURE_PRE,
    CAPTURE_S,
    MIDDLE_M,
    Signal,
    designed_gains,
)
from tests.harness.diagnose.second_bench import on_grid, wave
from tests.harness.diagnose.second_plant import (
    CURRENT_ADC,
    INPUT_DAC,
    POSITION_ADC,
    RING,
    SLOWEST_REBOUND_M_S,
    STEP_S,
    TICK_S,
    FloatArray,
    convert,
    njit,
)

# In the order of `FORMS`.
FROEHLICH, ARCTAN, GAP_EXPONENTIAL, GAP_RATIONAL, EDDY_FORCE, EDDY_FLUX, EDDY_TWO, STRIBECK, LUGRE = range(9)
HEATS, SOFT_ZONE, SOFT_LIMIT, INDUCTANCE, CUBIC, SECOND_ORDER, DRAG, JITTER = range(9, 17)
TANH, LANGEVIN, GAP_POLYNOMIAL, TWO_SIDED, FOLDBACK, SQUARE_ZONE, INDUCTANCE_EXP, SINE, THIRD_ORDER, CUBE = range(
    17, 27
)
CURRENT_TWO, CREEPS, FILTERED, DIFFUSION = range(27, 31)
assert len(FORMS) == 31
KINDS = {name: kind for kind, name in enumerate(FORMS)}
HEATING_S = 28.0
FOLDS_BACK = 0.3
REACH_OF_EXP = 0.6  # of the middle gap
STRIBECK_M_S, BRISTLE_M = 5e-3, 5e-6
SENSOR_DAMPING = 0.7
CREEPING_SHARE = 0.25
DIFFUSED = 1.0 + 1.0 / 9.0 + 1.0 / 25.0 + 1.0 / 49.0  # all of the current, when it has settled
# i_c, what is held back (two), x, v, warmth, sensor and its rate, bristle, filters before the sensor (two), then layers
COIL, SLOW, FAST, X, V, W, S, SV, Z, S1, S2 = range(11)
READ = 11  # i_c as its sensor shows it
LAYER = 12
LAYERS = 4


class Constants(NamedTuple):
    """Rig and form; SI units."""

    m: float
    g: float
    travel: float
    plane: float
    mid: float
    K_c: float
    K_A: float
    T_A: float
    b: float
    bounce: float
    i_max: float
    kind: int
    size: float


@njit
def goal_of(u: float, w: float, c: Constants) -> float:
    """Current that the amplifier tends to, A."""
    if c.kind == SOFT_ZONE:
        s = 0.2 * c.size
        over = (u - c.size) / s
        goal = c.K_A * s * (over if over > 30.0 else math.log1p(math.exp(over)))
        goal -= c.K_A * s * math.log1p(math.exp(-c.size / s))  # no current without input
    elif c.kind == SQUARE_ZONE:
        goal = c.K_A * (u * u / (4.0 * c.size) if u < 2.0 * c.size else u - c.size)
    else:
        goal = c.K_A * u
    if c.kind == HEATS:
        goal /= 1.0 + c.size * w
    elif c.kind == SOFT_LIMIT and goal > 0.0:
        goal /= (1.0 + (goal / c.size) ** 10) ** 0.1
    elif c.kind == FOLDBACK and goal > c.size:
        goal = c.size - FOLDS_BACK * (goal - c.size)
    return min(max(goal, 0.0), c.i_max)


@njit
def law_of_gap(gap: float, c: Constants) -> float:
    """Force per square of the field, N/A^2."""
    if c.kind == GAP_EXPONENTIAL:
        return c.K_c / c.mid**2 * math.exp(-(gap - c.mid) / c.size)
    if c.kind == GAP_RATIONAL:
        return c.K_c / (gap * gap * (1.0 + (gap - c.mid) / c.size))
    if c.kind == GAP_POLYNOMIAL:
        way = gap - c.mid
        return c.K_c / (gap * gap + c.size * gap * way + c.size * way * way)
    return c.K_c / (gap * gap)


@njit
def magnet(y: FloatArray, x: float, c: Constants) -> float:
    """Force on the ball, N, and the share that is held back carried on by a step."""
    h, gap, i = STEP_S, c.plane - x, y[COIL]
    if c.kind == FROEHLICH:
        i /= 1.0 + i / c.size
    elif c.kind == ARCTAN:
        i = 2.0 * c.size / math.pi * math.atan(0.5 * math.pi * i / c.size)
    elif c.kind == TANH:
        i = c.size * math.tanh(i / c.size)
    elif c.kind == LANGEVIN and i > 1e-3 * c.size:
        i = 3.0 * c.size * (1.0 / math.tanh(i / c.size) - c.size / i)
    if c.kind == EDDY_FORCE:
        y[SLOW] += (law_of_gap(gap, c) * i * i - y[SLOW]) * (1.0 - math.exp(-h / c.size))
        return float(y[SLOW])
    if c.kind == EDDY_FLUX:
        y[SLOW] += (i / gap - y[SLOW]) * (1.0 - math.exp(-h / c.size))
        return float(c.K_c * y[SLOW] * y[SLOW])
    if c.kind == EDDY_TWO:
        y[SLOW] += (i - y[SLOW]) * (1.0 - math.exp(-h / c.size))
        y[FAST] += (i - y[FAST]) * (1.0 - math.exp(-5.0 * h / c.size))
        i = 0.65 * y[SLOW] + 0.35 * y[FAST]
    if c.kind == DIFFUSION:
        field = 0.0
        for n in range(LAYERS):
            order = (2.0 * n + 1.0) ** 2
            y[LAYER + n] += (i - y[LAYER + n]) * (1.0 - math.exp(-h * order / c.size))
            field += y[LAYER + n] / order
        i = field / DIFFUSED
    return float(law_of_gap(gap, c) * i * i)


@njit
def rest_of(y: FloatArray, c: Constants) -> None:
    """Set the states that are held back to their values at rest: the field as it belongs to i_c and x."""
    gap, i = c.plane - y[X], y[COIL]
    if c.kind == EDDY_FORCE:
        y[SLOW] = law_of_gap(gap, c) * i * i
    elif c.kind == EDDY_FLUX:
        y[SLOW] = i / gap
    elif c.kind in (EDDY_TWO, CURRENT_TWO, CREEPS):
        y[SLOW], y[FAST] = i, i
    for n in range(LAYERS):
        y[LAYER + n] = i
    y[READ] = i


@njit
def reading(x: float, c: Constants) -> float:
    """Return the reading that the position sensor tends to, m."""
    if c.kind == SINE:
        return x + c.size * math.sin(2.0 * math.pi * min(max(x / c.travel, 0.0), 1.0))
    if c.kind != CUBIC:
        return x
    position = 2.0 * min(max(x / c.travel, 0.0), 1.0) - 1.0
    return x + c.size * 1.5 * math.sqrt(3.0) * (position - position**3)


@njit
def pass_time(
    y: FloatArray, k: int, count: int, u: float, delay: int, c: Constants, inputs: FloatArray, i_past: FloatArray,
    x_past: FloatArray,
) -> int:  # fmt: skip
    """`count` steps with u held, which acts `delay` steps later; returns the number of the step reached."""
    h = STEP_S
    for _ in range(count):
        inputs[k % RING] = u
        goal = goal_of(inputs[(k - delay) % RING], y[W], c)
        x, v, i = y[X], y[V], y[COIL]
        gap = c.plane - x
        lag = c.T_A
        if c.kind == HEATS:
            lag /= 1.0 + c.size * y[W]
        elif c.kind == INDUCTANCE:
            a = c.mid
            bottom, top = 1.0 / (1.0 + c.plane / a), 1.0 / (1.0 + (c.plane - c.travel) / a)
            coupling = 1.0 / (1.0 + gap / a)
            lag *= 1.0 + c.size * (coupling - bottom) / (top - bottom)
            goal -= c.T_A * c.size / (top - bottom) * coupling * coupling / a * i * v  # i v dL/dx over R
        elif c.kind == INDUCTANCE_EXP:
            a = REACH_OF_EXP * c.mid
            bottom, top = math.exp(-c.plane / a), math.exp(-(c.plane - c.travel) / a)
            coupling = math.exp(-gap / a)
            lag *= 1.0 + c.size * (coupling - bottom) / (top - bottom)
            goal -= c.T_A * c.size / (top - bottom) * coupling / a * i * v  # i v dL/dx over R
        if c.kind in (CURRENT_TWO, CREEPS):
            y[SLOW] += (goal - y[SLOW]) * (1.0 - math.exp(-h / lag))
            y[FAST] += (goal - y[FAST]) * (1.0 - math.exp(-h / c.size))
            y[COIL] = max((1.0 - CREEPING_SHARE) * y[SLOW] + CREEPING_SHARE * y[FAST], 0.0)
        else:
            y[COIL] = max(i + (goal - i) * (1.0 - math.exp(-h / lag)), 0.0)
        y[READ] = y[COIL] if c.kind != FILTERED else y[READ] + (y[COIL] - y[READ]) * (1.0 - math.exp(-h / c.size))
        y[W] += h / HEATING_S * (y[COIL] ** 2 - y[W])

        force = magnet(y, x, c) - c.m * c.g
        drag = c.b
        if c.kind == DRAG:
            drag += c.size * math.sqrt(abs(v))
        elif c.kind == CUBE:
            drag += c.size * v * v
        if c.kind == LUGRE:
            stiff = c.size / BRISTLE_M
            bends = v - abs(v) * y[Z] / BRISTLE_M
            force -= stiff * y[Z] + math.sqrt(stiff * c.m) * bends
            y[Z] += h * bends
        v_new = (v + h * force / c.m) / (1.0 + h * drag / c.m)
        if c.kind == STRIBECK:
            grip = h * c.size * (1.0 + 0.5 * math.exp(-((v / STRIBECK_M_S) ** 2))) / c.m
            v_new = 0.0 if abs(v_new) <= grip else v_new - math.copysign(grip, v_new)
        if c.kind == TWO_SIDED:
            grip = h * c.size / c.m * (1.0 if v_new > 0.0 else 2.0)
            v_new = 0.0 if abs(v_new) <= grip else v_new - math.copysign(grip, v_new)
        x_new = x + 0.5 * h * (v + v_new)
        if x_new < 0.0 or x_new > c.travel:
            stop = 0.0 if x_new < 0.0 else c.travel
            outward = v_new < 0.0 if stop == 0.0 else v_new > 0.0
            if outward:
                v_new = -c.bounce * v_new if abs(v_new) > SLOWEST_REBOUND_M_S else 0.0
            x_new = stop
        y[X], y[V] = x_new, v_new

        if c.kind == SECOND_ORDER:
            omega = 2.0 * SENSOR_DAMPING / c.size
            y[SV] += h * (omega * omega * (x_new - y[S]) - 2.0 * SENSOR_DAMPING * omega * y[SV])
            y[S] += h * y[SV]
        elif c.kind == THIRD_ORDER:
            share = 1.0 - math.exp(-3.0 * h / c.size)
            y[S1] += share * (x_new - y[S1])
            y[S2] += share * (y[S1] - y[S2])
            y[S] += share * (y[S2] - y[S])
        else:
            y[S] = reading(x_new, c)
        k += 1
        i_past[k % RING], x_past[k % RING] = y[READ], y[S]
    return k


@njit
def run_ticks(
    y: FloatArray, k: int, u: float, closed: bool, signal: FloatArray, law: FloatArray, memory: FloatArray,
    noise: FloatArray, delays: FloatArray, c: Constants, inputs: FloatArray, i_past: FloatArray, x_past: FloatArray,
    out: FloatArray,
) -> tuple[int, float]:  # fmt: skip
    """Ticks of 2 ms, as `second_plant.run_ticks`; `delays`: of each tick's input, in steps, shape (n,)."""
    steps = round(TICK_S / STEP_S)
    for n in range(len(signal)):
        k = pass_time(y, k, steps, u, int(delays[n]), c, inputs, i_past, x_past)
        i_m = convert(y[READ] + noise[n, 0], CURRENT_ADC[0], CURRENT_ADC[1])
        x_m = convert(y[S] + noise[n, 1], POSITION_ADC[0], POSITION_ADC[1])
        if closed:
            speed = (x_m - memory[1]) / TICK_S if memory[2] > 0.0 else 0.0
            e = signal[n] - x_m
            demand = law[6] - (law[0] * (i_m - law[4]) + law[1] * (x_m - law[5]) + law[2] * speed + law[3] * memory[0])
            u = convert(min(max(demand, 0.0), 5.0), INPUT_DAC[0], INPUT_DAC[1])
            if not ((demand > 5.0 and -law[3] * e > 0.0) or (demand < 0.0 and -law[3] * e < 0.0)):
                memory[0] += e * TICK_S
            memory[1], memory[2] = x_m, 1.0
        else:
            u = signal[n]
        out[n, 0], out[n, 1], out[n, 2], out[n, 3] = k * STEP_S, u, i_m, x_m
        out[n, 4] = signal[n] if closed else MIDDLE_M
    return k, u


class TextbookBench:
    """The third rig; a `hidden_campaign.Bench`.

    Args:
        rig: Its numbers.
        forms: Strength by name of `forms.FORMS`: one at most.
        seed: Of the noise.
        believed: The rig that the law was designed for.
    """

    def __init__(self, rig: PlantConstants, forms: Mapping[str, float], *, seed: int, believed: PlantConstants) -> None:
        noise, chance = np.random.SeedSequence([44, seed]).spawn(2)
        self._noise, self._chance = np.random.default_rng(noise), np.random.default_rng(chance)
        self._rig, self._believed = rig, believed
        self.change(forms)
        self._k, self._u = 0, 0.0
        self._y = np.zeros(LAYER + LAYERS)
        self._rings = (np.zeros(RING), np.zeros(RING), np.zeros(RING))
        i_0, u_0 = believed.equilibrium_current_a(MIDDLE_M), believed.equilibrium_input_v(MIDDLE_M)
        self._law = np.array([*designed_gains(believed), i_0, MIDDLE_M, u_0])
        self._memory = np.zeros(3)

    def idle(self, ticks: int) -> FloatArray:
        return self._run(np.zeros(ticks), closed=False)

    def open_loop(self, signal: Signal, ticks: int) -> FloatArray:
        return self._run(np.clip(on_grid(wave(signal, ticks), INPUT_DAC), 0.0, 5.0), closed=False)

    def fly(self, x_m: float) -> None:
        y = self._y
        y[COIL], y[X], y[V] = self._believed.equilibrium_current_a(x_m), x_m, 0.0
        y[S] = y[S1] = y[S2] = reading(x_m, self._c)
        y[SV] = y[Z] = 0.0
        rest_of(y, self._c)
        self._u = self._believed.equilibrium_input_v(x_m)
        self._rings[0][:] = self._u
        self._memory[:] = 0.0

    def closed_loop(self, signal: Signal, ticks: int) -> FloatArray:
        return self._run(on_grid(wave(signal, ticks), POSITION_ADC), closed=True)

    def capture(self, u_from_v: float, u_to_v: float) -> FloatArray:
        low, high = (float(on_grid(np.array([u]), INPUT_DAC)[0]) for u in (u_from_v, u_to_v))
        delay = int(self._delays(1)[0])
        self._k = pass_time(self._y, self._k, round(20e-3 / STEP_S), low, delay, self._c, *self._rings)
        out = np.empty((CAPTURE_COUNT, 3))
        noise = self._draw_noise(CAPTURE_COUNT)
        for n in range(CAPTURE_COUNT):
            u = high if n >= CAPTURE_PRE else low
            i_m = convert(float(self._y[READ]) + float(noise[n, 0]), CURRENT_ADC[0], CURRENT_ADC[1])
            out[n] = self._k * STEP_S, u, i_m
            self._k = pass_time(self._y, self._k, round(CAPTURE_S / STEP_S), u, delay, self._c, *self._rings)
        self._run(np.zeros(1), closed=False)  # back on the grid of ticks, coil off
        return out

    def change(self, effects: Mapping[str, float]) -> None:
        assert len(effects) <= 1, effects
        name, size = next(iter(effects.items()), ("", 0.0))
        rig = self._rig
        plane = rig.travel_m + rig.coil_plane_above_stop_m
        self._c = Constants(
            m=rig.mass_kg,
            g=rig.gravity_m_s2,
            travel=rig.travel_m,
            plane=plane,
            mid=plane - 0.5 * rig.travel_m,
            K_c=rig.force_constant_n_m2_a2,
            K_A=rig.amplifier_gain_a_v,
            T_A=rig.amplifier_time_constant_s,
            b=rig.drag_n_s_m,
            bounce=rig.restitution,
            i_max=rig.current_max_a,
            kind=KINDS.get(name, -1),
            size=float(size),
        )

    def _delays(self, n: int) -> FloatArray:
        max_steps = 2.0 * self._c.size / STEP_S if self._c.kind == JITTER else 0.0
        return np.round(self._chance.uniform(0.0, 1.0, n) * max_steps)

    def _draw_noise(self, n: int) -> FloatArray:
        return self._noise.standard_normal((n, 2)) * (self._rig.current_noise_a, self._rig.position_noise_m)

    def _run(self, signal: FloatArray, *, closed: bool) -> FloatArray:
        out = np.empty((len(signal), 5))
        self._k, self._u = run_ticks(
            self._y, self._k, self._u, closed, signal, self._law, self._memory, self._draw_noise(len(signal)),
            self._delays(len(signal)), self._c, *self._rings, out,
        )  # fmt: skip
        return out
