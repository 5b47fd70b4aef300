"""What OPC UA's services ask of a server (Part 4, Part 9): timestamps, types, filters, conditions; over a real bus."""

from __future__ import annotations

import asyncio
from datetime import UTC, datetime, timedelta
from itertools import pairwise
from typing import Any

import pytest
from asyncua import ua
from asyncua.ua.uaerrors import UaStatusCodeError

from gateway.access.roles import Role
from gateway.views.opcua.capabilities import FACETS, TRANSPORT
from gateway.views.opcua.items import is_news
from gateway.views.opcua.server import OpcuaSettings
from protocol.bus import board51_pb2 as pb
from tests.harness.gateway.bus_peers import played_gateway, ticking
from tests.harness.gateway.opcua_peers import Notifications, Peer, Served, monitor, peer, received, until

pytestmark = pytest.mark.xdist_group("opcua")
S = ua.StatusCodes
T = ua.TimestampsToReturn
V = ua.VariantType
PATH = "timed/state/x_m"
SERVER = ua.NodeId(ua.ObjectIds.Server)
EVENTS = [
    ua.ObjectIds.AlarmConditionType, ua.ObjectIds.BaseEventType, ua.ObjectIds.RefreshStartEventType,
    ua.ObjectIds.RefreshEndEventType,
]  # fmt: skip
CONDITION_TYPE = ua.NodeId(ua.ObjectIds.ConditionType)


# -- timestamps


@pytest.mark.parametrize("asked", [T.Source, T.Server, T.Both, T.Neither], ids=lambda asked: asked.name)
def test_a_read_has_the_timestamps_asked_for(server: Served, asked: ua.TimestampsToReturn) -> None:
    async def ask() -> list[ua.DataValue]:
        async with peer(server.port) as client:
            await client.await_status(PATH, S.Good)
            parameters = ua.ReadParameters(TimestampsToReturn=asked)
            parameters.NodesToRead = [
                ua.ReadValueId(NodeId=ua.NodeId(PATH, client.namespace), AttributeId=attribute)
                for attribute in (ua.AttributeIds.Value, ua.AttributeIds.DisplayName)
            ]
            return list(await client.client.uaclient.read(parameters))

    with ticking(server.gateway, "timed"):
        value, name = asyncio.run(ask())

    assert (value.SourceTimestamp is not None) == (asked in (T.Source, T.Both))
    assert (value.ServerTimestamp is not None) == (asked in (T.Server, T.Both))
    assert name.SourceTimestamp is None  # only a value has a source
    if value.ServerTimestamp is not None:
        assert abs(value.ServerTimestamp - datetime.now(UTC)) < timedelta(seconds=30)


@pytest.mark.parametrize("asked", [T.Source, T.Server, T.Both, T.Neither], ids=lambda asked: asked.name)
def test_a_monitored_item_has_the_timestamps_asked_for(server: Served, asked: ua.TimestampsToReturn) -> None:
    notified = Notifications()

    async def ask() -> None:
        async with peer(server.port) as client:
            await client.await_status("timed/state/sequence", S.Good)
            items = await monitor(client, notified, "timed/state/sequence", asked=asked)
            assert items[0].StatusCode.is_good()
            await received(notified, "timed/state/sequence", 3)

    with ticking(server.gateway, "timed"):
        asyncio.run(ask())

    for value in notified.values["timed/state/sequence"]:
        assert (value.SourceTimestamp is not None) == (asked in (T.Source, T.Both))
        assert (value.ServerTimestamp is not None) == (asked in (T.Server, T.Both))


