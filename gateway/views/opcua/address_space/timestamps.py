"""Timestamps of returned values: exactly those that the client requested (TimestampsToReturn, Part 4, 7.40).  Pure.

Source: time of the sample.  Server: time at which this server read the value, or added it to its history.
"""

from __future__ import annotations

from datetime import datetime

from asyncua import ua
from asyncua.common.utils import ServiceError

from gateway.views.opcua.address_space.values import Value

T = ua.TimestampsToReturn


def check(requested: ua.TimestampsToReturn, *, of_history: bool = False) -> None:
    """Check the requested timestamps; a history must have timestamps (Part 11, 6.4.2).

    Raises:
        ServiceError: BadTimestampsToReturnInvalid.
    """
    if requested not in (T.Source, T.Server, T.Both) and (of_history or requested != T.Neither):
        raise ServiceError(ua.StatusCodes.BadTimestampsToReturnInvalid)


def stamped(
    value: ua.DataValue, requested: ua.TimestampsToReturn, served: datetime | None, *, of_value: bool = True
) -> ua.DataValue:
    """Return `value` with the requested timestamps.

    Args:
        value: as it is kept; not changed.
        requested: by the client.
        served: the server's timestamp.
        of_value: of the attribute Value; the others have no source.
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
