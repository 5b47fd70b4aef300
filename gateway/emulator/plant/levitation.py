"""The emulated rig as seen by a board: one input, two analog sensor readings.

    plant = EmulatedPlant(effects={"quadratic-drag": 1.0}, seed=1)
    plant.advance(3.5, 0.002)          # one tick with u_c = 3.5 V
    i_c_a, x_m = plant.sense()         # with noise, before the converters

Rule 1: physical time moves only in `advance`, in steps of 20 us; a tick is 100 of them, a capture sample 2.
Rule 2: all randomness comes from `seed`.  Sensor noise and lost frames have generators of their own, so that they do
        not affect each other.  The trajectory itself is not random.
Rule 3: the plant never prints or logs its effects: they may be secret.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from types import MappingProxyType

import numpy as np

from gateway.emulator.plant.constants import CE152, PlantConstants
from gateway.emulator.plant.effects import DISTURBANCE_FREQUENCY_HZ, HEATING_TIME_CONSTANT_S, MAX_DELAY_S, check
from gateway.emulator.plant.physics import Constants, PlantState, advance, reading
from protocol.errors import UsageError

STEP_S = 20e-6  # divides the tick (2 ms) and the capture period (40 us)
_DRAWN = 64  # pairs of noise at a time
NO_EFFECTS: Mapping[str, float] = MappingProxyType({})


class EmulatedPlant:
    """An emulated rig, initially at rest: ball on the bottom stop, no current, coil cold.

    Effects have their strength by name (`effects.EFFECTS`); one that is not named is absent.

    Raises:
        UsageError: an unknown effect, or a strength out of its range or impossible on this rig.
    """

    def __init__(
        self,
        rig: PlantConstants = CE152,
        effects: Mapping[str, float] = NO_EFFECTS,
        *,
        seed: int = 0,
        step_s: float = STEP_S,
    ) -> None:
        self.rig = rig
        self.step_s = step_s
        # Two generators, not one: a lost frame would otherwise change all noise after it.
        noise, loss = np.random.SeedSequence(seed).spawn(2)
        self._noise = _pairs(np.random.default_rng(noise))
        self._loss = np.random.default_rng(loss)
        self._steps = 0
        length = round(MAX_DELAY_S / step_s) + 1
        self._inputs = np.zeros(length)
        self._sensed = np.zeros((length, 2))
        self.set_effects(effects)
        self.set_state(0.0)
        self.advance(0.0, 0.0)  # compiles now, so that the first tick is not delayed

    @property
    def time_s(self) -> float:
        """The physical time since the start."""
        return self._steps * self.step_s

    @property
    def i_c_a(self) -> float:
        """The true coil current."""
        return self._state.i

    @property
    def x_m(self) -> float:
        """The true position, up from the sensor."""
        return self._state.x

    @property
    def v_m_s(self) -> float:
        """The true speed, up."""
        return self._state.v

    def set_effects(self, effects: Mapping[str, float]) -> None:
        """Replace all effects from now on; state and time continue.

        Raises:
            UsageError: as in the constructor.
        """
        rig, strength = self.rig, check(effects)
        if rig.coil_plane_above_stop_m + strength["air-gap-offset"] < 1e-4:
            raise UsageError(
                f"Effect air-gap-offset: d = {strength['air-gap-offset']:g} m puts the coil's plane into the travel",
                remedy=f"Give more than {1e-4 - rig.coil_plane_above_stop_m:g} m on this rig",
            )
        self._constants = _constants(rig, strength, self.step_s)
        self._sensing_delay = round(strength["sampling-delay"] / self.step_s)
        self._current_gain = strength["current-sensor-gain"]
        self._current_offset = strength["current-sensor-offset"]
        self._loss_probability = strength["lost-samples"]

    def reverse_coil(self, reversed_: bool) -> None:
        """Swap the coil's wires, or put them right: a permanent magnet is pushed then; a ball is pulled either way."""
        if self.rig.magnet_current_a > 0.0:
            strength = abs(self._constants.K_c)
            self._constants = self._constants._replace(K_c=-strength if reversed_ else strength)

    def set_state(self, x_m: float, *, v_m_s: float = 0.0, i_c_a: float = 0.0) -> None:
        """Set position and speed of the ball and the current, with lags and delays in steady state, coil cold.

        Raises:
            UsageError: x is outside the travel, the current is negative, or a value is not a number.
        """
        if not (0.0 <= x_m <= self.rig.travel_m and 0.0 <= i_c_a <= self.rig.current_max_a and math.isfinite(v_m_s)):
            raise UsageError(
                f"The ball cannot be placed at x = {x_m} m, v = {v_m_s} m/s with i_c = {i_c_a} A",
                remedy=f"Give x within 0 .. {self.rig.travel_m} m, i_c within 0 .. {self.rig.current_max_a} A",
            )
        s = reading(x_m, i_c_a, self._constants)
        self._state = PlantState(i=i_c_a, f=i_c_a, x=x_m, v=v_m_s, w=0.0, s=s)
        self._sensed[:] = i_c_a, s

    def advance(self, u_v: float, duration_s: float) -> None:
        """Advance the physical time by `duration_s` with the input held.

        Args:
            u_v: Input voltage; the amplifier limits it to 0 .. input_max_v.
            duration_s: A multiple of `step_s`, not negative.

        Raises:
            UsageError: the input is not a number, or the duration is not such a multiple.
        """
        count = round(duration_s / self.step_s) if math.isfinite(duration_s) else -1
        if count < 0 or abs(count * self.step_s - duration_s) > 1e-3 * self.step_s or math.isnan(u_v):
            problem = f"The plant cannot advance by {duration_s} s with u = {u_v} V"
            raise UsageError(problem, remedy=f"Give a number of volts and a multiple of {self.step_s:g} s")
        u = min(max(float(u_v), 0.0), self.rig.input_max_v)
        self._state = PlantState(
            *advance(
                tuple(self._state),
                self._steps,
                count,
                self.step_s,
                u,
                tuple(self._constants),
                self._inputs,
                self._sensed,
            )
        )
        self._steps += count

    def sense(self) -> tuple[float, float]:
        """Return the current sensor readings (i_c in A, x in m), with effects and new noise."""
        row = (self._steps - self._sensing_delay) % len(self._sensed)
        i, x = self._sensed.item(row, 0), self._sensed.item(row, 1)
        noise_i, noise_x = next(self._noise)
        return (
            self._current_gain * i + self._current_offset + self.rig.current_noise_a * noise_i,
            x + self.rig.position_noise_m * noise_x,
        )

    def drop_sample(self) -> bool:
        """Return whether the state frame of this tick is lost (effect lost-samples); call it once per frame."""
        return self._loss_probability > 0.0 and self._loss.random() < self._loss_probability