@pytest.mark.parametrize("asked", [T.Source, T.Server, T.Both], ids=lambda asked: asked.name)
def test_history_has_the_timestamps_asked_for(server: Served, asked: ua.TimestampsToReturn) -> None:
    async def ask() -> list[ua.DataValue]:
        async with peer(server.port) as client:
            await client.await_status(PATH, S.Good)

            async def enough() -> list[ua.DataValue] | None:
                result = (await client.client.uaclient.history_read(history(client, asked)))[0]
                values = result.HistoryData.DataValues
                return values if len(values) > 3 else None

            return await until(enough, "history")

    with ticking(server.gateway, "timed"):
        values = asyncio.run(ask())

    for value in values:
        assert (value.SourceTimestamp is not None) == (asked in (T.Source, T.Both))
        assert (value.ServerTimestamp is not None) == (asked in (T.Server, T.Both))
        if asked == T.Both:  # kept when it came, not when it was read
            assert abs(value.ServerTimestamp - value.SourceTimestamp) < timedelta(seconds=30)
    if asked == T.Both:
        assert len({value.ServerTimestamp for value in values}) > 1


def test_timestamps_that_do_not_exist_are_refused(server: Served) -> None:
    async def ask() -> None:
        async with peer(server.port) as client:
            await client.await_status(PATH, S.Good)
            with pytest.raises(UaStatusCodeError, match="BadTimestampsToReturnInvalid"):
                await client.client.uaclient.history_read(history(client, T.Neither))
            with pytest.raises(UaStatusCodeError, match="BadTimestampsToReturnInvalid"):
                await client.client.uaclient.read(ua.ReadParameters(TimestampsToReturn=T.Invalid))
            with pytest.raises(UaStatusCodeError, match="BadTimestampsToReturnInvalid"):
                await monitor(client, Notifications(), PATH, asked=T.Invalid)

    with ticking(server.gateway, "timed"):
        asyncio.run(ask())


def history(client: Peer, asked: ua.TimestampsToReturn) -> ua.HistoryReadParameters:
    """Of the last minute."""
    details = ua.ReadRawModifiedDetails(IsReadModified=False, NumValuesPerNode=100)
    details.StartTime, details.EndTime = datetime.now(UTC) - timedelta(minutes=1), datetime.now(UTC)
    parameters = ua.HistoryReadParameters(HistoryReadDetails=details, TimestampsToReturn=asked)
    parameters.NodesToRead = [ua.HistoryReadValueId(NodeId=ua.NodeId(PATH, client.namespace))]
    return parameters


# -- one sample, one value of each variable


def test_all_variables_of_one_interval_belong_together_however_late_it_is_sent(server: Served) -> None:
    """Intervals that gather while the server is busy are sent one after the other, each with all of its own values."""
    notified, gateway = Notifications(), server.gateway
    names = ("x_m", "tick", "sequence", "host_time_ns", "t_s", "flags")
    paths = [f"burst/state/{name}" for name in names]

    def values(_: int) -> dict[str, Any]:
        tick = gateway.tick
        return {
            "x_m": tick * 1e-6,
            "host_time_ns": 1_700_000_000_000_000_000 + tick * 2_000_000,
            "flags": tick & 0xFF00,
        }

    async def burst() -> None:
        async with peer(server.port) as client:
            with ticking(gateway, "burst", values=values):
                await client.await_status(paths[0], S.Good)
                await monitor(client, notified, *paths, asked=T.Source, filter_=data_filter(stamps=True))
                await received(notified, paths[-1], 1)
            for _ in range(200):  # 20 intervals at once
                gateway.state("burst", **values(0))
            last = 1_700_000_000_000_000_000 + (gateway.tick - 20) * 2_000_000

            async def came() -> bool | None:
                return True if notified.values["burst/state/host_time_ns"][-1].Value.Value >= last else None

            await until(came, "the last of the burst")

    asyncio.run(burst())

    by_stamp: dict[datetime, dict[str, Any]] = {}
    for name, path in zip(names, paths, strict=True):
        for value in notified.values[path][1:]:
            if value.StatusCode.is_good():
                by_stamp.setdefault(value.SourceTimestamp, {})[name] = value.Value.Value
    whole = [row for row in by_stamp.values() if len(row) == len(names)]
    assert len(whole) > 15  # of 20; with the first and the last there may be parts
    for row in whole:
        tick = row["tick"] - 1  # `values` is asked before the tick is counted
        assert row["sequence"] == row["tick"] & 0xFFFF
        assert round(row["x_m"] * 1e6) == tick
        assert row["host_time_ns"] == 1_700_000_000_000_000_000 + tick * 2_000_000
        assert row["flags"] == tick & 0xFF00
    full = [row["sequence"] for row in whole if row["tick"] % 10 == 9]  # the last of an interval, not of an outage
    assert all(b - a == 10 for a, b in pairwise(full[-15:])), full


