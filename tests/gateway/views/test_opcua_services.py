"""Tests of the services of OPC UA (Part 4, Part 9) over a real bus: timestamps, types, filters."""

from __future__ import annotations

import asyncio
from datetime import UTC, datetime, timedelta
from itertools import pairwise
from typing import Any

import pytest
from asyncua import ua
from asyncua.ua.uaerrors import UaStatusCodeError

from gateway.views.opcua.capabilities import FACETS, TRANSPORT
from gateway.views.opcua.subscriptions import is_news
from tests.harness.gateway.bus_peers import ticking
from tests.harness.gateway.opcua_peers import Notifications, Peer, Served, condition, monitor, peer, received, until

pytestmark = pytest.mark.xdist_group("opcua")
S = ua.StatusCodes
T = ua.TimestampsToReturn
V = ua.VariantType
PATH = "timed/state/x_m"


# -- timestamps


@pytest.mark.parametrize("timestamps", [T.Source, T.Server, T.Both, T.Neither], ids=lambda timestamps: timestamps.name)
def test_a_read_has_the_timestamps_asked_for(server: Served, timestamps: ua.TimestampsToReturn) -> None:
    async def session_work() -> list[ua.DataValue]:
        async with peer(server.port) as client:
            await client.await_status(PATH, S.Good)
            parameters = ua.ReadParameters(TimestampsToReturn=timestamps)
            parameters.NodesToRead = [
                ua.ReadValueId(NodeId=ua.NodeId(PATH, client.namespace), AttributeId=attribute)
                for attribute in (ua.AttributeIds.Value, ua.AttributeIds.DisplayName)
            ]
            return list(await client.client.uaclient.read(parameters))

    with ticking(server.gateway, "timed"):
        value, name = asyncio.run(session_work())

    assert (value.SourceTimestamp is not None) == (timestamps in (T.Source, T.Both))
    assert (value.ServerTimestamp is not None) == (timestamps in (T.Server, T.Both))
    assert name.SourceTimestamp is None  # only a value has a source
    if value.ServerTimestamp is not None:
        assert abs(value.ServerTimestamp - datetime.now(UTC)) < timedelta(seconds=30)


@pytest.mark.parametrize("timestamps", [T.Source, T.Server, T.Both, T.Neither], ids=lambda timestamps: timestamps.name)
def test_a_monitored_item_has_the_timestamps_asked_for(server: Served, timestamps: ua.TimestampsToReturn) -> None:
    notified = Notifications()

    async def session_work() -> None:
        async with peer(server.port) as client:
            await client.await_status("timed/state/sequence", S.Good)
            items = await monitor(client, notified, "timed/state/sequence", timestamps=timestamps)
            assert items[0].StatusCode.is_good()
            await received(notified, "timed/state/sequence", 3)

    with ticking(server.gateway, "timed"):
        asyncio.run(session_work())

    for value in notified.values["timed/state/sequence"]:
        assert (value.SourceTimestamp is not None) == (timestamps in (T.Source, T.Both))
        assert (value.ServerTimestamp is not None) == (timestamps in (T.Server, T.Both))


@pytest.mark.parametrize("timestamps", [T.Source, T.Server, T.Both], ids=lambda timestamps: timestamps.name)
def test_history_has_the_timestamps_asked_for(server: Served, timestamps: ua.TimestampsToReturn) -> None:
    async def session_work() -> list[ua.DataValue]:
        async with peer(server.port) as client:
            await client.await_status(PATH, S.Good)

            async def enough() -> list[ua.DataValue] | None:
                result = (await client.client.uaclient.history_read(history(client, timestamps)))[0]
                values = result.HistoryData.DataValues
                return values if len(values) > 3 else None

            return await until(enough, "history")

    with ticking(server.gateway, "timed"):
        values = asyncio.run(session_work())

    for value in values:
        assert (value.SourceTimestamp is not None) == (timestamps in (T.Source, T.Both))
        assert (value.ServerTimestamp is not None) == (timestamps in (T.Server, T.Both))
        if timestamps == T.Both:  # kept when it came, not when it was read
            assert abs(value.ServerTimestamp - value.SourceTimestamp) < timedelta(seconds=30)
    if timestamps == T.Both:
        assert len({value.ServerTimestamp for value in values}) > 1


