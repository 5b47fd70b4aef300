"""The OPC UA server over a real bus, asked by asyncua's client: values, truth of status, history."""

from __future__ import annotations

import asyncio
from datetime import UTC, datetime, timedelta
from itertools import pairwise
from typing import Any

import pytest
from asyncua import ua

from gateway.views.opcua.server import OpcuaSettings
from protocol.bus import board51_pb2 as pb
from protocol.errors import ServiceError
from protocol.wire.messages import Flag
from tests.harness.gateway.bus_peers import ticking
from tests.harness.gateway.heavy_rig import HEAVY
from tests.harness.gateway.opcua_peers import Notifications, Peer, Served, peer, received, subscribe, until

pytestmark = pytest.mark.xdist_group("opcua")
S = ua.StatusCodes
DOUBLE = ua.VariantType.Double


def test_a_board_has_values_units_ranges_and_descriptions(server: Served) -> None:
    async def session_work() -> None:
        async with peer(server.port) as client:
            x = await client.await_status("units/state/x_m", S.Good)
            unit, span = await client.read("units/state/x_m/EngineeringUnits"), None
            span = await until(lambda: known(client, "units/state/x_ref_m/EURange"), "range")
            node = client.node("units/state/u_c_v")
            mode = await client.read("units/state/mode")
            words = await client.read("units/state/mode/EnumStrings")

            assert x.Value.Value == 3e-3
            assert abs(x.SourceTimestamp - datetime.now(UTC)) < timedelta(seconds=2)
            assert unit.Value.Value.DisplayName.Text == "m"
            assert (span.Low, span.High) == (0.3e-3, 5.2e-3)
            difference = await known(client, "units/twin/divergence/x_m.error/EURange")
            assert difference.Low == -difference.High < 0
            speed = client.node("units/twin/state/v_m_s")  # nobody knows its range: it promises none
            assert (await speed.read_type_definition()).Identifier == ua.ObjectIds.AnalogUnitType
            assert (await node.read_description()).Text == "in force from this tick to the next"
            assert (await node.read_type_definition()).Identifier == ua.ObjectIds.AnalogItemType
            assert words.Value.Value[mode.Value.Value].Text == "MODE_CLOSED_LOOP"
            assert list((await client.read("units/parameters/gains")).Value.Value) == [0.49, 1700.0, 17.7, -17600.0]
            assert (await client.read("units/twin/state/x_m")).StatusCode.value == S.BadWaitingForInitialData
            names = [child.nodeid.Identifier for child in await client.node("units").get_children()]
            assert {"units/state", "units/twin", "units/SetReference", "units/Stop"} <= set(names)

    with ticking(server.gateway, "units"):
        asyncio.run(session_work())


def test_a_plant_that_nobody_stated_has_no_values_and_one_that_was_stated_is_read_only(server: Served) -> None:
    async def send(client: Peer, card: pb.PlantCard, status: int) -> None:
        async def is_read() -> bool | None:
            server.gateway.send("plant", card, "card")
            return True if (await client.read("card/plant/plant.mass_kg")).StatusCode.value == status else None

        await until(is_read, "the card")

    async def session_work() -> None:
        async with peer(server.port) as client:
            await client.await_status("card/state/x_m", S.Good)
            await send(client, pb.PlantCard(), S.BadDataUnavailable)
            await send(client, pb.PlantCard(plant=HEAVY, who="ana", stated_ns=5), S.Good)
            assert (await client.read("card/plant/plant.mass_kg")).Value.Value == 20e-3
            assert (await client.read("card/plant/who")).Value.Value == "ana"
            diameter = await client.read("card/plant/plant.ball_diameter_m")
            assert diameter.StatusCode.value == S.BadDataUnavailable
            with pytest.raises(ua.UaStatusCodeError):
                await client.node("card/plant/plant.mass_kg").write_value(1.0)
            names = [child.nodeid.Identifier for child in await client.node("card").get_children()]
            assert "card/plant" in names
            assert "card/SetPlant" not in names

    with ticking(server.gateway, "card"):
        asyncio.run(session_work())


async def known(client: Peer, path: str) -> Any:
    value = (await client.read(path)).Value
    return None if value is None else value.Value


