"""Alarms as OPC UA conditions, and the board's events and commands as OPC UA events.

A condition of a board is the node `<board>/alarm/<name>`, which can be browsed once the alarm was raised.  Everything
is emitted by the Server object and by the board's object: clients subscribe at either.  ConditionRefresh reports the
retained conditions; Acknowledge, AddComment, Enable and Disable are methods of the condition, TimedShelve and Unshelve
of its ShelvingState: they act on the alarm of the bus, and so in every view and in the log.  A disabled condition is
not reported to any client of this server until it is enabled or the server restarts; all other views continue to show
it.
"""

from __future__ import annotations

import copy
import uuid
from datetime import UTC, datetime
from functools import partial
from typing import Any

from asyncua import ua
from asyncua.common.event_objects import BaseEvent

from gateway.views.alarms import Alarm
from gateway.views.board_feed import BoardFeed
from gateway.views.opcua.address_space.values import Value, datetime_of
from gateway.views.opcua.condition_events import (
    SEVERITY,
    UNSHELVE_TIME,
    ConditionNode,
    condition_event,
    unshelve_time_ms,
)
from gateway.views.opcua.condition_nodes import ConditionObject
from gateway.views.opcua.sessions import GuardedServer
from gateway.views.opcua.types import Builder
from protocol.bus import board51_pb2 as pb

_SERVER = ua.NodeId(ua.ObjectIds.Server)


class Conditions:
    """The alarms and events of one board."""

    def __init__(self, server: GuardedServer, builder: Builder, feed: BoardFeed, node: ua.NodeId) -> None:
        self._server, self._builder, self._feed, self._node = server, builder, feed, node
        self._objects: dict[str, ConditionObject] = {}  # by the name of the alarm
        self._revision = -1
        self._sent: dict[str, Alarm] = {}  # those that are retained
        self._known: dict[str, tuple[ConditionNode, Alarm]] = {}  # with the last report, also of alarms that are over
        self._last_event: Any = (None, *feed.events())[-1]
        self._last_command: Any = (None, *feed.commands())[-1]

    async def update(self) -> None:
        """Send what has changed since the last call."""
        revision = self._feed.alarms_revision()
        if revision != self._revision:
            self._revision = revision
            await self._alarms()
        await self._send_client_changes()
        for event in self._after(self._feed.events(), self._last_event):
            self._last_event = event
            await self._send(_plain(f"{event.name}: {event.text}", event.severity, event.host_time_ns))
        for record in self._after(self._feed.commands(), self._last_command):
            self._last_command = record
            await self._send(_plain(_command_text(record), "info", record.answered_ns))

    async def _alarms(self) -> None:
        listed = {alarm.name: alarm for alarm in self._feed.all_alarms()}
        ended = [self._sent[name] for name in self._sent.keys() - listed.keys()]
        previous, self._sent = self._sent, listed
        for alarm in listed.values():
            before = previous.get(alarm.name)
            if before != alarm:
                came = before is None or (before.since_ns, before.times) != (alarm.since_ns, alarm.times)
                await self._report(alarm, retain=True, came=came)
        for alarm in ended:
            await self._report(alarm, retain=False)

    async def _send_client_changes(self) -> None:
        for name, (condition, alarm) in self._known.items():
            if condition.is_changed:
                condition.is_changed = False
                await self._report(alarm, retain=name in self._sent, switched=True)

    async def _report(self, alarm: Alarm, *, retain: bool, came: bool = False, switched: bool = False) -> None:
        """Send the event of a condition; for a disabled one only if it was just disabled."""
        node = ua.NodeId(f"{alarm.board}/alarm/{alarm.name}", self._server.spaces.site)
        condition = self._server.conditions.setdefault(node, ConditionNode(alarm.board, alarm.name))
        self._known[alarm.name] = condition, alarm
        if came:  # its earlier events and comments are over
            condition.event_ids.clear()
            condition.comment = None
        if condition.enabled or switched:
            now = datetime.now(UTC) if switched else datetime_of(alarm.changed_ns)
            await self._send(condition_event(alarm, condition, node, now, retain=retain), of=alarm.name)

    async def _send(self, event: Any, *, of: str = "") -> None:
        """Send an event; first show it at the condition of the alarm `of`, if any."""
        event.ReceiveTime = datetime.now(UTC)
        event.LocalTime = ua.TimeZoneDataType()
        event.SourceNode, event.SourceName = self._node, self._feed.name
        if of:
            if of not in self._objects:
                self._objects[of] = ConditionObject(self._server.aspace, self._builder, self._node, event)
                left = self._builder.id(f"{event.NodeId.Identifier}/{UNSHELVE_TIME}")
                self._server.set_attribute_value_callback(left, partial(_time_left, self._known[of][0]))
            await self._objects[of].show(event)
        for emitter in (self._node, _SERVER):
            emitted = copy.copy(event)
            emitted.emitting_node = emitter
            await self._server.subscription_service.trigger_event(emitted)

    @staticmethod
    def _after(retained: tuple[Any, ...], last: Any) -> tuple[Any, ...]:
        """Return the entries after `last`; all if `last` is no longer among them."""
        index = next((n for n in range(len(retained) - 1, -1, -1) if retained[n] is last), -1)
        return retained[index + 1 :]


def _time_left(condition: ConditionNode, *_: object) -> Value:
    """Return the value of UnshelveTime, which runs down."""
    now = datetime.now(UTC)
    return Value(Value=ua.Variant(unshelve_time_ms(condition, now), ua.VariantType.Double), SourceTimestamp=now)


def _plain(text: str, severity: str, time_ns: int) -> Any:
    event: Any = BaseEvent(message=text, severity=SEVERITY.get(severity, 100))
    event.EventId = uuid.uuid4().bytes
    event.EventType = ua.NodeId(ua.ObjectIds.BaseEventType)
    event.Time = datetime_of(time_ns)
    return event


def _command_text(record: pb.CommandRecord) -> str:
    what, reply = record.command.WhichOneof("what") or "nothing", record.reply
    end = "accepted" if reply.accepted else f"refused by {reply.refused_by}: {reply.reason}"
    return f"command {what} by {record.command.who or 'somebody'}: {end}"