# -- types


@pytest.mark.parametrize(
    ("path", "value"),
    [
        ("setpoint/x_ref_m", ua.Variant(2e-3, V.Float)),
        ("setpoint/x_ref_m", ua.Variant(0, V.Int32)),
        ("setpoint/x_ref_m", ua.Variant([2e-3], V.Double)),
        ("setpoint/x_ref_m", ua.Variant()),
        ("setpoint/mode", ua.Variant(2, V.Int32)),
        ("setpoint/mode", ua.Variant(2, V.Int64)),
        ("setpoint/mode", ua.Variant(2.0, V.Double)),
        ("setpoint/mode", ua.Variant(True, V.Boolean)),
    ],
    ids=str,
)
def test_a_value_of_another_type_is_not_converted(server: Served, path: str, value: ua.Variant) -> None:
    assert _written(server, path, value) == (S.BadTypeMismatch, 0)


@pytest.mark.parametrize("path", ["setpoint/x_ref_m/EURange", "setpoint/x_ref_m/EngineeringUnits", "setpoint"])
def test_nothing_beside_a_setpoint_can_be_written(server: Served, path: str) -> None:
    assert _written(server, path, ua.Variant(2, V.UInt32)) == (S.BadNotWritable, 0)


def _written(server: Served, path: str, value: ua.Variant) -> tuple[int, int]:
    """Status code, and how many commands that made."""

    async def ask() -> int:
        async with peer(server.port) as client:
            await client.await_status(PATH, S.Good)
            return await client.write(f"timed/{path}", value)

    server.gateway.commands.clear()
    with ticking(server.gateway, "timed"):
        code = asyncio.run(ask())
    return code, len(server.gateway.commands)


def test_an_argument_of_another_type_is_named(server: Served) -> None:
    async def ask() -> list[tuple[int, list[int]]]:
        async with peer(server.port) as client:
            await client.await_status(PATH, S.Good)
            results = [
                await client.call("timed", "SetReference", ua.Variant(2e-3, V.Float)),
                await client.call("timed", "SetMode", ua.Variant(2, V.Int32)),
                await client.call(
                    "timed", "Capture", *(ua.Variant(0.1, kind) for kind in (V.Double, V.Float, V.Double, V.Double))
                ),
                await client.call("timed", "Mark", ua.Variant(7, V.UInt32)),
                await client.call("timed", "SetReference", ua.Variant(2e-3, V.Double)),
            ]
            return [(r.StatusCode.value, [code.value for code in r.InputArgumentResults]) for r in results]

    server.gateway.commands.clear()
    with ticking(server.gateway, "timed"):
        results = asyncio.run(ask())

    mismatch = S.BadTypeMismatch
    assert results == [
        (S.BadInvalidArgument, [mismatch]),
        (S.BadInvalidArgument, [mismatch]),
        (S.BadInvalidArgument, [S.Good, mismatch, S.Good, S.Good]),
        (S.BadInvalidArgument, [mismatch]),
        (S.Good, []),  # empty unless an argument is invalid (Part 4, 5.12.2)
    ]
    assert [command.WhichOneof("what") for _, command in server.gateway.commands] == ["set_reference"]


# -- filters


def test_a_deadband_counts_from_the_value_sent_last() -> None:
    band = data_filter(deadband=1.0)
    sent, told = None, []

    for n in range(41):
        value = ua.DataValue(ua.Variant(0.1 * n, V.Double))
        if is_news(sent, value, band):
            sent = value
            told.append(n)

    assert told == [0, 11, 22, 33]


