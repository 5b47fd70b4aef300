"""The second rig of `second_plant.py` under its own board: signals, law, converters and recordings."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from gateway.emulator.plant.constants import PlantConstants
from tests.harness.diagnose.hidden_campaign import (
    CAPTURE_COUNT,
    MIDDLE_M,
    Signal,
    designed_gains,
)
from tests.harness.diagnose.second_plant import (
    COIL,
    HELD,
    INPUT_DAC,
    POSITION_ADC,
    QV,
    RING,
    STEP_S,
    TICK_S,
    F,
    FloatArray,
    H,
    Numbers,
    Q,
    S,
    V,
    X,
    capture_samples,
    reading,
    run_ticks,
)


class SecondBench:
    """The second rig under its own board; a `hidden_campaign.Bench`.

    Args:
        rig: Its numbers.
        effects: Strength by name of the catalogue's effects.
        seed: Of noise and of what in an effect is the rig's own.
        believed: The rig that the law was designed for.
        outside: Strength by name of `outside.OUTSIDE`.
    """

    def __init__(
        self,
        rig: PlantConstants,
        effects: Mapping[str, float],
        *,
        seed: int,
        believed: PlantConstants,
        outside: Mapping[str, float] | None = None,
    ) -> None:
        self._rig, self._believed = rig, believed
        self._seed, noise, chance = np.random.SeedSequence([22, seed]).spawn(3)
        self._noise, self._chance = np.random.default_rng(noise), np.random.default_rng(chance)
        self._outside = dict(outside or {})
        self._bit_error_rate = self._outside.pop("bit-errors", 0.0)
        self.change(effects)
        self._k, self._u = 0, 0.0
        self._good = 1.0
        self._y = np.zeros(12)
        self._rings = (np.zeros(RING), np.zeros(RING), np.zeros(RING))
        self._law = np.array(
            [
                *designed_gains(believed),
                believed.equilibrium_current_a(MIDDLE_M),
                MIDDLE_M,
                believed.equilibrium_input_v(MIDDLE_M),
            ]
        )
        self._memory = np.zeros(3)
        self._start_at(0.0, 0.0)

    def idle(self, ticks: int) -> FloatArray:
        return self._run(np.zeros(ticks), closed=False)

    def open_loop(self, signal: Signal, ticks: int) -> FloatArray:
        return self._run(np.clip(on_grid(wave(signal, ticks), INPUT_DAC), 0.0, 5.0), closed=False)

    def fly(self, x_m: float) -> None:
        self._start_at(x_m, self._believed.equilibrium_current_a(x_m))
        self._u = self._believed.equilibrium_input_v(x_m)
        self._memory[:] = 0.0

    def closed_loop(self, signal: Signal, ticks: int) -> FloatArray:
        return self._run(on_grid(wave(signal, ticks), POSITION_ADC), closed=True)

    def capture(self, u_from_v: float, u_to_v: float) -> FloatArray:
        out = np.empty((CAPTURE_COUNT, 3))
        u_from, u_to = (float(on_grid(np.array([u]), INPUT_DAC)[0]) for u in (u_from_v, u_to_v))
        held = self._y[HELD]
        self._k = capture_samples(
            self._y, self._k, u_from, u_to, self._draw_noise(CAPTURE_COUNT), self._c, *self._rings, out
        )
        self._y[HELD] = held
        self._run(np.zeros(1), closed=False)  # back on the grid of ticks, coil off
        return out

    def change(self, effects: Mapping[str, float]) -> None:
        self._loss = effects.get("lost-samples", 0.0)
        self._c = numbers(self._rig, effects, self._outside, np.random.default_rng(self._seed))

    def _start_at(self, x_m: float, i_a: float) -> None:
        y = self._y
        y[COIL] = y[F] = y[H] = i_a
        y[X], y[V], y[Q], y[QV] = x_m, 0.0, 0.0, 0.0
        y[S] = y[HELD] = reading(x_m, i_a, self._k * STEP_S, self._c)
        self._rings[1][:], self._rings[2][:] = i_a, y[S]

    def _draw_noise(self, n: int) -> FloatArray:
        return self._noise.standard_normal((n, 2)) * (self._rig.current_noise_a, self._rig.position_noise_m)

    def _run(self, signal: FloatArray, *, closed: bool) -> FloatArray:
        n = len(signal)
        out = np.empty((n, 5))
        hit = self._chance.random(n) < self._bit_error_rate
        wrong_bit = np.where(hit, 2.0 ** self._chance.integers(4, 9, n), 0.0)
        # A loose contact changes its mind every 0.4 s on average.
        flips = np.cumsum(self._chance.random(n) < TICK_S / 0.4)
        good = (flips + (1.0 - self._good)) % 2 == 0 if self._c.contact else np.ones(n, np.bool_)
        self._good = float(good[-1])
        self._k, self._u = run_ticks(
            self._y,
            self._k,
            self._u,
            closed,
            signal,
            self._law,
            self._memory,
            self._draw_noise(n),
            wrong_bit,
            good.astype(float),
            self._c,
            *self._rings,
            out,
        )
        retained = self._chance.random(n) >= self._loss
        return out[retained]


def numbers(
    rig: PlantConstants, effects: Mapping[str, float], outside: Mapping[str, float], rng: np.random.Generator
) -> Numbers:
    """The constants of the equations; `rng` draws what is the rig's own."""
    unknown = set(effects) - NAMES
    assert not unknown, unknown

    def strength(name: str, neutral: float = 0.0) -> float:
        return float(effects.get(name, neutral))

    heating_s, shake_hz, shake_phase = rng.uniform(20.0, 45.0), rng.uniform(5.0, 11.0), rng.uniform(0.0, 2.0 * math.pi)
    saturation = strength("core-saturation", math.inf)
    plane = rig.travel_m + rig.coil_plane_above_stop_m
    return Numbers(
        m=rig.mass_kg,
        g=rig.gravity_m_s2,
        travel=rig.travel_m,
        plane=plane + strength("air-gap-offset"),
        gap_mid=plane - 0.5 * rig.travel_m,
        K_c=rig.force_constant_n_m2_a2,
        K_A=rig.amplifier_gain_a_v,
        T_A=rig.amplifier_time_constant_s,
        b=rig.drag_n_s_m,
        bounce=rig.restitution,
        i_max=min(rig.current_max_a, strength("current-limit", math.inf)),
        loss=strength("amplifier-gain-drift"),
        heating_s=float(heating_s),
        slew=strength("slew-rate-limit", math.inf),
        dead_zone=strength("amplifier-dead-zone"),
        amplifier_offset=strength("amplifier-offset"),
        growth=strength("position-dependent-inductance"),
        emf=strength("motional-emf"),
        delay_steps=round(strength("actuation-delay") / STEP_S),
        exponent=strength("force-exponent", 2.0),
        saturation=saturation * math.sqrt(2.0 / 3.0) if math.isfinite(saturation) else 0.0,
        residual=strength("residual-magnetism"),
        eddy=strength("eddy-current-lag"),
        drag2=strength("quadratic-drag"),
        friction=strength("coulomb-friction"),
        force=strength("constant-force"),
        shake=strength("periodic-disturbance"),
        shake_hz=float(shake_hz),
        shake_phase=float(shake_phase),
        x_offset=strength("position-sensor-offset"),
        x_gain=strength("position-sensor-gain", 1.0),
        bow=strength("position-sensor-nonlinearity"),
        x_lag=strength("position-sensor-lag"),
        crosstalk=strength("sensor-crosstalk"),
        i_offset=strength("current-sensor-offset"),
        i_gain=strength("current-sensor-gain", 1.0),
        sampling_steps=round(strength("sampling-delay") / STEP_S),
        hysteresis=outside.get("force-hysteresis", 0.0),
        loop=outside.get("force-loop", 0.0),
        stick=outside.get("sensor-sticks", 0.0),
        warm_up=outside.get("sensor-warm-up", 0.0),
        wire=outside.get("wire-spring", 0.0),
        resonance=outside.get("lateral-resonance", 0.0),
        ripple=outside.get("supply-ripple", 0.0),
        patch=outside.get("friction-patch", 0.0),
        contact=outside.get("loose-contact", 0.0),
        spring=outside.get("spring-of-a-cable", 0.0),
        sag=outside.get("supply-sag", 0.0),
        hum=outside.get("sensor-hum", 0.0),
        octave=outside.get("sensor-hum-octave", 0.0),
        shake_octave=outside.get("shake-octave", 0.0),
        film=outside.get("squeeze-film", 0.0),
        i_bow=outside.get("current-bow", 0.0),
    )


