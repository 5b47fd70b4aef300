"""Python values as OPC UA DataValues, made once for all subscribers."""

from __future__ import annotations

import math
from datetime import UTC, datetime, timedelta
from typing import Any

from asyncua import ua

from gateway.views.opcua.address_space.quality import UNAVAILABLE, is_bad

_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
_STATUS: dict[int, ua.StatusCode] = {}


class Value(ua.DataValue):  # type: ignore[misc]  # asyncua is untyped here
    """An immutable DataValue.

    asyncua copies the value deeply for each monitored item and change: 31 us of 35 for one notification.
    """

    def __deepcopy__(self, memo: Any) -> Value:
        return self


def datetime_of(stamp_ns: int) -> datetime:
    """Return the UTC time of Unix nanoseconds, in microseconds, without rounding through floating-point seconds."""
    return _EPOCH + timedelta(microseconds=stamp_ns // 1000)


def data_value(value: object, variant: ua.VariantType, code: int, stamp_ns: int) -> Value:
    """Return `value` with status and source time; without a value if the status is bad (Part 4, 7.7.1)."""
    if isinstance(value, float) and not math.isfinite(value) and not is_bad(code):
        code = UNAVAILABLE
    if is_bad(code) or value is None:
        held = ua.Variant(None, ua.VariantType.Null)
    else:
        held = ua.Variant(value, variant, is_array=isinstance(value, list))
    status = _STATUS.get(code)
    if status is None:
        status = _STATUS[code] = ua.StatusCode(code)
    return Value(Value=held, StatusCode=status, SourceTimestamp=datetime_of(stamp_ns) if stamp_ns else None)


async def notify(attribute: Any, value: Value) -> None:
    """Send a value to the subscribers of an attribute of asyncua's address space."""
    for handle, callback in list(attribute.datachange_callbacks.items()):
        await callback(handle, value)
