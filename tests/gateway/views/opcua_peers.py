"""An OPC UA server over a played gateway, in the test's own event loop, and a client of it."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import AsyncIterator, Callable, Coroutine, Iterator
from contextlib import asynccontextmanager, contextmanager
from dataclasses import replace
from typing import Any, TypeVar

from asyncua import Client, ua
from asyncua.ua.uaerrors import UaStatusCodeError

from gateway.views.opcua.server import Settings, serve
from tests.gateway.views.bus_peers import PlayedGateway, feed_of

T = TypeVar("T")
NAMESPACE = "urn:board51:board51"


@asynccontextmanager
async def served(gateway: PlayedGateway, settings: Settings) -> AsyncIterator[int]:
    """The server; yields its port."""
    stop, port = asyncio.Event(), asyncio.get_running_loop().create_future()
    with feed_of(gateway) as feed:
        task = asyncio.create_task(serve(feed, replace(settings, port=0), stop, port.set_result))
        await asyncio.wait({task, port}, return_when=asyncio.FIRST_COMPLETED)
        if task.done():
            task.result()
        try:
            yield port.result()
        finally:
            stop.set()
            await task


@contextmanager
def ticking(
    gateway: PlayedGateway, *boards: str, values: Callable[[int], dict[str, Any]] | None = None
) -> Iterator[None]:
    """The gateway publishes samples every 4 ms, status and parameters now and then."""
    stop = threading.Event()

    def work() -> None:
        n = 0
        while not stop.wait(0.004):
            for board in boards or ("rig",):
                gateway.state(board, **(values(n) if values is not None else {}))
                if n % 50 == 0:
                    gateway.status(board)
                    gateway.parameters(board)
            n += 1

    thread = threading.Thread(target=work)
    thread.start()
    try:
        yield
    finally:
        stop.set()
        thread.join()


class Peer:
    """A client that knows our names."""

    def __init__(self, client: Client, namespace: int) -> None:
        self.client, self.namespace = client, namespace

    def node(self, path: str) -> Any:
        return self.client.get_node(ua.NodeId(path, self.namespace))

    async def read(self, path: str) -> ua.DataValue:
        """Value and status, whatever the status is."""
        return await self.node(path).read_data_value(raise_on_bad_status=False)

    async def await_status(self, path: str, code: int, timeout_s: float = 10.0) -> ua.DataValue:
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


async def until(look: Callable[[], Coroutine[Any, Any, T | None]], what: str, timeout_s: float = 10.0) -> T:
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
