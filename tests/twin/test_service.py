"""`TwinService` on a real bus: a router in this process, a board that publishes, a subscriber that checks."""

from __future__ import annotations

import socket
import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import pytest
import zenoh

from protocol.bus import board51_pb2 as pb
from protocol.bus import topics
from protocol.bus.endpoint import zenoh_config
from tests.twin.rig import Rig
from twin.mirror.mirror import IN_STEP, Mirror
from twin.mirror.service import TwinService
from twin.model.nominal import nominal

HELD = 2.85e-3


def free_endpoint() -> str:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return f"tcp/127.0.0.1:{probe.getsockname()[1]}"


@contextmanager
def router(endpoint: str) -> Iterator[zenoh.Session]:
    with zenoh.open(zenoh.Config.from_json5(zenoh_config("router", listen=[endpoint]))) as session:
        yield session


def wait(condition: Callable[[], bool], what: str, seconds: float = 15.0) -> None:
    deadline = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < deadline, f"no {what} within {seconds} s"
        time.sleep(0.01)


def wait_for_count(found: Callable[[], int], count: int, what: str, seconds: float = 15.0) -> None:
    deadline = time.monotonic() + seconds
    while (now := found()) != count:
        assert time.monotonic() < deadline, f"{now} instead of {count} {what} within {seconds} s"
        time.sleep(0.01)


class Heard:
    """What a subscriber on everything of one site has received, by key."""

    def __init__(self, session: zenoh.Session, site: str) -> None:
        self.payloads: dict[str, list[bytes]] = defaultdict(list)
        self.encodings: dict[str, str] = {}
        session.declare_subscriber(f"{site}/**", self._take)

    def _take(self, sample: zenoh.Sample) -> None:
        key = str(sample.key_expr)
        self.payloads[key].append(sample.payload.to_bytes())
        self.encodings[key] = str(sample.encoding)


def publish(session: zenoh.Session, states: list[pb.State], *, board: str = "rig") -> None:
    """As a gateway does: blocking, so that nothing is lost here."""
    for state in states:
        session.put(
            topics.key("lab", board, "state"),
            state.SerializeToString(),
            congestion_control=zenoh.CongestionControl.BLOCK,
        )


def introduce(session: zenoh.Session, service: TwinService, rig: Rig, *, board: str = "rig") -> None:
    """Repeat the parameters, as a gateway does, until the twin has heard them; then messages get through.

    `matching_status` does not say that: zenoh drops what is sent before its routes are computed, some ms after it.
    """
    heard_before = service.parameters_heard

    def heard() -> bool:
        session.put(topics.key("lab", board, "parameters"), rig.parameters().SerializeToString())
        return service.parameters_heard > heard_before

    wait(heard, "parameters at the twin")


@pytest.fixture
def endpoint() -> str:
    return free_endpoint()


def test_the_bus_carries_what_the_mirror_says_bit_by_bit(endpoint: str) -> None:
    rig = Rig(seed=2)
    rig.hold(HELD)
    states = list(rig.run(400, HELD))
    mirror = Mirror(nominal())
    mirror.parameters(rig.parameters())
    expected = [output for output in map(mirror.handle, states) if output is not None]

    with router(endpoint) as session:
        heard = Heard(session, "lab")
        with TwinService(nominal(), site="lab", endpoints=(endpoint,)) as service:
            introduce(session, service, rig)
            publish(session, states)
            wait_for_count(lambda: len(heard.payloads["lab/rig/twin/divergence"]), len(states), "divergence")
            wait_for_count(lambda: len(heard.payloads["lab/rig/twin/state"]), len(states) - 1, "twin state")
            assert service.dropped == 0

    got = heard.payloads["lab/rig/twin/divergence"]
    assert got == [output.divergence.SerializeToString() for output in expected]
    assert heard.encodings["lab/rig/twin/state"] == "application/protobuf;board51.v1.TwinState"
    assert pb.Divergence.FromString(got[-1]).sync == IN_STEP


def test_each_board_has_its_own_twin_and_other_boards_can_be_left_out(endpoint: str) -> None:
    one, two = Rig(seed=2), Rig(seed=3)
    for rig in (one, two):
        rig.hold(HELD)
    with router(endpoint) as session:
        heard = Heard(session, "lab")
        with TwinService(nominal(), site="lab", board="two", endpoints=(endpoint,)) as service:
            introduce(session, service, two, board="two")
            publish(session, list(one.run(20, HELD)), board="one")
            publish(session, list(two.run(20, HELD)), board="two")
            wait_for_count(lambda: len(heard.payloads["lab/two/twin/divergence"]), 20, "divergence")
            assert set(service.boards) == {"two"}
    assert "lab/one/twin/divergence" not in heard.payloads


def test_silence_raises_an_alarm_and_samples_end_it(endpoint: str) -> None:
    rig = Rig(seed=2)
    rig.hold(HELD)
    with router(endpoint) as session:
        heard = Heard(session, "lab")
        with TwinService(nominal(), site="lab", endpoints=(endpoint,)) as service:
            introduce(session, service, rig)
            publish(session, list(rig.run(300, HELD)))
            wait_for_count(lambda: len(heard.payloads["lab/rig/twin/alarm"]), 1, "alarm")
            publish(session, list(rig.run(2, HELD)))
            wait_for_count(lambda: len(heard.payloads["lab/rig/twin/alarm"]), 2, "end of the alarm")

    on, off = (pb.Alarm.FromString(data) for data in heard.payloads["lab/rig/twin/alarm"])
    assert (on.name, on.active) == ("out-of-step", True)
    assert "no sample" in on.text
    assert (off.name, off.active) == ("out-of-step", False)


def test_malformed_messages_are_counted_and_change_nothing(endpoint: str) -> None:
    rig = Rig(seed=2)
    rig.hold(HELD)
    with router(endpoint) as session:
        heard = Heard(session, "lab")
        with TwinService(nominal(), site="lab", endpoints=(endpoint,)) as service:
            introduce(session, service, rig)
            session.put("lab/rig/state", b"\xff\xff\xff")
            session.put("lab/rig/parameters", b"\x0a\xff")
            publish(session, list(rig.run(10, HELD)))
            wait_for_count(lambda: len(heard.payloads["lab/rig/twin/divergence"]), 10, "divergence")
            assert service.malformed == 2
            assert service.running


def test_it_waits_for_a_router_and_survives_its_restart(endpoint: str) -> None:
    """Samples lost meanwhile are a gap: out of step, never bridged over."""
    rig = Rig(seed=2)
    rig.hold(HELD)
    with TwinService(nominal(), site="lab", endpoints=(endpoint,)) as service:
        with router(endpoint) as session:
            introduce(session, service, rig)
            publish(session, list(rig.run(300, HELD)))
            wait_for_count(lambda: service.boards["rig"].samples, 300, "samples")
            assert service.boards["rig"].mirror.sync == IN_STEP
        list(rig.run(100, HELD))  # nobody hears these
        with router(endpoint) as session:
            heard = Heard(session, "lab")
            introduce(session, service, rig)
            publish(session, list(rig.run(300, HELD)))
            wait_for_count(lambda: len(heard.payloads["lab/rig/twin/divergence"]), 300, "divergence after the restart")

        first = pb.Divergence.FromString(heard.payloads["lab/rig/twin/divergence"][0])
        assert first.sync == "out-of-step"
        assert service.boards["rig"].mirror.sync == IN_STEP
        assert service.boards["rig"].mirror.counters["out_of_step:lost-samples"] == 1