def test_timestamps_that_do_not_exist_are_refused(server: Served) -> None:
    async def session_work() -> None:
        async with peer(server.port) as client:
            await client.await_status(PATH, S.Good)
            with pytest.raises(UaStatusCodeError, match="BadTimestampsToReturnInvalid"):
                await client.client.uaclient.history_read(history(client, T.Neither))
            with pytest.raises(UaStatusCodeError, match="BadTimestampsToReturnInvalid"):
                await client.client.uaclient.read(ua.ReadParameters(TimestampsToReturn=T.Invalid))
            with pytest.raises(UaStatusCodeError, match="BadTimestampsToReturnInvalid"):
                await monitor(client, Notifications(), PATH, timestamps=T.Invalid)

    with ticking(server.gateway, "timed"):
        asyncio.run(session_work())


def history(client: Peer, timestamps: ua.TimestampsToReturn) -> ua.HistoryReadParameters:
    """Return a request for the values of the last minute."""
    details = ua.ReadRawModifiedDetails(IsReadModified=False, NumValuesPerNode=100)
    details.StartTime, details.EndTime = datetime.now(UTC) - timedelta(minutes=1), datetime.now(UTC)
    parameters = ua.HistoryReadParameters(HistoryReadDetails=details, TimestampsToReturn=timestamps)
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
                await monitor(client, notified, *paths, timestamps=T.Source, filter_=data_filter(stamps=True))
                await received(notified, paths[-1], 1)
            for _ in range(200):  # 20 intervals at once
                gateway.state("burst", **values(0))
            last = 1_700_000_000_000_000_000 + (gateway.tick - 20) * 2_000_000

            async def came() -> bool | None:
                return True if notified.values["burst/state/host_time_ns"][-1].Value.Value >= last else None

            await until(came, "the last of the burst")

    asyncio.run(burst())

    values_at: dict[datetime, dict[str, Any]] = {}
    for name, path in zip(names, paths, strict=True):
        for value in notified.values[path][1:]:
            if value.StatusCode.is_good():
                values_at.setdefault(value.SourceTimestamp, {})[name] = value.Value.Value
    whole = [row for row in values_at.values() if len(row) == len(names)]
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

    async def session_work() -> int:
        async with peer(server.port) as client:
            await client.await_status(PATH, S.Good)
            return await client.write(f"timed/{path}", value)

    server.gateway.commands.clear()
    with ticking(server.gateway, "timed"):
        code = asyncio.run(session_work())
    return code, len(server.gateway.commands)


def test_an_argument_of_another_type_is_named(server: Served) -> None:
    async def session_work() -> list[tuple[int, list[int]]]:
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
        results = asyncio.run(session_work())

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
    sent, reported = None, []

    for n in range(41):
        value = ua.DataValue(ua.Variant(0.1 * n, V.Double))
        if is_news(sent, value, band):
            sent = value
            reported.append(n)

    assert reported == [0, 11, 22, 33]


def test_a_client_with_a_deadband_does_not_end_the_service_when_a_value_goes(server: Served) -> None:
    notified = Notifications()

    async def session_work() -> None:
        async with peer(server.port) as client:
            with ticking(server.gateway, "gone"):
                await client.await_status("gone/state/x_m", S.Good)
                paths = ("gone/state/x_m", "gone/link/state")
                await monitor(client, notified, *paths, timestamps=T.Both, filter_=data_filter(deadband=1e-6))
            server.gateway.status("gone", link="absent")
            await client.await_status("gone/state/x_m", S.BadNoCommunication)
            with ticking(server.gateway, "gone"):
                await client.await_status("gone/state/x_m", S.Good)

    asyncio.run(session_work())


