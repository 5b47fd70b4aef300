"""Check of the stored settings at boot: rule 1 of protocol/README.md."""

from __future__ import annotations

from dataclasses import asdict

from gateway.emulator.firmware_model.flash import FlashLimits, Settings
from gateway.emulator.firmware_model.law import Gains
from protocol.wire.messages import ROW_OF_NAME, Value


def in_parameters(gains: Gains, limits: FlashLimits) -> dict[str, Value]:
    """Return the fields of PARAMETERS that say gains, operating point and limits."""
    values: dict[str, Value] = {"law": gains.law, "i_0": gains.i_0, "x_0": gains.x_0, "u_0": gains.u_0}
    for n, (mantissa, shift) in enumerate(zip(gains.mantissas, gains.shifts, strict=True), start=1):
        values |= {f"k{n}_mantissa": mantissa, f"k{n}_shift": shift}
    return values | asdict(limits)


def first_bad_field(settings: Settings) -> int:
    """Return the first field out of its range, counted from 1 in the order of PARAMETERS; 0 if there is none."""
    values = in_parameters(settings.gains, settings.limits)
    fields = [field for field in ROW_OF_NAME["PARAMETERS"].fields if field.name in values]
    for n, field in enumerate(fields, start=1):
        low, high, value = field.low, field.high, values[field.name]
        if low is None or high is None or not isinstance(value, int) or not low <= value <= high:
            return n
    if settings.limits.x_ref_min > settings.limits.x_ref_max:
        return 1 + [field.name for field in fields].index("x_ref_max")
    return 0
