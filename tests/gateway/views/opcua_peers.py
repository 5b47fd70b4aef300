"""An OPC UA server over a played gateway, in the test's own event loop, and a client of it."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import AsyncIterator, Callable, Coroutine
from contextlib import asynccontextmanager
from typing import Any, TypeVar

from asyncua import Client, ua
from asyncua.ua.uaerrors import UaStatusCodeError

from gateway.views.feed import Feed
from gateway.views.opcua.server import Settings, serve
from tests.gateway.gateway_peers import wait_for
from tests.gateway.views.bus_peers import PlayedGateway, feed_of

T = TypeVar("T")
NAMESPACE = "urn:board51:board51"


class Served:
    """A server in a thread of its own, as in a process of its own: clients' loops do not slow it."""

    def __init__(self, gateway: PlayedGateway, settings: Settings) -> None:
        self.gateway, self._settings = gateway, settings
        self.port = 0
        self._loop: asyncio.AbstractEventLoop | None = None
        self._stop: asyncio.Event | None = None
        self._failures: list[Exception] = []
        self._thread = threading.Thread(target=self._work)

    def __enter__(self) -> Served:
        self._thread.start()
        try:
            wait_for(lambda: self.port or self._failures, "OPC UA server", timeout_s=60.0)
        except AssertionError:
            self.__exit__()
            raise
        if self._failures:
            self._thread.join()
            raise self._failures[0]
        return self

    def __exit__(self, *_: object) -> None:
        if self._loop is not None and self._stop is not None:
            self._loop.call_soon_threadsafe(self._stop.set)
        self._thread.join(20.0)
        assert not self._thread.is_alive(), "the server does not end"

    def _work(self) -> None:
        try:
            with feed_of(self.gateway) as feed:
                asyncio.run(self._serve(feed))
        except Exception as error:
            self._failures.append(error)

    async def _serve(self, feed: Feed) -> None:
        self._loop, self._stop = asyncio.get_running_loop(), asyncio.Event()

        def ready(port: int) -> None:
            self.port = port

        await serve(feed, self._settings, self._stop, ready)


class Peer:
    """A client that knows our names."""

    def __init__(self, client: Client, namespace: int) -> None:
        self.client, self.namespace = client, namespace

    def node(self, path: str) -> Any:
        return self.client.get_node(ua.NodeId(path, self.namespace))

    async def read(self, path: str) -> ua.DataValue:
        """Value and status, whatever the status is."""
        return await self.node(path).read_data_value(raise_on_bad_status=False)

    async def await_status(self, path: str, code: int, timeout_s: float = 30.0) -> ua.DataValue:
        return await until(lambda: self._with(path, code), f"status {code:#x} of {path}", timeout_s)

    async def _with(self, path: str, code: int) -> ua.DataValue | None:
        value = await self.read(path)
        return value if value.StatusCode.value == code else None

    async def call(self, board: str, method: str, *inputs: ua.Variant) -> ua.CallMethodResult:
        request = ua.CallMethodRequest()
        request.ObjectId = ua.NodeId(board, self.namespace)
        request.MethodId = ua.NodeId(f"{board}/{method}", self.namespace)
        request.InputArguments = list(inputs)
        return (await self.client.uaclient.call([request]))[0]

    async def write(self, path: str, value: ua.Variant) -> int:
        item = ua.WriteValue()
        item.NodeId, item.AttributeId = ua.NodeId(path, self.namespace), ua.AttributeIds.Value
        item.Value = ua.DataValue(value)
        parameters = ua.WriteParameters()
        parameters.NodesToWrite = [item]
        return int((await self.client.uaclient.write(parameters))[0].value)


@asynccontextmanager
async def peer(port: int, **options: Any) -> AsyncIterator[Peer]:
    client = Client(f"opc.tcp://127.0.0.1:{port}/board51/", timeout=10)
    if "user" in options:
        client.set_user(options["user"])
        client.set_password(options["password"])
    if "security" in options:
        await client.set_security_string(options["security"])
        client.application_uri = options.get("uri", client.application_uri)
    async with client:
        yield Peer(client, await client.get_namespace_index(NAMESPACE))


async def until(look: Callable[[], Coroutine[Any, Any, T | None]], what: str, timeout_s: float = 30.0) -> T:
    """The first value of `look` that is not None; fails at the deadline."""
    deadline_s = asyncio.get_running_loop().time() + timeout_s
    while asyncio.get_running_loop().time() < deadline_s:
        try:
            value = await look()
        except UaStatusCodeError:
            value = None
        if value is not None:
            return value
        await asyncio.sleep(0.02)
    raise AssertionError(f"no {what} within {timeout_s:g} s")
