"""Methods of OPC UA conditions: refresh, comment, enable, disable."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest
from asyncua import ua

from gateway.access.roles import Role
from gateway.views.opcua.server import OpcuaSettings
from protocol.bus import board51_pb2 as pb
from tests.harness.gateway.bus_peers import played_gateway, ticking
from tests.harness.gateway.opcua_peers import EVENTS, Notifications, Peer, Served, condition, peer, raise_alarm, until

pytestmark = pytest.mark.xdist_group("opcua")
S = ua.StatusCodes
V = ua.VariantType
SERVER = ua.NodeId(ua.ObjectIds.Server)
CONDITION_TYPE = ua.NodeId(ua.ObjectIds.ConditionType)


# -- conditions


def test_a_refresh_reaches_the_items_at_the_rig_too(server: Served) -> None:
    async def session_work() -> None:
        async with peer(server.port) as client, peer(server.port) as other:
            await client.await_status("refreshed/state/x_m", S.Good)
            raise_alarm(server, "refreshed")
            event_types = {}
            for node in (client.node("refreshed"), client.client.get_node(SERVER)):
                notified = Notifications()
                subscription = await client.client.create_subscription(50, notified)
                item = await subscription.subscribe_alarms_and_conditions(node, evtypes=EVENTS)
                number = ua.Variant(subscription.subscription_id, V.UInt32)
                assert await refresh(client, number) == S.Good
                await notified.retained("divergence-x", 1)
                assert await refresh(client, number, ua.Variant(item, V.UInt32)) == S.Good
                await notified.retained("divergence-x", 2)
                await notified.events_of(ua.ObjectIds.RefreshEndEventType, 2)
                event_types[node] = [e.EventType.Identifier for e in notified.events if e.SourceName == "Server"]
                assert await refresh(client, number, ua.Variant(item + 1000, V.UInt32)) == S.BadMonitoredItemIdInvalid
                assert await refresh(other, number) == S.BadSubscriptionIdInvalid
                assert await refresh(client, ua.Variant(1.0, V.Double)) == S.BadInvalidArgument
            start, end = ua.ObjectIds.RefreshStartEventType, ua.ObjectIds.RefreshEndEventType
            for brackets in event_types.values():
                assert [kind for kind in brackets if kind in (start, end)] == [start, end, start, end]

    with ticking(server.gateway, "refreshed"):
        asyncio.run(session_work())


def test_a_comment_is_added_without_acknowledging(server: Served) -> None:
    notified = Notifications()

    async def session_work() -> None:
        async with peer(server.port) as client:
            came = await condition(server, client, notified, "commented")
            method = ua.ObjectIds.ConditionType_AddComment
            text = ua.Variant(ua.LocalizedText("seen on Monday, too"))
            assert await of_condition(client, came, method, ua.Variant(b"another"), text) == S.BadEventIdUnknown
            assert await of_condition(client, came, method, ua.Variant(came.EventId), text) == S.Good

            async def commented() -> Any:
                return next((e for e in notified.events if e.Comment.Text), None)

            event = await until(commented, "comment")
            assert (event.Comment.Text, event.ClientUserId) == ("seen on Monday, too", "anonymous")
            assert (getattr(event, "AckedState/Id"), event.Retain) == (False, True)

    server.gateway.commands.clear()
    with ticking(server.gateway, "commented"):
        asyncio.run(session_work())

    [(_, command)] = server.gateway.commands  # the log has it
    assert command.mark.text == "divergence-x: seen on Monday, too"


def test_a_disabled_condition_is_silent_until_it_is_enabled(server: Served) -> None:
    notified = Notifications()
    enable, disable = ua.ObjectIds.ConditionType_Enable, ua.ObjectIds.ConditionType_Disable

    async def session_work() -> None:
        async with peer(server.port) as client:
            came = await condition(server, client, notified, "disabled")
            assert await of_condition(client, came, enable) == S.BadConditionAlreadyEnabled
            assert await of_condition(client, came, disable) == S.Good
            off = await until(lambda: with_enabled(notified, came, enabled=False), "disabled condition")
            assert off.Retain is False
            assert await of_condition(client, came, disable) == S.BadConditionAlreadyDisabled
            comment = ua.Variant(ua.LocalizedText("late"))
            acknowledge = ua.ObjectIds.AcknowledgeableConditionType_Acknowledge
            assert await of_condition(client, came, acknowledge, ua.Variant(came.EventId), comment) == (
                S.BadConditionDisabled
            )
            event_count = len(notified.events)
            raise_alarm(server, "disabled", text="x is further off")
            server.gateway.send("event", pb.Event(name="mark", severity="info", text="later"), "disabled")

            async def later() -> bool | None:
                return True if any("later" in (e.Message.Text or "") for e in notified.events) else None

            await until(later, "event after the alarm")
            assert [e for e in notified.events[event_count:] if "off" in (e.Message.Text or "")] == []
            notified.events.clear()
            assert await of_condition(client, came, enable) == S.Good
            on = await until(lambda: with_enabled(notified, came, enabled=True), "enabled condition")
            assert (on.Retain, on.Message.Text) == (True, "x is further off")

    server.gateway.commands.clear()
    with ticking(server.gateway, "disabled"):
        asyncio.run(session_work())

    remarks = [command.mark.text for _, command in server.gateway.commands]
    assert remarks == [f"divergence-x {state} for OPC UA clients" for state in ("disabled", "enabled")]


@pytest.mark.slow
def test_only_who_may_disables_a_condition() -> None:
    async def session_work(server: Served) -> None:
        async with peer(server.port) as client:
            came = await condition(server, client, Notifications(), "timed")
            code = await of_condition(client, came, ua.ObjectIds.ConditionType_Disable)
            assert code == S.BadUserAccessDenied

    with (
        played_gateway() as gateway,
        ticking(gateway, "timed"),
        Served(gateway, OpcuaSettings(port=0, anonymous=Role.OPERATOR)) as server,
    ):
        asyncio.run(session_work(server))


async def with_enabled(notified: Notifications, came: Any, *, enabled: bool) -> Any:
    of_it = [e for e in notified.events if getattr(e, "ConditionName", None) == came.ConditionName]
    return next((e for e in of_it if getattr(e, "EnabledState/Id", None) is enabled), None)


async def of_condition(client: Peer, event: Any, method: int, *inputs: ua.Variant) -> int:
    node = ua.NodeId(f"{event.SourceName}/alarm/{event.ConditionName}", client.namespace)
    return await called(client, node, method, *inputs)


async def refresh(client: Peer, *inputs: ua.Variant) -> int:
    method = ua.ObjectIds.ConditionType_ConditionRefresh
    if len(inputs) == 2:
        method = ua.ObjectIds.ConditionType_ConditionRefresh2
    return await called(client, CONDITION_TYPE, method, *inputs)


async def called(client: Peer, node: ua.NodeId, method: int, *inputs: ua.Variant) -> int:
    request = ua.CallMethodRequest(ObjectId=node, MethodId=ua.NodeId(method), InputArguments=list(inputs))
    return int((await client.client.uaclient.call([request]))[0].StatusCode.value)
