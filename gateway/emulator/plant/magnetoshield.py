"""The emulated MagnetoShield (R3, R4): a permanent magnet below a coil, a Hall sensor below the magnet.

    plant = EmulatedMagnetoShield(seed=1)
    plant.advance(1450.0, 0.002)       # one tick with this code in the MCP4725
    i_v, hall_v = plant.sense()        # what the pins A2 and A3 carry, with noise

Constants, and where they are from, are in firmware/magnetoshield.md.  In short:

    coil       L i' = u - R i                                   R = 194.9 ohm, L = 0.1022 H
    magnet     m v' = K i / y^4 - m g - b v,  y = gap           K = 1.508e-8 N m^4/A
    sensor     G(y) = (y / 3.2331 mm)^(1 / 0.220571) + h i      Hall sensor, in gauss; h: the coil's own field there
    pins       A3 = 2.5 V - G / (800 G/V),  A2 = i / (33.33 mA/V)
    driver     code = 1.4135 u^3 - 15.407 u^2 + 389.27 u - 11.761   code of the MCP4725 for the coil's voltage u

Rule 1: force, coil and effects are those of `physics.py`, with a permanent magnet and the power 4 of the gap.
Rule 2: effects on the position sensor act on x before the field is computed: a lag or an offset of the real position.
        Their named strengths (weak, medium, strong) are those of the CE 152.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from gateway.emulator.plant.constants import PlantConstants
from gateway.emulator.plant.levitation import NO_EFFECTS, EmulatedPlant

GAP_BOTTOM_M = 17e-3  # coil to the top of the magnet that lies on the ground
_TRAVEL_M = 5e-3
_RESISTANCE_OHM = 194.878
_INDUCTANCE_H = 0.102154
_FORCE_N_M4_A = 1.50849e-8
_MASS_KG = 7.34483e-4
_GAP_MID_M = GAP_BOTTOM_M - _TRAVEL_M / 2.0
_MAGNET_A = 1.0  # any: only its product with K_c shows
_CURVE_MM, _CURVE_POWER = 3.2331, 0.220571
_COIL_GAUSS_A = 108.0  # h
_HALL_NOISE_GAUSS = 1.0
_HALL_ZERO_V, _HALL_GAUSS_V = 2.5, 800.0
_CURRENT_A_V = 33.3333e-3
_DRIVER = (1.41353993, -15.4070873, 389.266686, -11.7613432)
_PIN_MAX_V = 3.3  # Zener diodes

MAGNETOSHIELD = PlantConstants(
    mass_kg=_MASS_KG,
    travel_m=_TRAVEL_M,
    gravity_m_s2=9.81,
    force_constant_n_m2_a2=_FORCE_N_M4_A / _GAP_MID_M**2 / _MAGNET_A,
    coil_plane_above_stop_m=GAP_BOTTOM_M - _TRAVEL_M,
    amplifier_gain_a_v=1.0 / _RESISTANCE_OHM,
    amplifier_time_constant_s=_INDUCTANCE_H / _RESISTANCE_OHM,
    drag_n_s_m=64.93 * _MASS_KG,
    restitution=0.3,  # assumed
    input_max_v=10.65,
    current_max_a=0.11,
    position_noise_m=0.0,  # the sensor's noise is in gauss
    current_noise_a=5e-5,  # assumed: half a count of 10 bits
    force_exponent=4.0,
    magnet_current_a=_MAGNET_A,
)
_VOLTS = np.linspace(0.0, MAGNETOSHIELD.input_max_v, 1001)
_CODES = np.maximum.accumulate(np.clip(np.polyval(_DRIVER, _VOLTS), 0.0, None))


class EmulatedMagnetoShield(EmulatedPlant):
    """An emulated MagnetoShield, initially at rest: magnet on the ground, no current.

    Its arguments and errors are those of `EmulatedPlant`.
    """

    def __init__(
        self, rig: PlantConstants = MAGNETOSHIELD, effects: Mapping[str, float] = NO_EFFECTS, *, seed: int = 0
    ) -> None:
        self._hall_noise = np.random.default_rng([seed, 0xA3])
        super().__init__(rig, effects, seed=seed)

    def advance(self, u_v: float, duration_s: float) -> None:
        """Advance the physical time with `u_v` in the input converter: its CODE, 0 .. 4095, not volts.

        Raises:
            UsageError: as of `EmulatedPlant`.
        """
        # Inverted by a table, not by a root of the cubic at each tick: its codes rise, so each has one voltage.
        volts = float(np.interp(u_v, _CODES, _VOLTS)) if u_v > 0.0 else 0.0
        super().advance(volts, duration_s)

    def sense(self) -> tuple[float, float]:
        """Return what the pins carry, V: A2, the amplified current, and A3, the Hall sensor."""
        i_true, x = self._sensed[(self._steps - self._sensing_delay) % len(self._sensed)]
        i_read, _ = super().sense()
        gap_mm = max((GAP_BOTTOM_M - float(x)) * 1e3, 0.0)
        gauss = (gap_mm / _CURVE_MM) ** (1.0 / _CURVE_POWER) + _COIL_GAUSS_A * float(i_true)
        gauss += _HALL_NOISE_GAUSS * float(self._hall_noise.standard_normal())
        return _clipped(i_read / _CURRENT_A_V), _clipped(_HALL_ZERO_V - gauss / _HALL_GAUSS_V)


def _clipped(volts: float) -> float:
    return min(max(volts, 0.0), _PIN_MAX_V)
