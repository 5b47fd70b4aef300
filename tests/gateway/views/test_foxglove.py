"""The live Foxglove WebSocket, read by a client of its protocol."""

from __future__ import annotations

import asyncio
import base64
import json
import struct
from collections.abc import Iterator
from typing import Any

import pytest
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
from websockets.asyncio.client import connect
from websockets.typing import Subprotocol

from gateway.views.foxglove.server import FoxgloveView
from protocol.bus import board51_pb2 as pb
from protocol.errors import ServiceError
from tests.harness.gateway.bus_peers import PlayedGateway, played_gateway, ticking
from tests.harness.gateway.gateway_peers import client
from tests.harness.ports import free_port
from tests.patience import HANG_S


@pytest.fixture
def gateway() -> Iterator[PlayedGateway]:
    with played_gateway() as played:
        yield played


async def listen(port: int, topic: str, count: int = 20) -> tuple[dict[str, Any], list[tuple[int, bytes]]]:
    """The advertisement of a topic, and its first messages: (log time, payload)."""
    async with connect(f"ws://127.0.0.1:{port}", subprotocols=[Subprotocol("foxglove.sdk.v1")]) as socket:
        channel: dict[str, Any] = {}
        messages: list[tuple[int, bytes]] = []
        async for frame in socket:
            if isinstance(frame, str):
                notice = json.loads(frame)
                offers = notice.get("channels", []) if notice["op"] == "advertise" else []
                offered = next((offer for offer in offers if offer["topic"] == topic), None)
                channel = channel or offered or {}
                # The server may offer a channel a moment before it knows it: then it refuses, and is asked again.
                if offered or (notice["op"] == "status" and "nknown channel" in notice["message"]):
                    subscription = {"id": 1, "channelId": channel["id"]}
                    await socket.send(json.dumps({"op": "subscribe", "subscriptions": [subscription]}))
            elif frame[0] == 1:
                _, time_ns = struct.unpack_from("<IQ", frame, 1)
                messages.append((time_ns, frame[13:]))
                if len(messages) == count:
                    return channel, messages
    raise AssertionError("the server hung up")


def decode(channel: dict[str, Any], payload: bytes) -> Any:
    """Decode `payload` like a client that knows only what the server said."""
    files = descriptor_pb2.FileDescriptorSet.FromString(base64.b64decode(channel["schema"]))
    pool = descriptor_pool.DescriptorPool()
    for file in files.file:
        pool.Add(file)
    return message_factory.GetMessageClass(pool.FindMessageTypeByName(channel["schemaName"])).FromString(payload)


def test_a_client_that_knows_only_the_protocol_reads_the_samples(gateway: PlayedGateway) -> None:
    with client(gateway.endpoint) as bus, ticking(gateway, "rig1"):
        view = FoxgloveView(bus.session, "board51", "127.0.0.1", 0)
        channel, messages = asyncio.run(asyncio.wait_for(listen(view.port, "board51/rig1/state"), HANG_S))
        view.close()

    states = [decode(channel, payload) for _, payload in messages]
    assert channel["encoding"] == "protobuf"
    assert channel["schemaName"] == "board51.v1.State"
    assert [s.tick - states[0].tick for s in states] == list(range(20))
    assert [time_ns for time_ns, _ in messages] == [s.host_time_ns for s in states]


@pytest.mark.slow
def test_junk_is_counted_and_not_passed_on(gateway: PlayedGateway) -> None:
    with client(gateway.endpoint) as bus, ticking(gateway, "rig1"):
        view = FoxgloveView(bus.session, "board51", "127.0.0.1", 0)
        asyncio.run(asyncio.wait_for(listen(view.port, "board51/rig1/state"), HANG_S))
        gateway.session.put("board51/rig1/states", b"\xff\xff\xff")
        asyncio.run(asyncio.wait_for(listen(view.port, "board51/rig1/state"), HANG_S))
        view.close()

        assert view.refused == 1


def test_a_port_in_use_is_an_error_that_says_so(gateway: PlayedGateway) -> None:
    port = free_port()
    with client(gateway.endpoint) as bus:
        view = FoxgloveView(bus.session, "board51", "127.0.0.1", port)
        with pytest.raises(ServiceError, match="Foxglove cannot listen") as raised:
            FoxgloveView(bus.session, "board51", "127.0.0.1", port)
        view.close()

    assert "--listen" in str(raised.value)


@pytest.mark.parametrize(("topic", "schema"), [("log", "foxglove.Log"), ("scene", "foxglove.SceneUpdate")])
def test_the_log_and_3d_panels_have_topics_of_their_own(gateway: PlayedGateway, topic: str, schema: str) -> None:
    def event(n: int) -> dict[str, Any]:
        if n % 50 == 0:
            gateway.send(
                "event", pb.Event(source="board", severity="fault", name="over-current", host_time_ns=n), "rig1"
            )
        return {}

    with client(gateway.endpoint) as bus, ticking(gateway, "rig1", values=event):
        view = FoxgloveView(bus.session, "board51", "127.0.0.1", 0)
        channel, messages = asyncio.run(asyncio.wait_for(listen(view.port, f"board51/rig1/{topic}", 1), HANG_S))
        view.close()

    message = decode(channel, messages[0][1])
    assert channel["schemaName"] == schema
    if topic == "log":
        assert (message.name, message.message, message.level) == ("board", "over-current", 4)  # 4: ERROR
    else:
        assert [entity.id for entity in message.entities] == ["coil", "ball"]
