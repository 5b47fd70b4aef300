"""A client gets the sampling interval that it was promised, and the newest of what changes."""

from __future__ import annotations

import asyncio
from itertools import pairwise
from typing import Any

import pytest
from asyncua import ua

from gateway.access.roles import Role
from gateway.views.opcua.server import OpcuaSettings
from protocol.bus import board51_pb2 as pb
from tests.harness.gateway.bus_peers import PlayedGateway, played_gateway, ticking
from tests.harness.gateway.opcua_peers import Notifications, Peer, Served, peer, received, subscribe, until

pytestmark = pytest.mark.xdist_group("opcua")
S = ua.StatusCodes
INTERVAL_MS = 20.0


async def revised(client: Peer, path: str, *requested_ms: float, publishing_ms: float = 100.0) -> list[float]:
    """The sampling intervals that the server promises, for new items and for modified ones."""
    subscription = await client.client.create_subscription(publishing_ms, Notifications())
    revised_ms: list[float] = []
    for interval_ms in requested_ms:
        request = ua.MonitoredItemCreateRequest(MonitoringMode=ua.MonitoringMode.Reporting)
        request.ItemToMonitor = ua.ReadValueId(NodeId=client.node(path).nodeid, AttributeId=ua.AttributeIds.Value)
        request.RequestedParameters = ua.MonitoringParameters(SamplingInterval=interval_ms, QueueSize=10)
        creation = ua.CreateMonitoredItemsParameters(
            SubscriptionId=subscription.subscription_id, ItemsToCreate=[request]
        )
        [created] = await client.client.uaclient.create_monitored_items(creation)
        created.StatusCode.check()
        change = ua.MonitoredItemModifyRequest(created.MonitoredItemId, request.RequestedParameters)
        modify = ua.ModifyMonitoredItemsParameters(SubscriptionId=subscription.subscription_id, ItemsToModify=[change])
        [modified] = await client.client.uaclient.modify_monitored_items(modify)
        assert modified.RevisedSamplingInterval == created.RevisedSamplingInterval
        revised_ms.append(created.RevisedSamplingInterval)
    return revised_ms


def test_a_promised_interval_is_a_whole_number_of_the_servers(server: Served) -> None:
    requested = (0.0, 1.0, 20.0, 21.0, 1000.0, -1.0, float("nan"), 1e12)

    async def session_work() -> tuple[list[list[float]], Any, Any]:
        async with peer(server.port) as client:
            await client.await_status("rig/state/x_m", S.Good)
            paths = ("state/x_m", "state/x_m/max", "status/link", "last_command/text", "setpoint/mode")
            lowest = await client.client.get_node(
                ua.NodeId(ua.ObjectIds.Server_ServerCapabilities_MinSupportedSampleRate)
            ).read_value()
            declared = await client.node("rig/setpoint/mode").read_attribute(ua.AttributeIds.MinimumSamplingInterval)
            return [await revised(client, f"rig/{path}", *requested) for path in paths], lowest, declared.Value.Value

    with ticking(server.gateway, "rig"):
        (value, extreme, status, last, setpoint), lowest, declared = asyncio.run(session_work())

    assert value == setpoint == [20.0, 20.0, 20.0, 40.0, 1000.0, 100.0, 100.0, 3_600_000.0]
    assert extreme == status == last == [INTERVAL_MS] * len(requested)  # a spike or a change would be lost
    assert lowest == declared == INTERVAL_MS


def test_a_slow_item_gets_its_share_of_the_intervals_and_every_extreme(server: Served) -> None:
    paths = ("slow/state/x_m", "slow/state/x_m/max", "slow/state/i_c_a")
    notified = Notifications()

    async def session_work() -> None:
        async with peer(server.port) as client:
            await client.await_status("slow/state/x_m", S.Good)
            subscription = await client.client.create_subscription(20.0, notified)
            for path, sampling_ms in zip(paths, (100.0, 100.0, 0.0), strict=True):
                await subscription.subscribe_data_change(
                    client.node(path), queuesize=100, sampling_interval=sampling_ms
                )
            await received(notified, paths[0], 12)

    with ticking(server.gateway, "slow", values=lambda n: {"x_m": n * 1e-6, "i_c_a": n * 1e-6}):
        asyncio.run(session_work())

    steps = {}
    for path in paths:
        ticks = [round(v.Value.Value * 1e6) for v in notified.values[path] if v.StatusCode.is_good()]
        steps[path] = {b - a for a, b in pairwise(ticks[1:])}
    # 10 ticks in an interval of 20 ms; a feed that was held up is silent for a moment, which is told at once
    assert steps == {paths[0]: {50}, paths[1]: {10}, paths[2]: {10}}


def test_a_slow_item_is_told_of_a_loss_at_once(server: Served) -> None:
    notified = Notifications()

    async def session_work() -> None:
        async with peer(server.port) as client:
            with ticking(server.gateway, "lost"):
                await client.await_status("lost/state/x_m", S.Good)
                subscription = await client.client.create_subscription(20.0, notified)
                await subscription.subscribe_data_change(client.node("lost/state/x_m"), sampling_interval=3_600_000.0)
                await received(notified, "lost/state/x_m", 1)

            async def lost() -> bool | None:
                return True if not notified.values["lost/state/x_m"][-1].StatusCode.is_good() else None

            await until(lost, "a status that is not good")

    asyncio.run(session_work())


@pytest.mark.slow
def test_the_text_of_a_refusal_goes_with_the_next_success() -> None:
    """For a subscriber, too, that came between the two, within one interval of the server."""
    path = "rig/last_command/text"
    before, between = Notifications(), Notifications()

    def end(gateway: PlayedGateway, text: str) -> None:
        command, reply = pb.Command(who="eva", stop=pb.Stop()), pb.CommandReply(accepted=not text, text=text)
        gateway.send("command/record", pb.CommandRecord(command=command, reply=reply), "rig")

    async def session_work(server: Served) -> None:
        async with peer(server.port) as client:

            async def reads(text: str) -> bool | None:
                return True if (await client.read(path)).Value.Value == text else None

            async def hears() -> bool | None:
                return True if [value.Value.Value for value in between.values[path]][-1] == "" else None

            await client.await_status("rig/state/x_m", S.Good)
            end(server.gateway, "")
            await until(lambda: reads(""), "the first success")
            first = await subscribe(client, before, path, "rig/state/x_m")
            await received(before, "rig/state/x_m", 3)  # an interval has passed
            await first.delete()
            end(server.gateway, "too far")
            await until(lambda: reads("too far"), "the refusal")
            await subscribe(client, between, path)
            await received(between, path, 1)
            end(server.gateway, "")
            await until(hears, "the second success")

    with (
        played_gateway() as gateway,
        ticking(gateway, "rig", values=lambda n: {"x_m": n * 1e-6}),
        Served(gateway, OpcuaSettings(port=0, rate_hz=0.5, anonymous=Role.ENGINEER)) as slow,
    ):
        asyncio.run(session_work(slow))
    assert [value.Value.Value for value in between.values[path]] == ["too far", ""]