@pytest.mark.parametrize(
    ("path", "attribute", "filter_"),
    [
        ("timed/state/x_m", ua.AttributeIds.Value, ua.EventFilter()),
        ("timed/state/x_m", ua.AttributeIds.Value, ua.AggregateFilter()),
        ("timed/state/x_m", ua.AttributeIds.Value, ua.ReadRawModifiedDetails()),
        ("timed", ua.AttributeIds.EventNotifier, ua.DataChangeFilter()),
        ("timed", ua.AttributeIds.EventNotifier, None),
    ],
)
def test_a_filter_that_does_not_fit_is_refused_and_ends_nothing(
    server: Served, path: str, attribute: ua.AttributeIds, filter_: Any
) -> None:
    async def session_work() -> None:
        async with peer(server.port) as client:
            await client.await_status(PATH, S.Good)
            item = (
                await monitor(client, Notifications(), path, timestamps=T.Both, filter_=filter_, attribute=attribute)
            )[0]
            assert item.StatusCode.value == S.BadMonitoredItemFilterUnsupported
            other = Notifications()
            assert (await monitor(client, other, PATH, timestamps=T.Both))[0].StatusCode.is_good()
            await received(other, PATH, 1)

    with ticking(server.gateway, "timed", values=lambda n: {"x_m": n * 1e-6}):
        asyncio.run(session_work())


@pytest.mark.parametrize(("attribute", "name"), [(99, ""), (13, "data_types")])
def test_a_select_clause_that_means_nothing_ends_nothing(server: Served, attribute: int, name: str) -> None:
    clause = ua.SimpleAttributeOperand(TypeDefinitionId=ua.NodeId(ua.ObjectIds.ConditionType), AttributeId=attribute)
    clause.BrowsePath = [ua.QualifiedName(name, 0)] if name else []

    board = f"clause{attribute}"

    async def session_work() -> None:
        async with peer(server.port) as client:
            await client.await_status(f"{board}/state/x_m", S.Good)
            strange = ua.EventFilter(SelectClauses=[clause])
            await monitor(
                client,
                Notifications(),
                board,
                timestamps=T.Both,
                filter_=strange,
                attribute=ua.AttributeIds.EventNotifier,
            )
            await condition(server, client, Notifications(), board)

    with ticking(server.gateway, board):
        asyncio.run(session_work())


def data_filter(*, deadband: float = 0.0, stamps: bool = False) -> ua.DataChangeFilter:
    trigger = ua.DataChangeTrigger.StatusValueTimestamp if stamps else ua.DataChangeTrigger.StatusValue
    kind = ua.DeadbandType.Absolute if deadband else ua.DeadbandType.None_
    return ua.DataChangeFilter(Trigger=trigger, DeadbandType=kind, DeadbandValue=deadband)


# -- what it says of itself


def test_the_server_says_what_it_supports(server: Served) -> None:
    async def session_work() -> list[Any]:
        async with peer(server.port) as client:
            nodes = (
                ua.ObjectIds.Server_ServerCapabilities_ServerProfileArray,
                ua.ObjectIds.Server_ServerCapabilities_LocaleIdArray,
                ua.ObjectIds.HistoryServerCapabilities_AccessHistoryDataCapability,
                ua.ObjectIds.HistoryServerCapabilities_ServerTimestampSupported,
            )
            return [await client.client.get_node(ua.NodeId(node)).read_value() for node in nodes]

    profiles, locales, has_history, has_server_timestamps = asyncio.run(session_work())

    assert {TRANSPORT, "http://opcfoundation.org/UA/SecurityPolicy#None", *FACETS} <= set(profiles)
    assert not [profile for profile in profiles if "Basic256" in profile or "UserName" in profile]
    assert (locales, has_history, has_server_timestamps) == (["en"], True, True)
