"""The board's number formats: gains as 16-bit mantissas, 12-bit converters (protocol/README.md, rules 9, 14)."""

from __future__ import annotations

import math
from dataclasses import dataclass

from protocol.errors import UsageError
from protocol.wire.mantissa import MANTISSA_MAX, to_mantissa
from twin.control_design.gains import Law


@dataclass(frozen=True, slots=True, kw_only=True)
class Converters:
    """The size of one count of each signal; defaults: a CE 152 with 12 bits over 0..2 A, 0..5 V at 855 V/m, 0..5 V."""

    i_lsb_a: float = 2.0 / 4096
    x_lsb_m: float = 5.0 / 4096 / 855.0
    u_lsb_v: float = 5.0 / 4096

    def __post_init__(self) -> None:
        for name in ("i_lsb_a", "x_lsb_m", "u_lsb_v"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0.0):
                raise UsageError(f"{name} = {value:g}", remedy="Give the size of one count, a positive number")


@dataclass(frozen=True, slots=True, kw_only=True)
class QuantisedGain:
    """A gain as mantissa * 2^-shift counts of u per count, and its value in the unit of the gain."""

    mantissa: int
    shift: int
    value: float


def quantise(
    gains: tuple[float, float, float, float], law: Law, converters: Converters, sample_time_s: float
) -> tuple[QuantisedGain, ...]:
    """The four gains as the board stores them.

    Args:
        gains: in the order of `law`, SI units.
        law: of the board.
        converters: size of one count of each signal.
        sample_time_s: T_s, s.

    Raises:
        UsageError: a gain is above the largest of the format.
    """
    c = converters
    proportional = c.x_lsb_m / c.u_lsb_v
    speed, integral = proportional / sample_time_s, proportional * sample_time_s
    # In counts: a speed is a difference of counts per tick, an integral a sum of counts.
    per_count = (
        (c.i_lsb_a / c.u_lsb_v, proportional, speed, integral) if law == "lqi" else (proportional, integral, speed, 1.0)
    )
    result = []
    for n, (gain, unit) in enumerate(zip(gains, per_count, strict=True), 1):
        try:
            mantissa, shift = to_mantissa(gain * unit)
        except OverflowError:
            raise UsageError(
                f"gain {n} = {gain:g} is above {MANTISSA_MAX / unit:g}, the board's largest",
                remedy="Increase R, or decrease the weights Q",
            ) from None
        result.append(QuantisedGain(mantissa=mantissa, shift=shift, value=mantissa * 2.0**-shift / unit))
    return tuple(result)


def from_order_of(law: Law, gains: tuple[float, ...]) -> tuple[float, float, float, float]:
    """Return [k_i, k_x, k_v, k_int] from the four numbers of SET_GAINS; the inverse of `gains.in_order_of`."""
    if law == "pid":
        return 0.0, gains[0], gains[2], -gains[1]
    return gains[0], gains[1], gains[2], gains[3]
