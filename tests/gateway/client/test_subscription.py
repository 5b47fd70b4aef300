"""Recordings and subscriptions: the time of a message, and their end, after which no thread calls back."""

from __future__ import annotations

import threading
from pathlib import Path

import zenoh

from gateway.client.connection import BusBoard, Subscription
from gateway.client.recording import Recording
from protocol.bus import board51_pb2 as pb
from protocol.log.reader import LogReader
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


def test_a_recording_that_is_closed_has_all_that_arrived_before(tmp_path: Path) -> None:
    messages = [pb.State(tick=tick, session=1, host_time_ns=tick + 1).SerializeToString() for tick in range(2000)]
    with played_gateway() as gateway, client(gateway.endpoint) as bus:
        recording = Recording(BusBoard(bus.session, "board51", "rig"), tmp_path, connect=gateway.endpoint).start()
        for message in messages:
            bus.session.put("board51/rig/state", message)  # of the same session: it has arrived when `put` returns
        stats = recording.close()

    assert (stats.written, stats.dropped) == (len(messages), 0)


def test_a_message_without_a_time_is_logged_at_the_newest_time_of_its_board(tmp_path: Path) -> None:
    began_ns = 1_767_225_600 * 10**9
    with played_gateway() as gateway, client(gateway.endpoint) as bus:
        recording = Recording(BusBoard(bus.session, "board51", "rig"), tmp_path, connect=gateway.endpoint).start()
        for topic, message in (
            ("status", pb.Status(host_time_ns=began_ns)),
            ("twin/state", pb.TwinState(tick=1)),
            ("twin/diagnosis", pb.TwinDiagnosis()),  # of a twin that knew no time
        ):
            bus.session.put(f"board51/rig/{topic}", message.SerializeToString())
        recording.close()

    records = LogReader(recording.files).raw(topics_=["status", "twin/state", "twin/diagnosis"])
    assert [record.time_ns for record in records] == [began_ns] * 3
