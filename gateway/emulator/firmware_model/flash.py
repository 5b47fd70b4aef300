"""Content of the emulated board's flash: scalings, gains, operating point, limits, identity.

Rule 1: everything the board itself works with is an integer count; the SI numbers beside it are for IDENTITY and for
        the build that computed the counts.
Rule 2: a converter's count is the nearest one, so that `offset + lsb * count` has no bias.

Gains: an LQI design for the measured CE 152 at x = 2.85 mm, in a loop sampled at 500 Hz:

    u = u_0 - K [i_c - i_0, x - x_0, x', sum of (x_ref - x) T_s]     K in V/A, V/m, V s/m, V/(m s)
    x'' = 3700 s^-2 x + 30.5 m/s^2/A i,  i = 0.297 A/V u             the rig, linearised there

K puts the fast pair at about 108 rad/s with damping 0.7, and the integral at 14 rad/s.
"""

from __future__ import annotations

import math
import struct
from dataclasses import asdict, astuple, dataclass

from gateway.emulator.firmware_model.law import Gains
from protocol.wire.mantissa import to_mantissa
from protocol.wire.messages import COUNTS_MAX, ROW_OF_NAME, Law, Value

T_S_US = 2000  # eq. (15)
TICKS_PER_S = 1_000_000 // T_S_US
CAPTURE_US = 40  # 25 kHz
CAPTURE_SIZE = 2000  # samples; 3 kB of external RAM
CAPTURE_SETTLE_US = 20_000  # u_from before the first sample
ADC_BITS = DAC_BITS = 12
FIRMWARE = (1, 4)
BUILD = b"emulated"
WATCHDOG_TICKS = 25  # 50 ms
BOOT_TICKS = 5  # 10 ms from reset to tick 0


@dataclass(frozen=True, slots=True, kw_only=True)
class ConverterScale:
    """SI value = offset + lsb * count, in the unit of the channel."""

    offset: float
    lsb: float

    def to_count(self, value: float) -> int:
        """Convert `value` to the nearest count, limited to 0..4095; NaN gives 0."""
        count = (value - self.offset) / self.lsb + 0.5
        return 0 if not count > 0 else COUNTS_MAX if count > COUNTS_MAX else math.floor(count)

    def to_si(self, count: int) -> float:
        """Convert `count` to a value in SI units."""
        return self.offset + self.lsb * count

    def span(self, distance: float) -> int:
        """Convert `distance`, in the unit of the channel, to a number of counts."""
        return round(distance / self.lsb)


# D. Honc's CE 152: sensor y = 4.92 V - 855 V/m * gap; the stops are 5.7 mm apart; the converter takes 0..5 V.
_SENSOR_V_PER_M = 855.0
_TOP_STOP_V = 4.92
_TRAVEL_M = 5.7e-3
_CODES = 1 << ADC_BITS
CURRENT = ConverterScale(offset=0.0, lsb=2.0 / _CODES)  # A: a 0..2 A input, twice what the rig ever needs
POSITION = ConverterScale(
    offset=-(_TOP_STOP_V - _SENSOR_V_PER_M * _TRAVEL_M) / _SENSOR_V_PER_M, lsb=5.0 / _CODES / _SENSOR_V_PER_M
)  # m, up from the bottom stop
INPUT = ConverterScale(offset=0.0, lsb=5.0 / _CODES)  # V


@dataclass(frozen=True, slots=True, kw_only=True)
class FlashLimits:
    """The limits of commanded values, in counts (rules 7 and 8)."""

    x_ref_min: int
    x_ref_max: int
    x_ref_step: int
    x_ref_slew: int  # counts per second
    u_max: int


@dataclass(frozen=True, slots=True, kw_only=True)
class Settings:
    """The settings that a board keeps in writable memory, in counts."""

    gains: Gains
    limits: FlashLimits

    def in_parameters(self) -> dict[str, Value]:
        """Return the fields of PARAMETERS that say gains, operating point and limits."""
        gains = self.gains
        values: dict[str, Value] = {"law": gains.law, "i_0": gains.i_0, "x_0": gains.x_0, "u_0": gains.u_0}
        for n, (mantissa, shift) in enumerate(zip(gains.mantissas, gains.shifts, strict=True), start=1):
            values |= {f"k{n}_mantissa": mantissa, f"k{n}_shift": shift}
        return values | asdict(self.limits)

    def first_bad_field(self) -> int:
        """Return the first field out of its range (rule 1), from 1 in the order of PARAMETERS; 0 if there is none."""
        values = self.in_parameters()
        fields = [field for field in ROW_OF_NAME["PARAMETERS"].fields if field.name in values]
        for n, field in enumerate(fields, start=1):
            low, high, value = field.low, field.high, values[field.name]
            if low is None or high is None or not isinstance(value, int) or not low <= value <= high:
                return n
        if self.limits.x_ref_min > self.limits.x_ref_max:
            return 1 + [field.name for field in fields].index("x_ref_max")
        return 0

    def packed(self) -> bytes:
        """Return the settings as the firmware in C stores them."""
        gains = self.gains
        values = (gains.law, *gains.shifts, *gains.mantissas, gains.i_0, gains.x_0, gains.u_0, *astuple(self.limits))
        return struct.pack("<5B4h8H", *values)


