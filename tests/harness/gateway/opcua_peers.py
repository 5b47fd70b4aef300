"""An OPC UA server over a played gateway, in the test's own event loop, and a client of it."""

from __future__ import annotations

import asyncio
import sys
import threading
import time
import traceback
from collections.abc import AsyncIterator, Callable, Coroutine
from contextlib import AsyncExitStack, asynccontextmanager
from typing import Any, TypeVar

from asyncua import Client, ua
from asyncua.ua.uaerrors import UaStatusCodeError

from gateway.views.feed import Feed
from gateway.views.opcua.server import OpcuaSettings, serve
from protocol.bus import board51_pb2 as pb
from tests.harness.gateway.bus_peers import PlayedGateway, feed_of
from tests.harness.gateway.gateway_peers import wait_for
from tests.patience import HANG_S

T = TypeVar("T")
NAMESPACE = "urn:board51:board51"


class Served:
    """A server in a thread of its own, as in a process of its own: clients' loops do not slow it."""

    def __init__(self, gateway: PlayedGateway, settings: OpcuaSettings) -> None:
        self.gateway, self._settings = gateway, settings
        self.port = 0
        self._loop: asyncio.AbstractEventLoop | None = None
        self._stop: asyncio.Event | None = None
        self._failures: list[Exception] = []
        self._thread = threading.Thread(target=self._work)

    def __enter__(self) -> Served:
        self._thread.start()
        try:
            wait_for(lambda: self.port or self._failures, "OPC UA server")
        except AssertionError as error:
            error.add_note("".join(traceback.format_stack(sys._current_frames()[self._thread.ident or 0])))
            self.__exit__()
            raise
        if self._failures:
            self._thread.join(HANG_S)
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

    async def await_status(self, path: str, code: int, timeout_s: float = HANG_S) -> ua.DataValue:
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
    # The watchdog of the client would close the connection to a server that takes a second on a busy machine.
    client = Client(f"opc.tcp://127.0.0.1:{port}/board51/", timeout=HANG_S, watchdog_intervall=HANG_S)
    if "user" in options:
        client.set_user(options["user"])
        client.set_password(options["password"])
    if "security" in options:
        await client.set_security_string(options["security"])
        client.application_uri = options.get("uri", client.application_uri)
    await _connect(client)
    async with AsyncExitStack() as stack:
        stack.push_async_callback(client.disconnect)
        yield Peer(client, await client.get_namespace_index(NAMESPACE))


async def _connect(client: Client) -> None:
    """Connect, and try again until the client is in.

    The server closes a connection that says nothing for 10 s.
    """
    deadline_s = time.monotonic() + HANG_S
    while True:
        try:
            await client.connect()
            return
        except (ConnectionError, TimeoutError):
            if time.monotonic() > deadline_s:
                raise


async def until(look: Callable[[], Coroutine[Any, Any, T | None]], what: str, timeout_s: float = HANG_S) -> T:
    """The first value of `look` that is not None, asked ever more rarely; fails at the deadline."""
    clock_s = asyncio.get_running_loop().time
    start_s = clock_s()
    while (waited_s := clock_s() - start_s) < timeout_s:
        try:
            value = await look()
        except UaStatusCodeError:
            value = None
        if value is not None:
            return value
        await asyncio.sleep(min(0.1, 0.02 + 0.02 * waited_s))
    raise AssertionError(f"no {what} within {timeout_s:g} s")