def test_a_spike_of_one_tick_is_in_the_maximum(server: Served) -> None:
    notified = Notifications()

    async def session_work() -> None:
        async with peer(server.port) as client:
            await client.await_status("spike/state/x_m", S.Good)
            await subscribe(client, notified, "spike/state/x_m", "spike/state/x_m/max", "spike/state/x_m/min")
            await received(notified, "spike/state/x_m/min", 1)
            server.gateway.state("spike", x_m=4.5e-3)

            async def has_spike() -> bool | None:
                maxima = [v.Value.Value for v in notified.values.get("spike/state/x_m/max", [])]
                return True if 4.5e-3 in maxima else None

            await until(has_spike, "spike")

    with ticking(server.gateway, "spike"):
        asyncio.run(session_work())

    assert {v.Value.Value for v in notified.values["spike/state/x_m/min"]} == {3e-3}


def test_a_subscriber_at_50_hz_gets_every_interval_in_order(server: Served) -> None:
    notified, paths = Notifications(), [f"fast/state/{name}" for name in ("i_c_a", "x_m", "u_c_v")]

    async def session_work() -> None:
        async with peer(server.port) as client:
            await client.await_status("fast/state/x_m", S.Good)
            await subscribe(client, notified, *paths)
            await received(notified, paths[-1], 40)

    with ticking(server.gateway, "fast", values=lambda n: {"i_c_a": n * 1e-6, "x_m": n * 1e-6, "u_c_v": n * 1e-6}):
        asyncio.run(session_work())

    for path in paths:
        # A feed that a busy machine holds up is silent for a moment, and called so.
        values = [v.Value.Value for v in notified.values[path] if v.StatusCode.is_good()]
        ticks = [round(v * 1e6) for v in values]
        assert len(values) > 20  # ticks of 2 ms come every 4 ms here: 25 intervals of 10 ticks per second
        assert all(b - a == 10 for a, b in pairwise(ticks[1:])), ticks


def test_the_status_tells_the_truth_about_a_board_that_falls_silent(server: Served) -> None:
    async def session_work() -> None:
        async with peer(server.port) as client:
            with ticking(server.gateway, "silent"):
                await client.await_status("silent/state/x_m", S.Good)
            stale = await client.await_status("silent/state/x_m", S.UncertainLastUsableValue, 2.0)
            assert stale.Value.Value == 3e-3
            server.gateway.status("silent", link="absent")
            status = await client.await_status("silent/state/x_m", S.BadNoCommunication, 2.0)
            assert status.Value.Value is None
            assert (await client.read("silent/link/state")).Value.Value == "absent"
            with ticking(server.gateway, "silent"):
                await client.await_status("silent/state/x_m", S.Good)

    asyncio.run(session_work())


def test_a_subscriber_is_told_of_a_loss_without_a_new_sample(server: Served) -> None:
    notified = Notifications()

    async def session_work() -> None:
        async with peer(server.port) as client:
            with ticking(server.gateway, "lost"):
                await client.await_status("lost/state/x_m", S.Good)
                await subscribe(client, notified, "lost/state/x_m")
                await received(notified, "lost/state/x_m", 1)

            async def is_reported() -> bool | None:
                newest = notified.values["lost/state/x_m"][-1]
                return True if newest.StatusCode.value == S.UncertainLastUsableValue else None

            await until(is_reported, "status")

    asyncio.run(session_work())


def test_no_value_from_before_an_outage_is_called_good_after_it(server: Served) -> None:
    notified = Notifications()

    async def session_work() -> None:
        async with peer(server.port) as client:
            with ticking(server.gateway, "back"):
                await client.await_status("back/state/x_m", S.Good)
            await client.await_status("back/state/x_m", S.UncertainLastUsableValue, 5.0)
            await subscribe(client, notified, "back/state/x_m", "back/link/state")
            await received(notified, "back/link/state", 1)
            server.gateway.state("back", x_m=4e-3)  # one sample: live, and no interval yet
            await received(notified, "back/link/state", 2)
            with ticking(server.gateway, "back", values=lambda _: {"x_m": 4e-3}):
                await client.await_status("back/state/x_m", S.Good)
                await received(notified, "back/state/x_m", 2)

    asyncio.run(session_work())

    assert [v.Value.Value for v in notified.values["back/link/state"]][:2] == ["silent", "live"]
    good = [v.Value.Value for v in notified.values["back/state/x_m"] if v.StatusCode.value == S.Good]
    assert set(good) == {4e-3}


