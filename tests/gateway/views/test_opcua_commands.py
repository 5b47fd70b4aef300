"""Commands and acknowledgements through the OPC UA server, over a real bus, by asyncua's client."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest
from asyncua import ua

from protocol.bus import board51_pb2 as pb
from tests.harness.gateway.bus_peers import ticking
from tests.harness.gateway.opcua_peers import Notifications, Served, peer, until

pytestmark = pytest.mark.xdist_group("opcua")
S = ua.StatusCodes
DOUBLE = ua.VariantType.Double


@pytest.fixture(autouse=True)
def _limits(server: Served) -> None:
    server.gateway.answer = answer


def answer(_: str, command: pb.Command) -> pb.CommandReply:
    """Answer like a gateway with limits of 0.3 to 5.2 mm."""
    if command.WhichOneof("what") == "set_reference" and not 0.3e-3 <= command.set_reference.x_ref_m <= 5.2e-3:
        text = "x_ref is outside the gateway's limits."
        return pb.CommandReply(id=command.id, refused_by="gateway", reason="out-of-range", text=text)
    if command.WhichOneof("what") == "capture":
        return pb.CommandReply(id=command.id, refused_by="gateway", reason="wrong-mode", text="not now")
    return pb.CommandReply(id=command.id, accepted=True, tick=1234)


def test_setpoints_are_commands_and_refusals_are_status_codes(server: Served) -> None:
    async def session_work() -> None:
        async with peer(server.port) as client:
            await client.await_status("rig/state/x_m", S.Good)
            within = await client.write("rig/setpoint/x_ref_m", ua.Variant(2e-3, DOUBLE))
            outside = await client.write("rig/setpoint/x_ref_m", ua.Variant(9e-3, DOUBLE))
            mode = await client.write("rig/setpoint/mode", ua.Variant(2, ua.VariantType.UInt32))
            measured = await client.write("rig/state/x_m", ua.Variant(2e-3, DOUBLE))
            unknown = await client.write("rig/nothing", ua.Variant(2e-3, DOUBLE))

            assert (within, outside, mode) == (S.Good, S.BadOutOfRange, S.Good)
            assert (measured, unknown) == (S.BadNotWritable, S.BadNodeIdUnknown)
            assert (await client.read("rig/state/x_m")).Value.Value == 3e-3

    server.gateway.commands.clear()
    with ticking(server.gateway, "rig"):
        asyncio.run(session_work())

    sent = [command for _, command in server.gateway.commands]
    assert [c.WhichOneof("what") for c in sent] == ["set_reference", "set_reference", "set_mode"]
    assert [c.set_reference.x_ref_m for c in sent[:2]] == [2e-3, 9e-3]
    assert {c.who for c in sent} == {"anonymous"}


def test_methods_are_commands_and_say_why_they_were_refused(server: Served) -> None:
    async def session_work() -> None:
        async with peer(server.port) as client:
            await client.await_status("rig/state/x_m", S.Good)
            stop = await client.call("rig", "Stop")
            far = await client.call("rig", "SetReference", ua.Variant(9e-3, DOUBLE))
            capture = await client.call("rig", "Capture", *[ua.Variant(v, DOUBLE) for v in (0.0, 1.0, 0.04, 0.004)])
            incomplete = await client.call("rig", "SetReference")
            other = await client.call("rig", "Nothing")

            assert (stop.StatusCode.value, stop.OutputArguments[3].Value) == (S.Good, 1234)
            assert far.StatusCode.value == S.BadOutOfRange
            assert [v.Value for v in far.OutputArguments[:3]] == [
                False, "out-of-range", "x_ref is outside the gateway's limits.",
            ]  # fmt: skip
            assert capture.StatusCode.value == S.BadInvalidState
            assert incomplete.StatusCode.value == S.BadArgumentsMissing
            assert other.StatusCode.value == S.BadMethodInvalid
            record = pb.CommandRecord(
                command=pb.Command(who="eva", stop=pb.Stop()), reply=pb.CommandReply(reason="slew")
            )
            server.gateway.send("command/record", record, "rig")

            async def reason() -> str | None:
                value = (await client.read("rig/last_command/reason")).Value.Value
                return "slew" if value == "slew" else None

            await until(reason, "reason of the last command")

    with ticking(server.gateway, "rig"):
        asyncio.run(session_work())


def test_no_gateway_is_no_communication(server: Served) -> None:
    def silent(_: str, command: pb.Command) -> pb.CommandReply:
        return pb.CommandReply(id=command.id, refused_by="link", reason="link-down", text="the board is not there")

    async def session_work() -> int:
        async with peer(server.port) as client:
            await client.await_status("rig/state/x_m", S.Good)
            return int((await client.call("rig", "Stop")).StatusCode.value)

    usual, server.gateway.answer = server.gateway.answer, silent
    with ticking(server.gateway, "rig"):
        code = asyncio.run(session_work())
    server.gateway.answer = usual

    assert code == S.BadNoCommunication


def test_alarms_are_conditions_that_can_be_acknowledged(server: Served) -> None:
    notified = Notifications()

    async def session_work() -> None:
        async with peer(server.port) as client:
            await client.await_status("alarming/state/x_m", S.Good)
            subscription = await client.client.create_subscription(50, notified)
            await subscription.subscribe_alarms_and_conditions(evtypes=ua.ObjectIds.AlarmConditionType)
            alarm = pb.Alarm(name="divergence-x", active=True, text="x is off", value=9.0)
            server.gateway.send("twin/alarm", alarm, "alarming")

            async def condition(acknowledged: bool) -> Any:
                return next(
                    (
                        e
                        for e in notified.events
                        if getattr(e, "ConditionName", "") == "divergence-x"
                        and getattr(e, "AckedState/Id") is acknowledged
                    ),
                    None,
                )

            came = await until(lambda: condition(False), "condition")
            assert (getattr(came, "ActiveState/Id"), came.Retain, came.SourceName) == (True, True, "alarming")
            assert came.Message.Text == "x is off"
            assert came.Severity == 500
            request = ua.CallMethodRequest()
            request.ObjectId = ua.NodeId("alarming/alarm/divergence-x", client.namespace)
            request.MethodId = ua.NodeId(ua.ObjectIds.AcknowledgeableConditionType_Acknowledge)
            codes = []
            for event_id in (b"of another event", came.EventId, came.EventId):
                request.InputArguments = [ua.Variant(event_id), ua.Variant(ua.LocalizedText("a cold coil"))]
                codes.append((await client.client.uaclient.call([request]))[0].StatusCode.value)
            assert codes == [S.BadEventIdUnknown, S.Good, S.BadConditionBranchAlreadyAcked]
            confirmed = await until(lambda: condition(True), "acknowledged condition")
            assert (confirmed.ClientUserId, confirmed.Comment.Text) == ("anonymous", "a cold coil")
            assert (await client.read("alarming/alarms/unacknowledged")).Value.Value == 0
            again = await client.call("alarming", "Acknowledge", ua.Variant("divergence-x"), ua.Variant(""))
            assert again.StatusCode.value == S.BadConditionBranchAlreadyAcked
            assert again.OutputArguments[1].Value == "no-alarm"
            assert [command.acknowledge.alarm for _, command in server.gateway.commands] == ["divergence-x"]

    server.gateway.commands.clear()
    with ticking(server.gateway, "alarming"):
        asyncio.run(session_work())
