"""STOP over OPC UA beside requests that are not answered, on one connection, as a SCADA system has it."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator

import pytest
from asyncua import ua

from gateway.access.roles import Role
from gateway.views.opcua.server import OpcuaSettings
from protocol.bus import board51_pb2 as pb
from tests.harness.gateway.bus_peers import PlayedGateway, played_gateway, ticking
from tests.harness.gateway.opcua_peers import Served, peer, until
from tests.patience import HANG_S

S = ua.StatusCodes
BOARDS = ("rig", "dead")
CLOSED = ua.Variant(2, ua.VariantType.UInt32)


@pytest.fixture
def server() -> Iterator[Served]:
    """The gateway answers what is for `rig` and STOP; the commands for `dead` wait."""

    def answer(key: str, command: pb.Command) -> pb.CommandReply | None:
        if "/dead/" in key and command.WhichOneof("what") != "stop":
            return None
        return pb.CommandReply(id=command.id, accepted=True, tick=7)

    with played_gateway() as gateway:
        gateway.answer = answer
        with (
            Served(gateway, OpcuaSettings(port=0, anonymous=Role.ENGINEER)) as served,
            ticking(gateway, *BOARDS),
        ):
            yield served
            gateway.give_up()


def waiting(gateway: PlayedGateway) -> int:
    return len(gateway.unanswered)


def test_a_stop_waits_for_no_other_request_of_its_connection(server: Served) -> None:
    async def play() -> tuple[list[int], bool]:
        async with peer(server.port) as client:
            for board in BOARDS:
                await client.await_status(f"{board}/setpoint/mode", S.Good)
            writes = [asyncio.create_task(client.write("dead/setpoint/mode", CLOSED)) for _ in range(5)]

            async def all_wait() -> bool | None:
                return True if waiting(server.gateway) == len(writes) else None

            await until(all_wait, "five writes that are not answered")
            stops = [await asyncio.wait_for(client.call(board, "Stop"), HANG_S) for board in BOARDS]
            still = not any(write.done() for write in writes)
            server.gateway.give_up()
            await asyncio.gather(*writes)
            return [stop.StatusCode.value for stop in stops], still

    codes, still = asyncio.run(play())

    assert codes == [S.Good, S.Good]
    assert still, "the writes were waiting all the time"
