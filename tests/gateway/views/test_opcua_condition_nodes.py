"""A condition can be browsed: an instance of its type below the rig, with the values of its newest event."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest
from asyncua import ua

from protocol.bus import board51_pb2 as pb
from tests.harness.gateway.bus_peers import ticking
from tests.harness.gateway.opcua_peers import Notifications, Peer, Served, peer, until

pytestmark = pytest.mark.xdist_group("opcua")
ID, S = ua.ObjectIds, ua.StatusCodes
RIG = "conditioned"
CONDITION = f"{RIG}/alarm/divergence-x"


async def declared(client: Peer, kind: ua.NodeId, *, prefix: str = "") -> dict[str, tuple[Any, ...]]:
    """Mandatory declarations of a type and of all above it, by the path of browse names."""
    declarations: dict[str, tuple[Any, ...]] = {}
    node = client.client.get_node(kind)
    for child in await node.get_referenced_nodes(ID.Aggregates, ua.BrowseDirection.Forward):
        rules = await child.get_referenced_nodes(ID.HasModellingRule, ua.BrowseDirection.Forward)
        if [rule.nodeid.Identifier for rule in rules] == [ID.ModellingRule_Mandatory]:
            name = prefix + (await child.read_browse_name()).to_string()
            declarations[name] = await describe(child)
            if declarations[name][0] is ua.NodeClass.Variable:
                declarations |= await declared(client, child.nodeid, prefix=f"{name}/")
    if not prefix and kind != ua.NodeId(ID.BaseEventType):
        [above] = await node.get_referenced_nodes(ID.HasSubtype, ua.BrowseDirection.Inverse)
        declarations |= await declared(client, above.nodeid)
    return declarations


async def below(node: Any, prefix: str = "") -> dict[str, tuple[Any, ...]]:
    members: dict[str, tuple[Any, ...]] = {}
    for child in await node.get_referenced_nodes(ID.Aggregates, ua.BrowseDirection.Forward):
        name = prefix + (await child.read_browse_name()).to_string()
        members[name] = await describe(child)
        if members[name][0] is ua.NodeClass.Variable:
            members |= await below(child, f"{name}/")
    return members


async def describe(node: Any) -> tuple[Any, ...]:
    """Class of a node, and of a variable its data type and type definition."""
    kind = await node.read_node_class()
    is_variable = kind is ua.NodeClass.Variable
    return (kind, await node.read_data_type(), await node.read_type_definition()) if is_variable else (kind,)


def test_a_condition_is_browsed_read_heard_and_acknowledged(server: Served) -> None:
    notified = Notifications()

    async def session_work() -> None:
        async with peer(server.port) as client:
            await client.await_status(f"{RIG}/state/x_m", S.Good)
            alarm = pb.Alarm(name="divergence-x", active=True, text="x is off", value=9.0)
            server.gateway.send("twin/alarm", alarm, RIG)

            async def raised() -> Any:
                conditions = await client.node(RIG).get_referenced_nodes(ID.HasCondition, ua.BrowseDirection.Forward)
                return next((node for node in conditions if node.nodeid.Identifier == CONDITION), None)

            node = await until(raised, "the condition of the rig")
            assert (await node.read_type_definition()).Identifier == ID.AlarmConditionType
            assert node in await client.node(f"{RIG}/alarms").get_children()
            members, required = await below(node), await declared(client, ua.NodeId(ID.AlarmConditionType))
            assert {name: members.get(name) for name in required} == required
            assert {"0:Acknowledge", "0:AddComment", "0:Enable", "0:Disable", "0:AckedState/0:Id"} <= required.keys()
            for name in members:
                if members[name][0] is ua.NodeClass.Variable:
                    path = "/".join([CONDITION, *(part.partition(":")[2] for part in name.split("/"))])
                    await client.node(path).read_value()  # raises where the status is bad

            assert (await value(client, "Message")).Text == "x is off"
            assert await value(client, "SourceNode") == client.node(RIG).nodeid
            assert [await value(client, f"{state}State/Id") for state in ("Active", "Acked")] == [True, False]
            subscription = await client.client.create_subscription(20, notified)
            await subscription.subscribe_data_change(client.node(f"{CONDITION}/AckedState/Id"))
            method = await node.get_child("0:Acknowledge")
            request = ua.CallMethodRequest(node.nodeid, method.nodeid)
            request.InputArguments = [
                ua.Variant(await value(client, "EventId"), ua.VariantType.ByteString),
                ua.Variant(ua.LocalizedText("a cold coil")),
            ]
            [called] = await client.client.uaclient.call([request])
            assert called.StatusCode.value == S.Good

            async def is_reported() -> bool | None:
                return True if [v.Value.Value for v in notified.values[f"{CONDITION}/AckedState/Id"]][-1] else None

            await until(is_reported, "the acknowledgement")
            assert (await value(client, "Comment")).Text == "a cold coil"

    with ticking(server.gateway, RIG):
        asyncio.run(session_work())


def test_a_condition_is_shelved_for_a_time_and_brought_back(server: Served) -> None:
    rig, shelving = f"{RIG}-shelved", f"{RIG}-shelved/alarm/divergence-x/ShelvingState"
    timed, unshelve, once = (
        ua.NodeId(getattr(ID, f"AlarmConditionType_ShelvingState_{name}"))
        for name in ("TimedShelve", "Unshelve", "OneShotShelve")
    )

    async def session_work() -> None:
        async with peer(server.port) as client:
            await client.await_status(f"{rig}/state/x_m", S.Good)
            server.gateway.send("twin/alarm", pb.Alarm(name="divergence-x", active=True, text="x is off"), rig)

            async def call(method: ua.NodeId, *inputs: float, at: str = shelving) -> int:
                request = ua.CallMethodRequest(client.node(at).nodeid, method)
                request.InputArguments = [ua.Variant(value, ua.VariantType.Double) for value in inputs]
                return int((await client.client.uaclient.call([request]))[0].StatusCode.value)

            async def shelved(*, expected: bool) -> None:
                path = f"{rig}/alarm/divergence-x/SuppressedOrShelved"

                async def look() -> bool | None:
                    return True if await client.node(path).read_value() is expected else None

                await until(look, "the alarm on the shelf, or back")

            await shelved(expected=False)
            methods = await client.node(shelving).get_children(nodeclassmask=ua.NodeClass.Method)
            assert {timed, unshelve} <= {method.nodeid for method in methods}
            assert await call(unshelve) == S.BadConditionNotShelved
            assert await call(once) == S.BadNotSupported
            assert [await call(timed, ms) for ms in (0.0, -1.0, 1e12)] == 3 * [S.BadShelvingTimeOutOfRange]

            assert await call(timed, 600e3) == S.Good
            await shelved(expected=True)
            state = await client.node(f"{shelving}/CurrentState/Id").read_value()
            assert state == ua.NodeId(ID.ShelvedStateMachineType_TimedShelved)
            left_ms = [await client.node(f"{shelving}/UnshelveTime").read_value() for _ in range(2)]
            assert 600e3 > left_ms[0] > left_ms[1] > 0.0
            assert server.gateway.commands[-1][1].acknowledge.shelve_s == 600.0

            assert await call(unshelve, at=f"{rig}/alarm/divergence-x") == S.Good  # of the condition itself, too
            await shelved(expected=False)
            assert await client.node(f"{shelving}/UnshelveTime").read_value() == 0.0

    with ticking(server.gateway, rig):
        asyncio.run(session_work())


async def value(client: Peer, path: str) -> Any:
    return await client.node(f"{CONDITION}/{path}").read_value()
