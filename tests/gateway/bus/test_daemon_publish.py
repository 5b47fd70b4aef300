"""The publisher's queue: never blocks, drops the oldest, counts, keeps order."""

from __future__ import annotations

import threading
import time

from gateway.bus.publisher import LONGEST_BATCH, Publisher, PublishQueue
from gateway.bus.status import percentile
from tests.harness.gateway.gateway_peers import wait_for
from tests.patience import HANG_S


class Gated:
    """Takes payloads once the gate is open."""

    def __init__(self) -> None:
        self.gate = threading.Event()
        self.entered = threading.Event()
        self.received: list[bytes] = []

    def put(self, payload: bytes, /) -> None:
        self.entered.set()
        self.gate.wait(HANG_S)
        self.received.append(payload)


def payloads(start: int, end: int) -> list[bytes]:
    return [str(n).encode() for n in range(start, end)]


def test_a_stalled_bus_costs_the_oldest_and_the_caller_nothing() -> None:
    target, publisher = Gated(), Publisher("test", capacity=100)
    channel = PublishQueue(target.put)
    publisher.start()
    publisher.put(channel, payloads(0, 1))
    assert target.entered.wait(HANG_S)

    for n in range(0, 10_000, 10):
        publisher.put(channel, payloads(n, n + 10))
    waiting, dropped, meanwhile = channel.waiting, channel.dropped, list(target.received)
    target.gate.set()
    wait_for(lambda: len(target.received) == 101, "rest of the queue")

    assert meanwhile == []  # 1000 calls came back from a bus that took nothing
    assert (waiting, dropped) == (100, 9900)
    assert target.received == [*payloads(0, 1), *payloads(9900, 10_000)]
    publisher.stop()


def test_latency_is_from_the_read_to_the_last_put_of_that_read() -> None:
    target, publisher = Gated(), Publisher("test", capacity=100)
    channel = PublishQueue(target.put)
    publisher.start()
    publisher.put(channel, payloads(0, 3), time.monotonic_ns() - 50_000_000)
    target.gate.set()

    latencies_s = wait_for(channel.take_latencies_s, "latency")

    assert len(latencies_s) == 1
    assert latencies_s[0] >= 0.05
    assert channel.take_latencies_s() == []
    publisher.stop()


def test_what_waits_is_put_before_the_end() -> None:
    target, publisher = Gated(), Publisher("test", capacity=1000)
    target.gate.set()
    publisher.put(PublishQueue(target.put), payloads(0, 500))

    publisher.start()
    publisher.stop(patience_s=10.0)

    assert target.received == payloads(0, 500)


def test_a_stalled_bus_does_not_hold_up_the_end() -> None:
    target, publisher = Gated(), Publisher("test", capacity=1000)
    publisher.start()
    publisher.put(PublishQueue(target.put), payloads(0, 5))

    assert target.entered.wait(HANG_S)
    publisher.stop(patience_s=0.2)

    assert target.received == []  # it is still stalled
    target.gate.set()


def test_after_a_pause_nothing_is_dropped_until_the_thread_has_taken_what_waited() -> None:
    """The end of a pause reports what was dropped; a sample that came a moment later must not make it wrong."""
    target, publisher = Gated(), Publisher("test", capacity=100)
    target.gate.set()
    channel = PublishQueue(target.put)
    publisher.hold(held=True)
    for n in range(110):
        publisher.put(channel, payloads(n, n + 1))
    at_the_end = channel.dropped
    publisher.hold(held=False)

    for n in range(110, 120):  # the thread has not yet run
        publisher.put(channel, payloads(n, n + 1))
    just_after = channel.dropped
    publisher.start()
    wait_for(lambda: target.received[-1:] == payloads(119, 120), "what waited")
    publisher.stop()

    assert at_the_end == just_after == 10
    assert target.received == payloads(10, 120)


def test_gathered_payloads_are_one_message_per_channel_in_order_and_of_bounded_length() -> None:
    first, second = Gated(), Gated()
    publisher = Publisher("test", capacity=1000, gather_s=0.001, join=b",".join)
    channels = [PublishQueue(first.put), PublishQueue(second.put)]
    publisher.hold(held=True)
    publisher.start()
    for n in range(600):
        publisher.put(channels[n % 2 if n < 200 else 0], payloads(n, n + 1))
    waiting = [channel.waiting for channel in channels]
    for target in (first, second):
        target.gate.set()

    publisher.hold(held=False)
    wait_for(lambda: len(first.received) == 2 and second.received, "the batches")

    assert waiting == [500, 100]
    assert b",".join(first.received).split(b",") == [*payloads(0, 200)[::2], *payloads(200, 600)]
    assert [message.count(b",") + 1 for message in first.received] == [LONGEST_BATCH, 500 - LONGEST_BATCH]
    assert second.received == [b",".join(payloads(0, 200)[1::2])]
    assert [channel.waiting for channel in channels] == [0, 0]
    publisher.stop()


def test_percentiles_are_of_the_nearest_rank() -> None:
    values = [float(n) for n in range(100)]

    assert (percentile(values, 0.5), percentile(values, 0.99), percentile([], 0.5)) == (50.0, 99.0, 0.0)