NAMES = frozenset(
    "amplifier-gain-drift current-limit slew-rate-limit amplifier-dead-zone amplifier-offset"
    " position-dependent-inductance motional-emf actuation-delay air-gap-offset force-exponent core-saturation"
    " residual-magnetism eddy-current-lag quadratic-drag coulomb-friction constant-force periodic-disturbance"
    " position-sensor-offset position-sensor-gain position-sensor-nonlinearity position-sensor-lag sensor-crosstalk"
    " current-sensor-offset current-sensor-gain sampling-delay lost-samples".split()
)


def on_grid(values: FloatArray, converter: tuple[float, float]) -> FloatArray:
    """Values that the converter can hold."""
    offset, lsb = converter
    return np.asarray(offset + lsb * np.round((values - offset) / lsb))


def wave(signal: Signal, ticks: int) -> FloatArray:
    """The signal tick by tick, in its own unit, shape (ticks,)."""
    s = np.arange(ticks)
    rng = np.random.default_rng([33, signal.seed])
    phase = (s % signal.period) / signal.period
    if signal.shape == "rectangle":
        shape = np.where(phase < 0.5, 1.0, -1.0)
    elif signal.shape == "sawtooth":
        shape = 2.0 * phase - 1.0
    elif signal.shape == "prbs":
        shape = rng.choice((-1.0, 1.0), ticks // signal.period + 1)[s // signal.period]
    elif signal.shape == "multisine":
        grid = np.arange(signal.period) / signal.period
        phases = rng.uniform(0.0, 1.0, 8)
        period = sum(np.sin(2.0 * math.pi * (h * grid + phases[h - 1])) for h in range(1, 9))
        shape = (period / np.max(np.abs(period)))[s % signal.period]
    else:
        shape = np.zeros(ticks)
    return np.asarray(signal.offset + signal.amplitude * shape)
