"""The OPC UA nodes of a rig, without a network: each value has a subscriber."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Iterable
from functools import cache
from typing import Any, cast

from asyncua import Server, ua
from asyncua.ua import ua_binary
from google.protobuf.message import Message

from gateway.views.board_feed import BoardFeed
from gateway.views.opcua.address_space.history import RingHistory
from gateway.views.opcua.conditions import Conditions
from gateway.views.opcua.nodes import BoardNodes
from gateway.views.opcua.operations import Operations
from gateway.views.opcua.sessions import GuardedServer
from gateway.views.opcua.types import Builder, register
from protocol.bus import board51_pb2 as pb
from protocol.bus.encoding import is_plausible
from tests.harness.hostile_messages import START_NS

_LOOP = asyncio.new_event_loop()


@cache
def _site() -> tuple[GuardedServer, Builder, RingHistory, ua.NodeId]:
    """Return an address space with our types, made once."""

    async def make() -> tuple[GuardedServer, Builder, RingHistory, ua.NodeId]:
        inner = GuardedServer(lambda *_: None, cast(Operations, None), secured=False)  # nobody calls a method
        server = Server(iserver=inner)
        await server.init()
        await server.register_namespace("urn:board51:test")
        inner.spaces = await register(server)
        history = inner.history_manager = RingHistory(inner)
        builder = Builder(inner, inner.spaces)
        site = builder.object(ua.NodeId(ua.ObjectIds.ObjectsFolder), "site", "s", reference=ua.ObjectIds.Organizes)
        return inner, builder, history, site

    return _LOOP.run_until_complete(make())


def serve(messages: Iterable[Message]) -> None:
    """Take messages, and send all that changes by them to a client, once after the first half and once at the end."""
    inner, builder, history, site = _site()
    arrived = list(messages)
    feed = BoardFeed("rig", lock := threading.Lock(), lambda: 100.0)
    before = set(inner.aspace.keys())
    nodes = BoardNodes(inner, builder, site, feed, rate_hz=50.0, history=history, history_s=10.0)
    conditions = Conditions(inner, builder, feed, nodes.object)

    async def send(_: object, value: Any) -> None:
        ua_binary.struct_to_binary(value)

    async def update() -> None:
        await nodes.update()
        await conditions.update()

    for made in set(inner.aspace.keys()) - before:
        for attribute in inner.aspace[made].attributes.values():
            attribute.datachange_callbacks[0] = send
    try:
        for half in (arrived[: len(arrived) // 2], arrived[len(arrived) // 2 :]):
            for message in half:
                if not isinstance(message, pb.Status | pb.Parameters) or is_plausible(message):
                    with lock:
                        feed.take(message, START_NS)
            _LOOP.run_until_complete(update())
    finally:
        for made in set(inner.aspace.keys()) - before:
            del inner.aspace[made]