def test_a_client_with_a_deadband_does_not_end_the_service_when_a_value_goes(server: Served) -> None:
    notified = Notifications()

    async def ask() -> None:
        async with peer(server.port) as client:
            with ticking(server.gateway, "gone"):
                await client.await_status("gone/state/x_m", S.Good)
                paths = ("gone/state/x_m", "gone/link/state")
                await monitor(client, notified, *paths, asked=T.Both, filter_=data_filter(deadband=1e-6))
            server.gateway.status("gone", link="absent")
            await client.await_status("gone/state/x_m", S.BadNoCommunication)
            with ticking(server.gateway, "gone"):
                await client.await_status("gone/state/x_m", S.Good)

    asyncio.run(ask())


@pytest.mark.parametrize(
    ("path", "attribute", "asked"),
    [
        ("timed/state/x_m", ua.AttributeIds.Value, ua.EventFilter()),
        ("timed/state/x_m", ua.AttributeIds.Value, ua.AggregateFilter()),
        ("timed/state/x_m", ua.AttributeIds.Value, ua.ReadRawModifiedDetails()),
        ("timed", ua.AttributeIds.EventNotifier, ua.DataChangeFilter()),
        ("timed", ua.AttributeIds.EventNotifier, None),
    ],
)
def test_a_filter_that_does_not_fit_is_refused_and_ends_nothing(
    server: Served, path: str, attribute: ua.AttributeIds, asked: Any
) -> None:
    async def ask() -> None:
        async with peer(server.port) as client:
            await client.await_status(PATH, S.Good)
            item = (await monitor(client, Notifications(), path, asked=T.Both, filter_=asked, attribute=attribute))[0]
            assert item.StatusCode.value == S.BadMonitoredItemFilterUnsupported
            other = Notifications()
            assert (await monitor(client, other, PATH, asked=T.Both))[0].StatusCode.is_good()
            await received(other, PATH, 1)

    with ticking(server.gateway, "timed", values=lambda n: {"x_m": n * 1e-6}):
        asyncio.run(ask())


@pytest.mark.parametrize(("attribute", "name"), [(99, ""), (13, "data_types")])
def test_a_select_clause_that_means_nothing_ends_nothing(server: Served, attribute: int, name: str) -> None:
    clause = ua.SimpleAttributeOperand(TypeDefinitionId=CONDITION_TYPE, AttributeId=attribute)
    clause.BrowsePath = [ua.QualifiedName(name, 0)] if name else []

    board = f"clause{attribute}"

    async def ask() -> None:
        async with peer(server.port) as client:
            await client.await_status(f"{board}/state/x_m", S.Good)
            strange = ua.EventFilter(SelectClauses=[clause])
            await monitor(
                client, Notifications(), board, asked=T.Both, filter_=strange, attribute=ua.AttributeIds.EventNotifier
            )
            await condition(server, client, Notifications(), board)

    with ticking(server.gateway, board):
        asyncio.run(ask())


def data_filter(*, deadband: float = 0.0, stamps: bool = False) -> ua.DataChangeFilter:
    trigger = ua.DataChangeTrigger.StatusValueTimestamp if stamps else ua.DataChangeTrigger.StatusValue
    kind = ua.DeadbandType.Absolute if deadband else ua.DeadbandType.None_
    return ua.DataChangeFilter(Trigger=trigger, DeadbandType=kind, DeadbandValue=deadband)


# -- conditions


def test_a_refresh_reaches_the_items_at_the_rig_too(server: Served) -> None:
    async def ask() -> None:
        async with peer(server.port) as client, peer(server.port) as other:
            await client.await_status("refreshed/state/x_m", S.Good)
            raise_alarm(server, "refreshed")
            found = {}
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
                found[node] = [e.EventType.Identifier for e in notified.events if e.SourceName == "Server"]
                assert await refresh(client, number, ua.Variant(item + 1000, V.UInt32)) == S.BadMonitoredItemIdInvalid
                assert await refresh(other, number) == S.BadSubscriptionIdInvalid
                assert await refresh(client, ua.Variant(1.0, V.Double)) == S.BadInvalidArgument
            start, end = ua.ObjectIds.RefreshStartEventType, ua.ObjectIds.RefreshEndEventType
            for brackets in found.values():
                assert [kind for kind in brackets if kind in (start, end)] == [start, end, start, end]

    with ticking(server.gateway, "refreshed"):
        asyncio.run(ask())


