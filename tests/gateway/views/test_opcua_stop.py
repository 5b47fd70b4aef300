"""STOP over OPC UA beside requests that are not answered, on one connection, as a SCADA system has it."""

from __future__ import annotations

import asyncio

import pytest
from asyncua import ua

from protocol.bus import board51_pb2 as pb
from tests.harness.gateway.bus_peers import PlayedGateway, ticking
from tests.harness.gateway.opcua_peers import Served, peer, until
from tests.patience import HANG_S

pytestmark = pytest.mark.xdist_group("opcua")
S = ua.StatusCodes
BOARDS = ("rig", "dead")
CLOSED = ua.Variant(2, ua.VariantType.UInt32)


def answer(key: str, command: pb.Command) -> pb.CommandReply | None:
    """Answer commands for `rig` and STOP; the commands for `dead` wait."""
    if "/dead/" in key and command.WhichOneof("what") != "stop":
        return None
    return pb.CommandReply(id=command.id, accepted=True, tick=7)


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
            waits = not any(write.done() for write in writes)
            server.gateway.give_up()
            await asyncio.gather(*writes)
            return [stop.StatusCode.value for stop in stops], waits

    server.gateway.answer = answer
    with ticking(server.gateway, *BOARDS):
        codes, waits = asyncio.run(play())

    assert codes == [S.Good, S.Good]
    assert waits, "the writes were waiting all the time"
