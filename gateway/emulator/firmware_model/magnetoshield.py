"""The board of a MagnetoShield (R3, R4) on an Arduino Uno: scalings, gains, limits, and the tables of its converters.

IDENTITY's scalings are linear, and neither the Hall sensor nor the coil's driver is.  So two tables of 65 entries, with
straight lines between them, convert.  One turns codes of the converter of A3 into counts of x.  The other turns counts
of u_c into codes of the MCP4725.  They are made here from a calibration (`_x_m`, `DRIVER`);
`firmware/avr/magnetoshield.h` holds the same numbers for the chip.  firmware/magnetoshield.md has their origin.

Gains: linearised at x = 2.5 mm the magnet has x'' = 2706 s^-2 x - 65 s^-1 x' + 2.39 m/s^2/V u.  K puts the fast pair at
about 90 rad/s with damping 0.8 and the integral at 10 rad/s, in a loop sampled at 500 Hz.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from gateway.emulator.firmware_model.flash import (
    DAC_BITS,
    FIRMWARE,
    BoardProfile,
    ConverterScale,
    gains_in_counts,
    limits_of,
)
from protocol.wire.messages import COUNTS_MAX, Law

_ADC_BITS = 10
_ADC_MAX = 1023
_REFERENCE_V = 3.3  # AREF
_AMPERE_PER_V = 1.0 / 30.0  # of the current amplifier
DRIVER = (1.41353993, -15.4070873, 389.266686, -11.7613432)  # code = d3 u^3 + d2 u^2 + d1 u + d0, u in V
_HALL_ZERO_V, _HALL_GAUSS_V = 2.5, 800.0
_CURVE_MM, _CURVE_POWER = 3.2331, 0.220571  # gap in mm = _CURVE_MM * (field in gauss)^_CURVE_POWER
_SEGMENTS = 64
_ADC_STEP, _INPUT_STEP = 1024 // _SEGMENTS, 4096 // _SEGMENTS
_GAP_BOTTOM_MM = 17.0  # coil to the magnet on the ground, x = 0

CURRENT = ConverterScale(offset=0.0, lsb=_REFERENCE_V * _AMPERE_PER_V / 4096.0)
POSITION = ConverterScale(offset=-0.25e-3, lsb=6.25e-3 / 4096.0)
INPUT = ConverterScale(offset=0.0, lsb=10.0 / 4096.0)
LIMITS = limits_of(POSITION, 0.5e-3, 4.5e-3)
K_LQI = (30.0, 5200.0, 38.0, -39000.0)
OPERATING_POINT = (0.02112, 2.5e-3, 4.115)  # i_0 = m g y^4 / K at a gap y of 14.5 mm, x_0, u_0 = R i_0


def _x_m(hall_v: float) -> float:
    """Return x at a voltage of the Hall sensor, up from the ground; infinite where the field is not the magnet's."""
    gauss = (_HALL_ZERO_V - hall_v) * _HALL_GAUSS_V
    return (_GAP_BOTTOM_MM - _CURVE_MM * gauss**_CURVE_POWER) * 1e-3 if gauss > 0.0 else math.inf


def position_table() -> tuple[int, ...]:
    """The counts of x at each 16th code of the converter, 0 to 1024."""
    return tuple(POSITION.to_count(_x_m(code * _REFERENCE_V / (_ADC_MAX + 1))) for code in range(0, 1025, _ADC_STEP))


def input_table() -> tuple[int, ...]:
    """The codes of the input converter at each 64th count of u_c, 0 to 4096; 0 at 0, so that the coil can be off."""
    d3, d2, d1, d0 = DRIVER
    volts = (INPUT.lsb * count for count in range(0, 4097, _INPUT_STEP))
    codes = [min(max(round(((d3 * u + d2) * u + d1) * u + d0), 0), COUNTS_MAX) for u in volts]
    return (0, *codes[1:])


