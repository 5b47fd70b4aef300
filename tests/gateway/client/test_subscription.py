"""A subscription of a client: when it has ended, no thread of it calls back or waits for the interpreter."""

from __future__ import annotations

import threading

import zenoh

from gateway.client.connection import Subscription
from tests.harness.gateway.bus_peers import played_gateway
from tests.harness.gateway.gateway_peers import client, wait_for
from tests.patience import HANG_S


def test_a_subscription_that_is_closed_waits_for_the_callback_under_way() -> None:
    called, may_return, closed = threading.Event(), threading.Event(), threading.Event()

    def receive(_: zenoh.Sample) -> None:
        called.set()
        may_return.wait(HANG_S)

    def close() -> None:
        subscription.close()
        closed.set()

    with played_gateway() as gateway, client(gateway.endpoint) as bus:
        subscription = Subscription(bus.session, ["board51/rig/**"], receive)

        def is_called() -> bool:
            gateway.status()  # until the route is there
            return called.is_set()

        wait_for(is_called, "a message")
        closing = threading.Thread(target=close)
        closing.start()
        waits = not closed.wait(0.2)
        may_return.set()
        closing.join(HANG_S)

    assert waits
    assert closed.is_set()
