"""The events of a condition: every field that Part 9 asks for, and when each state began."""

from __future__ import annotations

from dataclasses import replace
from datetime import UTC, datetime, timedelta
from typing import Any

import pytest
from asyncua import ua

from gateway.views.alarms import Alarm
from gateway.views.opcua.address_space.model import leaves
from gateway.views.opcua.condition_events import _INPUTS, SHELVING, UNSHELVE_TIME, ConditionNode, condition_event

NODE = ua.NodeId("rig/alarm/divergence-x", 2)
START = datetime(2026, 1, 1, tzinfo=UTC)
ALARM = Alarm(board="rig", name="divergence-x", severity="warning", text="x is off", since_ns=10**18, changed_ns=10**18)
FIELDS = (  # mandatory from BaseEventType to AlarmConditionType; SourceNode, SourceName and ReceiveTime come on sending
    "EventId", "EventType", "Time", "Message", "Severity", "ConditionClassId", "ConditionClassName", "ConditionName",
    "BranchId", "Retain", "EnabledState", "EnabledState/Id", "Quality", "Quality/SourceTimestamp", "LastSeverity",
    "LastSeverity/SourceTimestamp", "Comment", "Comment/SourceTimestamp", "ClientUserId", "AckedState", "AckedState/Id",
    "ActiveState", "ActiveState/Id", "InputNode", "SuppressedOrShelved", "NodeId", "ShelvingState/CurrentState",
    "ShelvingState/CurrentState/Id", "ShelvingState/UnshelveTime", "MaxTimeShelved", "SupportsFilteredRetain",
)  # fmt: skip


def make_event(condition: ConditionNode, after_s: float, *, retain: bool = True, **changes: Any) -> Any:
    now = START + timedelta(seconds=after_s)
    return condition_event(replace(ALARM, **changes), condition, NODE, now, retain=retain)


def test_every_field_has_a_value_that_can_be_sent() -> None:
    event = make_event(ConditionNode("rig", "divergence-x"), 0)

    assert [name for name in FIELDS if getattr(event, name, None) is None] == []
    for name in FIELDS:
        assert isinstance(event.data_types[name], ua.VariantType), name
        ua.ua_binary.variant_to_binary(ua.Variant(getattr(event, name), event.data_types[name]))


def test_each_state_says_since_when() -> None:
    condition = ConditionNode("rig", "divergence-x")
    came = make_event(condition, 0)
    acknowledged = make_event(condition, 5, acknowledged=True, acknowledger="eva", comment="known")
    worse = make_event(condition, 7, acknowledged=True, acknowledger="eva", comment="known", severity="fault")
    ended = make_event(condition, 9, retain=False, acknowledged=True, acknowledger="eva", comment="known")

    def since(event: Any, field: str) -> float:
        return float((getattr(event, field) - START).total_seconds())

    assert [since(e, "ActiveState/TransitionTime") for e in (came, acknowledged, worse, ended)] == [0, 0, 0, 9]
    assert [since(e, "AckedState/TransitionTime") for e in (came, acknowledged, worse, ended)] == [0, 5, 5, 5]
    assert [since(e, "Comment/SourceTimestamp") for e in (came, acknowledged, worse, ended)] == [0, 5, 5, 5]
    assert [e.LastSeverity for e in (came, acknowledged, worse, ended)] == [500, 500, 500, 800]
    assert [getattr(e, "EnabledState/EffectiveDisplayName").Text for e in (came, ended)] == [
        "Active, Unacknowledged",
        "Inactive, Acknowledged",
    ]
    assert len({e.EventId for e in (came, acknowledged, worse, ended)}) == 4


@pytest.mark.parametrize("path", sorted({*_INPUTS.values(), "state/flags"}))
def test_the_input_of_a_condition_is_a_variable_of_the_rig(path: str) -> None:
    assert path == "link/state" or path in {leaf.path for leaf in leaves()}


def test_a_shelved_condition_says_so_and_for_how_long() -> None:
    condition = ConditionNode("rig", "divergence-x")
    until_ns = round((START + timedelta(seconds=65)).timestamp() * 1e9)
    shelved = make_event(condition, 5, acknowledged=True, shelved_until_ns=until_ns)
    back = make_event(condition, 30)

    assert [event.SuppressedOrShelved for event in (shelved, back)] == [True, False]
    assert [getattr(event, SHELVING).Text for event in (shelved, back)] == ["Timed Shelved", "Unshelved"]
    assert [getattr(event, UNSHELVE_TIME) for event in (shelved, back)] == [60e3, 0.0]
    assert condition.unshelved_at is None