class Notifications:
    """Keeps what a subscription brings."""

    def __init__(self) -> None:
        self.values: dict[str, list[ua.DataValue]] = {}
        self.events: list[Any] = []

    def datachange_notification(self, node: Any, _: Any, data: Any) -> None:
        self.values.setdefault(node.nodeid.Identifier, []).append(data.monitored_item.Value)

    def event_notification(self, event: Any) -> None:
        self.events.append(event)

    def status_change_notification(self, status: Any) -> None:
        pass

    def of(self, board: str) -> list[Any]:
        """Events of a board's conditions."""
        return [e for e in self.events if getattr(e, "ConditionName", None) and e.SourceName == board]

    async def events_of(self, kind: int, count: int) -> None:
        """So many events of this type have come."""

        async def look() -> bool | None:
            return True if sum(e.EventType.Identifier == kind for e in self.events) >= count else None

        await until(look, f"{count} events of type {kind}")

    async def retained(self, name: str, count: int) -> None:
        """A condition has been told of so often."""

        async def look() -> bool | None:
            matching = [e for e in self.events if getattr(e, "ConditionName", None) == name and e.Retain]
            return True if len(matching) >= count else None

        await until(look, f"{count} times {name}")


async def subscribe(client: Peer, notified: Notifications, *paths: str, interval_ms: float = 20.0) -> Any:
    subscription = await client.client.create_subscription(interval_ms, notified)
    await subscription.subscribe_data_change(
        [client.node(path) for path in paths], queuesize=100, sampling_interval=0.0
    )
    return subscription


async def monitor(
    client: Peer,
    notified: Notifications,
    *paths: str,
    timestamps: ua.TimestampsToReturn,
    filter_: Any = None,
    attribute: ua.AttributeIds = ua.AttributeIds.Value,
) -> list[ua.MonitoredItemCreateResult]:
    """Subscribe as `subscribe` does, but with the timestamps and the filter of the caller.

    The client of asyncua always asks for both timestamps.
    """

    def published(result: ua.PublishResult) -> None:
        for data in result.NotificationMessage.NotificationData or []:
            for item in getattr(data, "MonitoredItems", []):
                notified.values.setdefault(paths[item.ClientHandle], []).append(item.Value)

    settings = ua.CreateSubscriptionParameters(RequestedPublishingInterval=20.0, PublishingEnabled=True)
    settings.RequestedLifetimeCount, settings.RequestedMaxKeepAliveCount = 10_000, 100
    subscription = await client.client.uaclient.create_subscription(settings, published)
    parameters = ua.CreateMonitoredItemsParameters(
        SubscriptionId=subscription.SubscriptionId, TimestampsToReturn=timestamps
    )
    for handle, path in enumerate(paths):
        request = ua.MonitoredItemCreateRequest(MonitoringMode=ua.MonitoringMode.Reporting)
        request.ItemToMonitor = ua.ReadValueId(NodeId=client.node(path).nodeid, AttributeId=attribute)
        request.RequestedParameters = ua.MonitoringParameters(ClientHandle=handle, QueueSize=100, DiscardOldest=True)
        request.RequestedParameters.Filter = filter_
        parameters.ItemsToCreate.append(request)
    return list(await client.client.uaclient.create_monitored_items(parameters))


async def received(notified: Notifications, path: str, count: int) -> None:
    """So many values of `path` have come."""

    async def look() -> bool | None:
        return True if len(notified.values.get(path, [])) >= count else None

    await until(look, f"{count} values of {path}")


EVENTS = [
    ua.ObjectIds.AlarmConditionType, ua.ObjectIds.BaseEventType, ua.ObjectIds.RefreshStartEventType,
    ua.ObjectIds.RefreshEndEventType,
]  # fmt: skip


def raise_alarm(server: Served, board: str, text: str = "x is off") -> None:
    server.gateway.send("twin/alarm", pb.Alarm(name="divergence-x", active=True, text=text, value=9.0), board)


async def condition(server: Served, client: Peer, notified: Notifications, board: str) -> Any:
    """Subscribe at the Server, raise an alarm, and return its first event."""
    await client.await_status(f"{board}/state/x_m", ua.StatusCodes.Good)
    subscription = await client.client.create_subscription(50, notified)
    await subscription.subscribe_alarms_and_conditions(evtypes=EVENTS)
    raise_alarm(server, board)

    async def came() -> Any:
        return next(iter(notified.of(board)), None)

    return await until(came, "condition")