def test_a_comment_is_added_without_acknowledging(server: Served) -> None:
    notified = Notifications()

    async def ask() -> None:
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
        asyncio.run(ask())

    [(_, command)] = server.gateway.commands  # the log has it
    assert command.mark.text == "divergence-x: seen on Monday, too"


def test_a_disabled_condition_is_silent_until_it_is_enabled(server: Served) -> None:
    notified = Notifications()
    enable, disable = ua.ObjectIds.ConditionType_Enable, ua.ObjectIds.ConditionType_Disable

    async def ask() -> None:
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
            told = len(notified.events)
            raise_alarm(server, "disabled", text="x is further off")
            server.gateway.send("event", pb.Event(name="mark", severity="info", text="later"), "disabled")

            async def later() -> bool | None:
                return True if any("later" in (e.Message.Text or "") for e in notified.events) else None

            await until(later, "event after the alarm")
            assert [e for e in notified.events[told:] if "off" in (e.Message.Text or "")] == []
            notified.events.clear()
            assert await of_condition(client, came, enable) == S.Good
            on = await until(lambda: with_enabled(notified, came, enabled=True), "enabled condition")
            assert (on.Retain, on.Message.Text) == (True, "x is further off")

    server.gateway.commands.clear()
    with ticking(server.gateway, "disabled"):
        asyncio.run(ask())

    remarks = [command.mark.text for _, command in server.gateway.commands]
    assert remarks == [f"divergence-x {state} for OPC UA clients" for state in ("disabled", "enabled")]


def test_only_who_may_disables_a_condition() -> None:
    async def ask(server: Served) -> None:
        async with peer(server.port) as client:
            came = await condition(server, client, Notifications(), "timed")
            code = await of_condition(client, came, ua.ObjectIds.ConditionType_Disable)
            assert code == S.BadUserAccessDenied

    with (
        played_gateway() as gateway,
        ticking(gateway, "timed"),
        Served(gateway, OpcuaSettings(port=0, anonymous=Role.OPERATOR)) as server,
    ):
        asyncio.run(ask(server))


def raise_alarm(server: Served, board: str, text: str = "x is off") -> None:
    server.gateway.send("twin/alarm", pb.Alarm(name="divergence-x", active=True, text=text, value=9.0), board)


async def condition(server: Served, client: Peer, notified: Notifications, board: str) -> Any:
    """Subscribe at the Server, raise an alarm, and return its first event."""
    await client.await_status(f"{board}/state/x_m", S.Good)
    subscription = await client.client.create_subscription(50, notified)
    await subscription.subscribe_alarms_and_conditions(evtypes=EVENTS)
    raise_alarm(server, board)

    async def came() -> Any:
        return next(iter(notified.of(board)), None)

    return await until(came, "condition")


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


# -- what it says of itself


def test_the_server_says_what_it_supports(server: Served) -> None:
    async def ask() -> list[Any]:
        async with peer(server.port) as client:
            nodes = (
                ua.ObjectIds.Server_ServerCapabilities_ServerProfileArray,
                ua.ObjectIds.Server_ServerCapabilities_LocaleIdArray,
                ua.ObjectIds.HistoryServerCapabilities_AccessHistoryDataCapability,
                ua.ObjectIds.HistoryServerCapabilities_ServerTimestampSupported,
            )
            return [await client.client.get_node(ua.NodeId(node)).read_value() for node in nodes]

    profiles, locales, has_history, has_server_timestamps = asyncio.run(ask())

    assert {TRANSPORT, "http://opcfoundation.org/UA/SecurityPolicy#None", *FACETS} <= set(profiles)
    assert not [profile for profile in profiles if "Basic256" in profile or "UserName" in profile]
    assert (locales, has_history, has_server_timestamps) == (["en"], True, True)
