"""Clients that ask for too much: a bounded service for them, the usual one for everybody else."""

from __future__ import annotations

import asyncio
import socket
import struct
from collections.abc import Iterator
from typing import Any

import pytest
from asyncua import ua
from asyncua.ua.uaerrors import UaError

from gateway.views.feed import Feed
from gateway.views.opcua import sessions, subscriptions
from gateway.views.opcua.operations import Operations
from gateway.views.opcua.server import OpcuaSettings
from gateway.views.opcua.sessions import GuardedServer
from tests.harness.gateway.bus_peers import played_gateway, ticking
from tests.harness.gateway.opcua_peers import Served, peer

S = ua.StatusCodes


@pytest.fixture(scope="module")
def server() -> Iterator[Served]:
    with played_gateway() as gateway, ticking(gateway, "rig"), Served(gateway, OpcuaSettings(port=0)) as served:
        yield served


class Deaf:
    """Hears nothing."""

    def datachange_notification(self, *_: Any) -> None:
        pass


@pytest.mark.slow
def test_the_shortest_interval_and_the_longest_life_are_revised(server: Served) -> None:
    async def session_work() -> ua.CreateSubscriptionResult:
        async with peer(server.port) as client:
            parameters = ua.CreateSubscriptionParameters()
            parameters.RequestedPublishingInterval, parameters.RequestedLifetimeCount = 1.0, 2**31
            parameters.RequestedMaxKeepAliveCount, parameters.PublishingEnabled = 2**31, True
            return await client.client.uaclient.create_subscription(parameters, lambda _: None)

    revised = asyncio.run(session_work())

    assert revised.RevisedPublishingInterval == subscriptions.MIN_INTERVAL_MS
    assert revised.RevisedLifetimeCount >= 3 * revised.RevisedMaxKeepAliveCount
    assert revised.RevisedLifetimeCount * revised.RevisedPublishingInterval <= 3600e3


def test_a_subscription_holds_so_many_items_and_no_more(server: Served, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(subscriptions, "MAX_ITEMS", 7)

    async def session_work() -> list[int | ua.StatusCode]:
        async with peer(server.port) as client:
            await client.await_status("rig/state/x_m", S.Good)
            subscription = await client.client.create_subscription(100, Deaf())
            results: list[int | ua.StatusCode] = await subscription.subscribe_data_change(
                [client.node("rig/state/x_m")] * 9
            )
            return results

    items = asyncio.run(session_work())

    assert [isinstance(item, int) for item in items] == [True] * 7 + [False] * 2
    assert {item.value for item in items[7:] if isinstance(item, ua.StatusCode)} == {S.BadTooManyMonitoredItems}


def test_a_client_that_does_not_read_is_dropped_and_others_are_not() -> None:
    async def drop_deaf_client() -> tuple[int, list[bool]]:
        inner = GuardedServer(lambda *_: None, Operations(Feed.__new__(Feed)), secured=False)
        accepted: asyncio.Queue[asyncio.StreamWriter] = asyncio.Queue()
        listener = await asyncio.start_server(lambda _, writer: accepted.put_nowait(writer), "127.0.0.1", 0)
        port = listener.sockets[0].getsockname()[1]
        clients = [socket.create_connection(("127.0.0.1", port)) for _ in range(2)]
        writers = [await accepted.get() for _ in clients]
        inner.asyncio_transports += [writer.transport for writer in writers]
        writers[0].write(bytes(2 * sessions.MAX_UNREAD_BYTES))  # and nobody reads it
        writers[1].write(b"read at once, or small enough to wait")
        dropped = inner.drop_deaf()
        closing = [writer.transport.is_closing() for writer in writers]
        for client in clients:
            client.close()
        for writer in writers:
            writer.close()
        listener.close()
        inner.method_service.stop()
        return dropped, closing

    assert asyncio.run(drop_deaf_client()) == (1, [True, False])


@pytest.mark.parametrize("junk", [b"GET / HTTP/1.1\r\n\r\n", b"HELF" + struct.pack("<I", 0xFFFFFFFF), bytes(64)])
def test_junk_costs_the_connection_only(server: Served, junk: bytes) -> None:
    async def session_work() -> None:
        _, writer = await asyncio.open_connection("127.0.0.1", server.port)
        writer.write(junk)
        await writer.drain()
        async with peer(server.port) as client:
            await client.await_status("rig/state/x_m", S.Good)
        writer.close()

    asyncio.run(session_work())


def test_another_sessions_subscription_is_not_ones_own(server: Served) -> None:
    async def session_work() -> None:
        async with peer(server.port) as owner, peer(server.port) as thief:
            subscription = await owner.client.create_subscription(100, Deaf())
            with pytest.raises(UaError):
                await thief.client.uaclient.delete_subscriptions([subscription.subscription_id])
            await subscription.subscribe_data_change(owner.node("rig/state/x_m"))

    asyncio.run(session_work())


def test_nodes_cannot_be_added_and_servers_not_registered(server: Served) -> None:
    async def session_work() -> None:
        async with peer(server.port) as client:
            with pytest.raises(UaError):
                await client.client.uaclient.add_nodes([ua.AddNodesItem()])
            with pytest.raises(UaError):
                await client.client.uaclient.register_server(ua.RegisteredServer())

    asyncio.run(session_work())


def test_who_has_not_logged_in_reads_and_nothing_else(server: Served) -> None:
    """Anonymous clients are viewers unless somebody says otherwise; STOP is for viewers who have logged in."""

    async def session_work() -> None:
        async with peer(server.port) as client:
            await client.await_status("rig/state/x_m", S.Good)
            value = ua.Variant(2e-3, ua.VariantType.Double)
            assert await client.write("rig/setpoint/x_ref_m", value) == S.BadUserAccessDenied
            stop = await client.call("rig", "Stop")
            assert stop.StatusCode.value == S.BadUserAccessDenied
            assert stop.OutputArguments[1].Value == "not-allowed"
            acknowledgement = await client.call("rig", "Acknowledge", ua.Variant("x"), ua.Variant(""))
            assert acknowledgement.StatusCode.value == S.BadUserAccessDenied

    server.gateway.commands.clear()
    asyncio.run(session_work())

    assert server.gateway.commands == []
