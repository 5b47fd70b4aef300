"""OPC UA status codes of values.  Pure.

| what is known | status |
|---|---|
| samples come | Good |
| nothing of this kind came yet | BadWaitingForInitialData |
| the board fell silent, is being called again | UncertainLastUsableValue, with the last value |
| no port, no gateway | BadNoCommunication |
| position fault of the board | BadSensorFailure (x_m) |
| a converter at its end: the value is clipped | UncertainSensorNotAccurate (x_m, i_c_a) |
| samples lost within the interval: a spike may be missing | UncertainSubNormal (min, max) |
| twin settling or out of step | UncertainSubNormal |
| twin gone | UncertainLastUsableValue, after TWIN_TIMEOUT_S BadNoCommunication |
| a figure that does not exist (NaN, absent) | BadDataUnavailable |
"""

from __future__ import annotations

from asyncua import ua

from gateway.views.board_feed import Link
from gateway.views.opcua.address_space.model import Leaf, Statistic
from protocol.wire.messages import Flag

S = ua.StatusCodes
GOOD: int = S.Good
WAITING: int = S.BadWaitingForInitialData
STALE: int = S.UncertainLastUsableValue
NO_COMMUNICATION: int = S.BadNoCommunication
UNAVAILABLE: int = S.BadDataUnavailable
SUBNORMAL: int = S.UncertainSubNormal
CLIPPED: int = S.UncertainSensorNotAccurate
SENSOR_FAILURE: int = S.BadSensorFailure

TWIN_STALE_S = 0.5
TWIN_TIMEOUT_S = 5.0
STATUS_STALE_S = 3.5  # published once a second
_SOFT = frozenset({"silent", "handshake", "connecting", "streaming"})  # the gateway is there and tries


def is_bad(code: int) -> bool:
    """Return whether a value with this status must not be used."""
    return code >= 0x80000000


def is_down(code: int) -> bool:
    """Return whether the status of a topic means that no new values arrive."""
    return code not in (GOOD, SUBNORMAL)


def of_board(link: Link) -> int:
    """Return the status of the board's own topic, `state`."""
    if link.live:
        return GOOD
    return STALE if link.state in _SOFT else NO_COMMUNICATION


def of_gateway(link: Link, status_age_s: float) -> int:
    """Return the status of `status`, which the gateway sends also for a board that is absent."""
    if status_age_s > STATUS_STALE_S:
        return NO_COMMUNICATION if link.state == "no-gateway" else STALE
    return GOOD


def of_twin(age_s: float, sync: str) -> int:
    """Return the status of `twin/state` and `twin/divergence`."""
    if age_s > TWIN_TIMEOUT_S:
        return NO_COMMUNICATION
    if age_s > TWIN_STALE_S:
        return STALE
    return GOOD if sync == "in-step" else SUBNORMAL


def of_signal(base: int, leaf: Leaf, flags: int, *, fault: str) -> int:
    """Return the status of one signal of `state`, given that of the board."""
    if base != GOOD:
        return base
    if leaf.field == "x_m":
        if fault == "sensor-fault":
            return SENSOR_FAILURE
        if flags & Flag.POSITION_RANGE:
            return CLIPPED
    if leaf.field == "i_c_a" and flags & Flag.CURRENT_RANGE:
        return CLIPPED
    return base


def of_extreme(base: int, statistic: Statistic | None, lost: int) -> int:
    """Return the status of a lowest or highest value over an interval in which samples were lost."""
    return SUBNORMAL if base == GOOD and lost and statistic in ("low", "high") else base