def limits_of(position: ConverterScale, x_ref_min_m: float, x_ref_max_m: float) -> FlashLimits:
    """Return the limits of a board with this sensor: references between these, jumps of 2.5 mm and 20 mm/s, any u_c."""
    return FlashLimits(
        x_ref_min=position.to_count(x_ref_min_m),
        x_ref_max=position.to_count(x_ref_max_m),
        x_ref_step=position.span(2.5e-3),
        x_ref_slew=position.span(20e-3),
        u_max=COUNTS_MAX,
    )


LIMITS = limits_of(POSITION, 0.3e-3, 5.2e-3)

K_LQI = (0.49, 1700.0, 17.7, -17600.0)
K_PID = (1700.0, 17600.0, 17.7)  # k_p V/m, k_int V/(m s), k_d V s/m
OPERATING_POINT = (0.6365, 2.85e-3, 2.143)  # i_0 A, x_0 m, u_0 V: mid-travel at rest, by the line in constants.py


def gains_in_counts(
    law: Law,
    gains_si: tuple[float, ...],
    operating_point: tuple[float, float, float],
    scales: tuple[ConverterScale, ConverterScale, ConverterScale] = (CURRENT, POSITION, INPUT),
) -> Gains:
    """Convert SI gains to the format of the board: rule 14 of protocol/README.md.

    Args:
        law: LQI or PID.
        gains_si: LQI (k_i V/A, k_x V/m, k_v V s/m, k_int V/(m s)); PID (k_p V/m, k_int V/(m s), k_d V s/m).
        operating_point: i_0 in A, x_0 in m, u_0 in V.
        scales: Of i_c, x and u_c; those of the CE 152.
    """
    current, position, input_ = scales
    per_x = position.lsb / input_.lsb
    t_s = T_S_US * 1e-6
    if law == Law.LQI:
        k_i, k_x, k_v, k_int = gains_si
        counts = (k_i * current.lsb / input_.lsb, k_x * per_x, k_v * per_x / t_s, k_int * per_x * t_s)
    else:
        k_p, k_int, k_d = gains_si
        counts = (k_p * per_x, k_int * per_x * t_s, k_d * per_x / t_s, 0.0)
    mantissas, shifts = zip(*map(to_mantissa, counts), strict=True)
    i_0_a, x_0_m, u_0_v = operating_point
    return Gains(
        law=law, mantissas=mantissas, shifts=shifts, i_0=current.to_count(i_0_a), x_0=position.to_count(x_0_m),
        u_0=input_.to_count(u_0_v),
    )  # fmt: skip


GAINS = gains_in_counts(Law.LQI, K_LQI, OPERATING_POINT)


@dataclass(frozen=True, slots=True, kw_only=True)
class BoardProfile:
    """The data of one rig's board: scalings, gains, limits, and the parts between pins and counts.

    Here the pins carry i_c in A, x in m and u_c in V, and the converters are linear.  A board whose converters are not
    has a profile of its own, which puts tables between them and the counts.
    """

    current: ConverterScale
    position: ConverterScale
    input: ConverterScale
    limits: FlashLimits
    gains: Gains
    build: bytes
    adc_bits: int = ADC_BITS
    program: str = ""  # header of firmware/avr with the same numbers; none: those of the program itself

    @property
    def settings(self) -> Settings:
        """The gains, operating point and limits."""
        return Settings(gains=self.gains, limits=self.limits)

    @property
    def scalings(self) -> bytes:
        """The scalings as the firmware in C stores them."""
        scales = (self.current, self.position, self.input)
        return struct.pack("<6f", *(number for scale in scales for number in (scale.offset, scale.lsb)))

    def identity(self, board_id: int, adc_bits: int) -> bytes:
        """Return the identity of a board as the firmware in C stores it."""
        return struct.pack("<I4B24s8s", board_id, *FIRMWARE, adc_bits, DAC_BITS, self.scalings, self.build.ljust(8)[:8])

    def pin(self, *, current: bool) -> ConverterScale:
        """Return what a code of the converter of i_c, or of x, is worth on its pin."""
        return self.current if current else self.position

    def current_count(self, pin: float) -> int:
        """Return the count of i_c."""
        return self.current.to_count(pin)

    def position_count(self, pin: float) -> int:
        """Return the count of x."""
        return self.position.to_count(pin)

    def input_pin(self, count: int) -> float:
        """Return what a count of u_c puts on its pin."""
        return self.input.to_si(count)

    def adc_code(self, pin: float, *, current: bool) -> int:
        """Return what a converter of 10 bits makes of a pin: that of i_c, or that of x."""
        count = self.current.to_count(pin) if current else self.position.to_count(pin)
        return (count * 1023 + 2047) // COUNTS_MAX  # the nearest

    def dac_pin(self, code: int) -> float:
        """Return what a code of the input converter puts on its pin."""
        return self.input.to_si(code)


CE152_BOARD = BoardProfile(current=CURRENT, position=POSITION, input=INPUT, limits=LIMITS, gains=GAINS, build=BUILD)