def between(table: tuple[int, ...], at: int, bits: int) -> int:
    """The table at `at`, entries 2^bits apart: a straight line, rounded down."""
    low, high = table[at >> bits], table[(at >> bits) + 1]
    return low + ((high - low) * (at & (1 << bits) - 1) >> bits)


@dataclass(frozen=True, slots=True, kw_only=True)
class MagnetoShieldProfile(BoardProfile):
    """Volts at A2 and A3 and codes of the MCP4725 on the pins; tables between them and the counts."""

    positions: tuple[int, ...]
    inputs: tuple[int, ...]

    def pin(self, *, current: bool) -> ConverterScale:
        """Return what a code of the converter is worth on both pins, V."""
        return ConverterScale(offset=0.0, lsb=_REFERENCE_V / (_ADC_MAX + 1))

    def adc_code(self, pin: float, *, current: bool) -> int:
        """Return the code of the converter for a pin, V."""
        return min(max(math.floor(pin / _REFERENCE_V * (_ADC_MAX + 1) + 0.5), 0), _ADC_MAX)

    def current_count(self, pin: float) -> int:
        """Return the count of i_c."""
        code = self.adc_code(pin, current=True)
        return code << 2 | code >> 8

    def position_count(self, pin: float) -> int:
        """Return the count of x."""
        return between(self.positions, self.adc_code(pin, current=False), 4)

    def input_pin(self, count: int) -> float:
        """Return the code of the input converter."""
        return float(between(self.inputs, count, 6))

    def dac_pin(self, code: int) -> float:
        """Return the code as it is."""
        return float(code)


def magnetoshield() -> MagnetoShieldProfile:
    """The profile with the calibration of the examples."""
    return MagnetoShieldProfile(
        current=CURRENT, position=POSITION, input=INPUT, limits=LIMITS,
        gains=gains_in_counts(Law.LQI, K_LQI, OPERATING_POINT, (CURRENT, POSITION, INPUT)),
        build=b"magneto", adc_bits=_ADC_BITS, program="magnetoshield.h",
        positions=position_table(), inputs=input_table(),
    )  # fmt: skip


def header(profile: MagnetoShieldProfile) -> str:
    """The profile as the C header that `firmware/avr/store.c` and `hardware.c` include."""
    gains, limits = profile.gains, profile.limits
    numbers = (limits.x_ref_min, limits.x_ref_max, limits.x_ref_step, limits.x_ref_slew, limits.u_max)
    return "\n".join(
        (
            "/* A MagnetoShield (R3, R4), by gateway/emulator/firmware_model/magnetoshield.py, `header`; numbers",
            " * are explained there and in ../magnetoshield.md. */",
            f"#define B51_PROFILE_FIRMWARE {FIRMWARE[0]}, {FIRMWARE[1]}, {profile.adc_bits}, {DAC_BITS}",
            "#define B51_PROFILE_SCALINGS \\",
            _rows([f"0x{byte:02X}" for byte in profile.scalings], 8),
            f"#define B51_PROFILE_GAINS {int(gains.law)}, {_braced(gains.shifts)}, {_braced(gains.mantissas)}, "
            f"{gains.i_0}, {gains.x_0}, {gains.u_0}",
            f"#define B51_PROFILE_LIMITS {', '.join(map(str, numbers))}",
            "/* Counts of x at each 16th code of A3. */",
            "#define B51_POSITION_TABLE \\",
            _rows([str(entry) for entry in profile.positions], 13),
            "/* Codes of the MCP4725 at each 64th count of u_c. */",
            "#define B51_INPUT_TABLE \\",
            _rows([str(entry) for entry in profile.inputs], 13),
            "",
        )
    )


def _braced(numbers: tuple[int, ...]) -> str:
    return "{" + ", ".join(map(str, numbers)) + "}"


def _rows(numbers: list[str], width: int) -> str:
    rows = [", ".join(numbers[at : at + width]) for at in range(0, len(numbers), width)]
    return ", \\\n".join(f"    {row}" for row in rows)