def _pairs(generator: np.random.Generator) -> Iterator[list[float]]:
    """Yield pairs of normal numbers: those that single draws would give, in a fraction of their time."""
    while True:
        yield from generator.standard_normal((_DRAWN, 2)).tolist()


def _constants(rig: PlantConstants, strength: Mapping[str, float], step_s: float) -> Constants:
    return Constants(
        mass=rig.mass_kg, travel=rig.travel_m, weight=rig.mass_kg * rig.gravity_m_s2, restitution=rig.restitution,
        # Amplifier.
        K_A=rig.amplifier_gain_a_v, T_A=rig.amplifier_time_constant_s,
        current_max=min(rig.current_max_a, strength["current-limit"]),
        gain_loss=strength["amplifier-gain-drift"], heating_time=HEATING_TIME_CONSTANT_S,
        slew=strength["slew-rate-limit"], dead_zone=strength["amplifier-dead-zone"],
        current_offset=strength["amplifier-offset"], inductance_growth=strength["position-dependent-inductance"],
        emf=strength["motional-emf"], input_delay=round(strength["actuation-delay"] / step_s),
        # Force.
        K_c=rig.force_constant_n_m2_a2, magnet=rig.magnet_current_a, gap_mid=rig.gap_m(rig.travel_m / 2.0),
        gap_bottom=rig.gap_m(0.0) + strength["air-gap-offset"],
        exponent=strength["force-exponent"] + rig.force_exponent - 2.0,
        inverse_saturation=1.0 / strength["core-saturation"],
        residual=strength["residual-magnetism"], eddy=strength["eddy-current-lag"],
        # Motion.
        b=rig.drag_n_s_m, drag2=strength["quadratic-drag"], friction=strength["coulomb-friction"],
        force=strength["constant-force"], shake=strength["periodic-disturbance"],
        shake_omega=2.0 * math.pi * DISTURBANCE_FREQUENCY_HZ,
        # Sensing.
        x_offset=strength["position-sensor-offset"], x_gain=strength["position-sensor-gain"],
        x_bow=strength["position-sensor-nonlinearity"], x_lag=strength["position-sensor-lag"],
        crosstalk=strength["sensor-crosstalk"],
    )  # fmt: skip
