"""Python values as OPC UA DataValues, made once for all subscribers, with the timestamps that a client requested.

Source: time of the sample.  Server: time at which this server read the value, or added it to its history.
"""

from __future__ import annotations

import math
from datetime import UTC, datetime, timedelta
from typing import Any

from asyncua import ua
from asyncua.common.utils import ServiceError

from gateway.views.opcua.address_space.quality import UNAVAILABLE, is_bad

LONGEST_S = 1e9  # of a board since its reset: 31 years
LATEST_NS = 1 << 62  # of a host's clock: the year 2116
PULL = 0.002  # share of a late arrival's error taken per sample
JUMP_NS = 500_000_000  # a clock that was set, or a long gap: restart the estimate
T = ua.TimestampsToReturn
_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
_STATUS: dict[int, ua.StatusCode] = {}


class Value(ua.DataValue):
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
    if isinstance(value, float | int) and not _fits(value, variant) and not is_bad(code):
        code = UNAVAILABLE
    if is_bad(code) or value is None:
        held = ua.Variant(None, ua.VariantType.Null)
    else:
        held = ua.Variant(value, variant, is_array=isinstance(value, list))
    status = _STATUS.get(code)
    if status is None:
        status = _STATUS[code] = ua.StatusCode(code)
    return Value(Value=held, StatusCode=status, SourceTimestamp=datetime_of(stamp_ns) if stamp_ns else None)


def _fits(value: float, variant: ua.VariantType) -> bool:
    """Return whether the type can represent a number.  An unknown code of an enum may be negative."""
    return math.isfinite(value) and (value >= 0 or variant is not ua.VariantType.UInt32)


async def notify(attribute: Any, value: Value) -> None:
    """Send a value to the subscribers of an attribute of asyncua's address space."""
    for handle, callback in list(attribute.datachange_callbacks.items()):
        await callback(handle, value)


def check_timestamps(requested: ua.TimestampsToReturn, *, of_history: bool = False) -> None:
    """Check the requested timestamps (Part 4, 7.40); a history must have timestamps (Part 11, 6.4.2).

    Raises:
        ServiceError: BadTimestampsToReturnInvalid.
    """
    if requested not in (T.Source, T.Server, T.Both) and (of_history or requested != T.Neither):
        raise ServiceError(ua.StatusCodes.BadTimestampsToReturnInvalid)


def stamped(
    value: ua.DataValue, requested: ua.TimestampsToReturn, served: datetime | None, *, of_value: bool = True
) -> ua.DataValue:
    """Return `value`, unchanged, with the requested timestamps; the server's is `served`.

    Only the attribute Value has a source timestamp (`of_value`).
    """
    source = value.SourceTimestamp if of_value and requested in (T.Source, T.Both) else None
    server = served if requested in (T.Server, T.Both) else None
    if source is value.SourceTimestamp and server is value.ServerTimestamp:
        return value
    return Value(
        Value=value.Value,
        StatusCode=value.StatusCode,
        SourceTimestamp=source,
        SourcePicoseconds=value.SourcePicoseconds if source is not None else None,
        ServerTimestamp=server,
    )


class StampClock:
    """Source timestamps of one board's samples, ns of Unix time: strictly increasing, without the link's jitter.

    A sample's arrival is late by the link's latency, which varies; its tick is exact but of an unknown origin.  The
    origin is estimated per session.  Early arrivals pull it at once, because a sample cannot arrive before it was made.
    Late ones pull it slowly, so that it follows the drift of the quartz and not the queue.
    """

    def __init__(self) -> None:
        self._session: int | None = None
        self._origin_ns = 0
        self._newest_ns = 0

    def stamp(self, *, session: int, t_s: float, host_time_ns: int) -> int:
        """Return the time of the sample with board time `t_s`; `host_time_ns` is 0 if its arrival is not known."""
        t_ns = _whole_ns(t_s)
        if 0 < host_time_ns <= LATEST_NS:
            delay_ns = host_time_ns - (self._origin_ns + t_ns)
            if session != self._session or abs(delay_ns) > JUMP_NS:
                self._origin_ns = host_time_ns - t_ns
            else:
                self._origin_ns += delay_ns if delay_ns < 0 else round(PULL * delay_ns)
            self._session = session
        self._newest_ns = max(self._newest_ns + 1000, self._origin_ns + t_ns)  # Python's datetime counts in us
        return self._newest_ns

    def time_ns(self, t_s: float) -> int:
        """Return the time of another message of the same session, such as the twin's, without updating the estimate."""
        return self._origin_ns + _whole_ns(t_s)


def _whole_ns(t_s: float) -> int:
    """Return a board's time in ns; 0 for NaN and what no board's clock shows, which Python's datetime cannot hold."""
    return round(t_s * 1e9) if abs(t_s) <= LONGEST_S else 0
