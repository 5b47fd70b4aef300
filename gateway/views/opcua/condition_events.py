"""The event of a condition with every field that Part 9 asks of an AlarmConditionType.  Pure but for the event's id."""

from __future__ import annotations

import uuid
from collections import deque
from dataclasses import dataclass, field
from datetime import datetime
from typing import Any

from asyncua import ua
from asyncua.common.event_objects import AlarmCondition

from gateway.board.conditions import LINK, LOG, TO_BOARD
from gateway.board.limits import MAX_SHELVE_S
from gateway.views.alarms import TWIN, Alarm
from gateway.views.opcua.address_space.values import datetime_of

SEVERITY = {"info": 100, "warning": 500, "fault": 800}
_PROCESS = ua.NodeId(ua.ObjectIds.ProcessConditionClassType)
_V, _O = ua.VariantType, ua.ObjectIds
SHELVING, UNSHELVE_TIME = "ShelvingState/CurrentState", "ShelvingState/UnshelveTime"
_INPUTS = {  # the variable that an alarm judges, by its name; of the board's faults, its flags
    "divergence-x": "twin/divergence/x_m.normalised",
    "divergence-i_c": "twin/divergence/i_c_a.normalised",
    "innovation": "twin/divergence/nis_mean",
    "diagnosis-wanted": "twin/divergence/nis_mean",
    "out-of-step": "twin/divergence/sync",
    TWIN: "twin/state/sync",
    LINK: "link/state",
    LOG: "status/log_state",
    TO_BOARD: "status/to_board",
}


@dataclass
class ConditionNode:
    """The state of a condition's node: its alarm, its last report, and the changes by clients."""

    board: str
    alarm: str
    event_ids: deque[bytes] = field(default_factory=lambda: deque(maxlen=64))  # of its present state: may be commented
    enabled: bool = True  # for the clients of this server
    comment: tuple[str, str] | None = None  # text, who: of AddComment, newer than that of the acknowledgement
    is_changed: bool = False  # by a client; not told yet
    states: dict[str, tuple[bool, datetime]] = field(default_factory=dict)  # as reported last, and since when
    severity: tuple[int, datetime] | None = None  # as reported last
    sent_comment: tuple[str, datetime] | None = None  # comment, and since when
    unshelved_at: datetime | None = None  # end of its shelving


def condition_event(alarm: Alarm, condition: ConditionNode, node: ua.NodeId, now: datetime, *, retain: bool) -> Any:
    """Return the event that reports the present state of an alarm; `condition` remembers the report.

    `node` is the ConditionId.  `retain` says whether the condition is of interest to operators.
    """
    severity = SEVERITY[alarm.severity]
    event: Any = AlarmCondition(message=alarm.text, severity=severity)
    event.add_property("NodeId", node, _V.NodeId)
    event.EventId, event.Time = uuid.uuid4().bytes, now
    condition.event_ids.append(event.EventId)
    event.ConditionName, event.ConditionClassId = alarm.name, _PROCESS
    event.ConditionClassName = ua.LocalizedText("ProcessConditionClassType")
    event.Retain = retain and condition.enabled
    event.SupportsFilteredRetain = False
    event.BranchId = ua.NodeId()
    event.InputNode = ua.NodeId(f"{alarm.board}/{_INPUTS.get(alarm.name, 'state/flags')}", node.NamespaceIndex)
    event.Quality = ua.StatusCode()
    _stamp(event, "Quality/SourceTimestamp", datetime_of(alarm.changed_ns))
    last = condition.severity or (severity, now)
    event.LastSeverity = last[0]
    _stamp(event, "LastSeverity/SourceTimestamp", last[1])
    condition.severity = severity, now
    _comment(event, alarm, condition, now)
    _states(event, alarm, condition, now, retain=retain)
    _shelving(event, alarm, condition, retain=retain)
    return event


def unshelve_time_ms(condition: ConditionNode, now: datetime) -> float:
    """Return the time until the end of the shelving; 0 where it is not shelved (Part 9, 5.8.17)."""
    return 0.0 if condition.unshelved_at is None else max(0.0, (condition.unshelved_at - now).total_seconds() * 1e3)


def _comment(event: Any, alarm: Alarm, condition: ConditionNode, now: datetime) -> None:
    text, user = condition.comment or (alarm.comment, alarm.acknowledger)
    if condition.sent_comment is None or condition.sent_comment[0] != text:
        condition.sent_comment = text, now
    event.Comment, event.ClientUserId = ua.LocalizedText(text), user
    _stamp(event, "Comment/SourceTimestamp", condition.sent_comment[1])


def _states(event: Any, alarm: Alarm, condition: ConditionNode, now: datetime, *, retain: bool) -> None:
    active, acknowledged = alarm.active and retain, alarm.acknowledged or not retain
    flags = {"EnabledState": condition.enabled, "ActiveState": active, "AckedState": acknowledged}
    words = {
        "EnabledState": ("Disabled", "Enabled"),
        "ActiveState": ("Inactive", "Active"),
        "AckedState": ("Unacknowledged", "Acknowledged"),
    }
    for state, holds in flags.items():
        if state not in condition.states or condition.states[state][0] != holds:
            condition.states[state] = holds, now
        event.add_property(f"{state}/Id", holds, _V.Boolean)
        setattr(event, state, ua.LocalizedText(words[state][holds]))
        _stamp(event, f"{state}/TransitionTime", condition.states[state][1])
    effective = ", ".join(words[state][holds] for state, holds in flags.items() if state != "EnabledState")
    name = ua.LocalizedText(effective if condition.enabled else "Disabled")
    setattr(event, "EnabledState/EffectiveDisplayName", name)
    _stamp(event, "EnabledState/EffectiveTransitionTime", max(since for _, since in condition.states.values()))
    # Nothing waits to be confirmed: what an operator has acknowledged is done.
    event.ConfirmedState = ua.LocalizedText("Confirmed")
    setattr(event, "ConfirmedState/Id", True)


def _shelving(event: Any, alarm: Alarm, condition: ConditionNode, *, retain: bool) -> None:
    is_shelved = event.SuppressedOrShelved = alarm.is_shelved and retain
    condition.unshelved_at = datetime_of(alarm.shelved_until_ns) if is_shelved else None
    event.add_property(SHELVING, ua.LocalizedText("Timed Shelved" if is_shelved else "Unshelved"), _V.LocalizedText)
    state = _O.ShelvedStateMachineType_TimedShelved if is_shelved else _O.ShelvedStateMachineType_Unshelved
    event.add_property(f"{SHELVING}/Id", ua.NodeId(state), _V.NodeId)
    event.add_property(UNSHELVE_TIME, unshelve_time_ms(condition, event.Time), _V.Double)
    event.add_property("MaxTimeShelved", 1e3 * MAX_SHELVE_S, _V.Double)


def _stamp(event: Any, name: str, moment: datetime) -> None:
    event.add_property(name, moment, _V.DateTime)  # asyncua declares these by a data type, which it cannot encode
