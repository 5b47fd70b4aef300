"""The output to bus and log does not depend on how the bytes of a board are cut into reads."""

from __future__ import annotations

from dataclasses import asdict
from itertools import pairwise

from hypothesis import given
from hypothesis import strategies as st

from gateway.config import BoardConfig
from gateway.link.clock import HostClock
from gateway.link.driver import BoardDriver
from protocol.wire.decoder import StreamDecoder
from protocol.wire.messages import Message
from tests.harness.gateway.gateway_peers import Collector, frame, usual_answer

START_NS = 1_000_000_000_000
ARRIVED_NS = START_NS + 1_000_000_000  # late: a state may be late, never early


def streaming() -> tuple[BoardDriver, Collector]:
    collector = Collector()
    driver = BoardDriver(BoardConfig(name="rig1", port="none"), collector, HostClock(lambda: 0, lambda: 0))
    driver.port_opened("none", START_NS * 1e-9)
    driver.poll(START_NS * 1e-9)
    while data := driver.output():
        driver.wrote(len(data))
        for command in StreamDecoder().feed(data):
            assert isinstance(command, Message)
            driver.received(usual_answer(command, 0), START_NS)
    driver.received(stated(0) + stated(1), START_NS)
    assert driver.link == "streaming"
    return driver, collector


def stated(tick: int) -> bytes:
    return frame("STATE", sequence=tick, i_c=tick, x=4095 - tick, u_c=0, x_ref=7, flags=2)


def outputs(collector: Collector) -> list[tuple[object, ...]]:
    """All but what the host's clock gives: the number of the session (in texts, too), the time of an event."""
    samples = [
        tuple(value for field, value in state.ListFields() if field.name != "session") for state in collector.samples
    ]
    return [*samples, *((event.name, event.tick) for event in collector.messages["event"])]


ticks = st.integers(0, 300)
noise = st.binary(min_size=1, max_size=20)
run = st.builds(lambda first, count: b"".join(map(stated, range(first, first + count))), ticks, st.integers(1, 20))
event = st.builds(lambda tick: frame("EVENT", number=1, tick=tick, code=3, detail=0), ticks)


@given(
    data=st.lists(st.one_of(run, ticks.map(stated), event, noise), max_size=8).map(b"".join),
    cuts=st.lists(st.integers(0, 2000)),
)
def test_samples_and_counts_do_not_depend_on_the_cuts(data: bytes, cuts: list[int]) -> None:
    edges = [0, *sorted(cut for cut in cuts if cut < len(data)), len(data)]
    (whole, expected), (pieces, collected) = streaming(), streaming()

    whole.received(data, ARRIVED_NS)
    for a, b in pairwise(edges):
        pieces.received(data[a:b], ARRIVED_NS)

    assert outputs(collected) == outputs(expected)
    assert asdict(pieces.session.counters) == asdict(whole.session.counters)
    assert pieces.session.states_ignored == whole.session.states_ignored
    assert (pieces.link, pieces.counts.samples) == (whole.link, whole.counts.samples)