def test_faults_and_clipping_are_in_the_status_of_the_signal(server: Served) -> None:
    flags = [0]

    async def session_work() -> None:
        async with peer(server.port) as client:
            await client.await_status("faulty/state/x_m", S.Good)
            flags[0] = Flag.POSITION_RANGE
            await client.await_status("faulty/state/x_m", S.UncertainSensorNotAccurate)
            assert (await client.read("faulty/state/i_c_a")).StatusCode.value == S.Good
            fault = pb.Event(name="sensor-fault", severity="fault", tick=server.gateway.tick, session=1)
            flags[0] = Flag.FAULT
            server.gateway.send("event", fault, "faulty")
            await client.await_status("faulty/state/x_m", S.BadSensorFailure)
            assert (await client.read("faulty/alarms/active")).Value.Value == 1
            flags[0] = 0
            await client.await_status("faulty/state/x_m", S.Good)

    with ticking(server.gateway, "faulty", values=lambda _: {"flags": flags[0]}):
        asyncio.run(session_work())


def test_a_twin_out_of_step_is_uncertain(server: Served) -> None:
    def twin(sync: str) -> None:
        state = pb.TwinState(tick=server.gateway.tick, session=1, x_m=3e-3, sync=sync)
        server.gateway.send("twin/state", state, "stepping")

    async def session_work() -> None:
        async with peer(server.port) as client:
            await client.await_status("stepping/state/x_m", S.Good)

            async def with_sync(sync: str, code: int) -> ua.DataValue | None:
                twin(sync)
                value = await client.read("stepping/twin/state/x_m")
                return value if value.StatusCode.value == code else None

            await until(lambda: with_sync("in-step", S.Good), "good twin")
            await until(lambda: with_sync("out-of-step", S.UncertainSubNormal), "uncertain twin")

    with ticking(server.gateway, "stepping"):
        asyncio.run(session_work())


def test_the_last_minutes_can_be_read(server: Served) -> None:
    async def session_work() -> None:
        async with peer(server.port) as client:
            await client.await_status("past/state/x_m", S.Good)
            node, start = client.node("past/state/x_m"), datetime.now(UTC) - timedelta(minutes=1)

            async def enough() -> list[ua.DataValue] | None:
                notified: list[ua.DataValue] = await node.read_raw_history(start, datetime.now(UTC))
                return notified if len(notified) >= 12 else None

            end = (await until(enough, "history"))[-1].SourceTimestamp
            values = await node.read_raw_history(start, end)
            highest = await client.node("past/state/x_m/max").read_raw_history(start, end)

            assert len(values) >= 12
            assert len(highest) == len(values)
            stamps = [v.SourceTimestamp for v in values]
            assert stamps == sorted(stamps)
            assert (await node.read_attribute(ua.AttributeIds.Historizing)).Value.Value is True

    with ticking(server.gateway, "past"):
        asyncio.run(session_work())


def test_an_empty_history_says_why_it_is_empty(server: Served) -> None:
    async def session_work() -> list[int]:
        async with peer(server.port) as client:
            await client.await_status("old/state/x_m", S.Good)
            details = ua.ReadRawModifiedDetails(IsReadModified=False, NumValuesPerNode=10)
            details.StartTime, details.EndTime = datetime(2001, 1, 1, tzinfo=UTC), datetime(2001, 1, 2, tzinfo=UTC)
            request = ua.HistoryReadParameters(HistoryReadDetails=details)
            request.NodesToRead = [
                ua.HistoryReadValueId(NodeId=ua.NodeId(path, client.namespace))
                for path in ("old/state/x_m", "old/status/link", "old/nothing")
            ]
            return [result.StatusCode.value for result in await client.client.uaclient.history_read(request)]

    with ticking(server.gateway, "old"):
        codes = asyncio.run(session_work())

    assert codes == [S.GoodNoData, S.BadHistoryOperationUnsupported, S.BadNodeIdUnknown]


def test_a_client_that_wants_everything_at_1_ms_gets_a_bounded_service(server: Served) -> None:
    notified = Notifications()

    async def session_work() -> int:
        async with peer(server.port) as client:
            await client.await_status("greedy/state/x_m", S.Good)
            nodes, folders = list[Any](), [client.node("greedy")]
            while folders:
                for child in await folders.pop().get_children():
                    folders.append(child)
                    if await child.read_node_class() is ua.NodeClass.Variable:
                        nodes.append(child)
            subscription = await client.client.create_subscription(1, notified)
            await subscription.subscribe_data_change(nodes)
            async with peer(server.port) as other:  # somebody else is served meanwhile
                await other.read("greedy/state/x_m")
            return len(nodes)

    with ticking(server.gateway, "greedy"):
        count = asyncio.run(session_work())

    assert count > 150


def test_a_port_in_use_is_said_in_one_line(server: Served) -> None:
    with pytest.raises(ServiceError, match="cannot listen on") as error:
        with Served(server.gateway, OpcuaSettings(port=server.port)):
            pass

    assert "--listen" in str(error.value)
