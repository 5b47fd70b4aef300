"""`TwinService` on a real bus: a router in this process, a board that publishes, a subscriber that checks."""

from __future__ import annotations

import itertools
import json
import threading
from contextlib import AbstractContextManager
from typing import Any

import pytest
import zenoh

from protocol.bus import board51_pb2 as pb
from protocol.bus.endpoint import zenoh_config
from tests.harness.ports import free_endpoint
from tests.harness.repeated import repeated
from tests.harness.twin.rig import Rig
from tests.harness.twin.twin_bus import Subscriber, introduce, publish, router, wait, wait_for_count
from tests.patience import HANG_S
from twin.mirror.bus import service as service_module
from twin.mirror.bus.service import TwinService
from twin.mirror.mirror import Mirror
from twin.mirror.output import IN_STEP
from twin.model.parameters import Model

HELD = 2.85e-3


@pytest.fixture
def endpoint() -> str:
    return free_endpoint()


def test_the_bus_carries_what_the_mirror_says_bit_by_bit(endpoint: str) -> None:
    rig = Rig(seed=2)
    rig.hold(HELD)
    states = list(rig.run(400, HELD))
    mirror = Mirror(Model.load("ce152"))
    mirror.parameters(rig.parameters())
    expected = [output for output in map(mirror.handle, states) if output is not None]

    with router(endpoint) as session:
        subscriber = Subscriber(session, "lab")
        with TwinService(Model.load("ce152"), site="lab", endpoints=(endpoint,)) as service:
            introduce(session, service, rig)
            publish(session, states)
            wait_for_count(lambda: len(subscriber.payloads["lab/rig/twin/divergence"]), len(states), "divergence")
            wait_for_count(lambda: len(subscriber.payloads["lab/rig/twin/state"]), len(states) - 1, "twin state")
            assert service.dropped == 0

    got = subscriber.payloads["lab/rig/twin/divergence"]
    assert got == [output.divergence.SerializeToString() for output in expected]
    assert subscriber.encodings["lab/rig/twin/states"] == "application/protobuf;board51.v1.TwinBatch"
    assert pb.Divergence.FromString(got[-1]).sync == IN_STEP


def test_each_board_has_its_own_twin_and_other_boards_can_be_left_out(endpoint: str) -> None:
    first, second = Rig(seed=2), Rig(seed=3)
    for rig in (first, second):
        rig.hold(HELD)
    with router(endpoint) as session:
        subscriber = Subscriber(session, "lab")
        with TwinService(Model.load("ce152"), site="lab", board="two", endpoints=(endpoint,)) as service:
            introduce(session, service, second, board="two")
            publish(session, list(first.run(20, HELD)), board="one")
            publish(session, list(second.run(20, HELD)), board="two")
            wait_for_count(lambda: len(subscriber.payloads["lab/two/twin/divergence"]), 20, "divergence")
            assert set(service.boards) == {"two"}
    assert "lab/one/twin/divergence" not in subscriber.payloads


def test_silence_raises_an_alarm_and_samples_end_it(endpoint: str) -> None:
    rig = Rig(seed=2)
    rig.hold(HELD)
    with router(endpoint) as session:
        subscriber = Subscriber(session, "lab")
        with TwinService(Model.load("ce152"), site="lab", endpoints=(endpoint,)) as service:
            introduce(session, service, rig)
            publish(session, list(rig.run(300, HELD)))
            wait_for_count(lambda: len(subscriber.payloads["lab/rig/twin/alarm"]), 1, "alarm")
            publish(session, list(rig.run(2, HELD)))
            wait_for_count(lambda: len(subscriber.payloads["lab/rig/twin/alarm"]), 2, "end of the alarm")

    on, off = (pb.Alarm.FromString(data) for data in subscriber.payloads["lab/rig/twin/alarm"])
    assert (on.name, on.active) == ("out-of-step", True)
    assert "no sample" in on.text
    assert (off.name, off.active) == ("out-of-step", False)


def test_malformed_messages_are_counted_and_change_nothing(endpoint: str) -> None:
    rig = Rig(seed=2)
    rig.hold(HELD)
    with router(endpoint) as session:
        subscriber = Subscriber(session, "lab")
        with TwinService(Model.load("ce152"), site="lab", endpoints=(endpoint,)) as service:
            introduce(session, service, rig)
            session.put("lab/rig/states", b"\xff\xff\xff")
            session.put("lab/rig/parameters", b"\x0a\xff")
            publish(session, list(rig.run(10, HELD)))
            wait_for_count(lambda: len(subscriber.payloads["lab/rig/twin/divergence"]), 10, "divergence")
            assert service.malformed == 2
            assert service.running


def test_an_end_that_does_not_wait_for_all_that_is_queued_is_no_failure(endpoint: str) -> None:
    rig, begun, closed = Rig(seed=2), threading.Event(), threading.Event()

    def prepare(_model: Model) -> Any:
        begun.set()
        assert closed.wait(HANG_S)

    def board_is_seen() -> bool:
        session.put("lab/rig/parameters", rig.parameters().SerializeToString())
        return begun.is_set()

    with router(endpoint) as session:
        service = TwinService(Model.load("ce152"), site="lab", endpoints=(endpoint,), namers=prepare)
        service.start()
        wait(board_is_seen, "board at the twin")
        service.stop()
        closed.set()
        wait(lambda: not service.running, "end of the worker")

    assert service.failure is None
    assert service.dropped >= 1


def test_it_waits_for_a_router_and_survives_its_restart(endpoint: str) -> None:
    """Samples lost meanwhile are a gap: out of step, never bridged over."""
    rig = Rig(seed=2)
    rig.hold(HELD)
    with TwinService(Model.load("ce152"), site="lab", endpoints=(endpoint,)) as service:
        with router(endpoint) as session:
            introduce(session, service, rig)
            publish(session, list(rig.run(300, HELD)))
            wait_for_count(lambda: service.boards["rig"].samples, 300, "samples")
            assert service.boards["rig"].mirror.sync == IN_STEP
        list(rig.run(100, HELD))  # nobody hears these
        with router(endpoint) as session:
            subscriber = Subscriber(session, "lab")
            introduce(session, service, rig)
            publish(session, list(rig.run(300, HELD)))
            wait_for_count(
                lambda: len(subscriber.payloads["lab/rig/twin/divergence"]), 300, "divergence after the restart"
            )

        first = pb.Divergence.FromString(subscriber.payloads["lab/rig/twin/divergence"][0])
        assert first.sync == "out-of-step"
        assert service.boards["rig"].mirror.sync == IN_STEP
        assert service.boards["rig"].mirror.counters["out_of_step:lost-samples"] == 1


def test_a_twin_that_hears_status_and_no_samples_hears_through_a_new_session(monkeypatch: pytest.MonkeyPatch) -> None:
    """The fault is real: a rule of the router keeps the states from the one session."""
    monkeypatch.setattr(service_module, "DEAF_S", 1.0)
    endpoint = free_endpoint()
    with TwinService(Model.load("ce152"), site="lab", endpoints=(endpoint,)) as service:  # waits for its router
        assert service._session is not None
        config = json.loads(zenoh_config("router", listen=[endpoint]))
        config["access_control"] = {
            "enabled": True,
            "default_permission": "allow",
            "rules": [
                {
                    "id": "deaf", "permission": "deny", "messages": ["put"], "flows": ["egress"],
                    "key_exprs": ["lab/rig/states"],
                }
            ],
            "subjects": [{"id": "first", "zids": [str(service._session.zid())]}],
            "policies": [{"rules": ["deaf"], "subjects": ["first"]}],
        }  # fmt: skip
        with zenoh.open(zenoh.Config.from_json5(json.dumps(config))) as session, streaming(session):
            wait(lambda: "rig" in service.boards and service.boards["rig"].samples > 20, "samples", 40.0)

        assert service.renewed >= 1  # on a busy machine a new session may need longer than a second


def streaming(session: zenoh.Session) -> AbstractContextManager[None]:
    """A board that streams, as a gateway publishes it."""
    ticks = itertools.count(1)
    status = pb.Status(link="streaming", samples_per_s=500.0).SerializeToString()

    def publish() -> None:
        tick = next(ticks)
        state = pb.State(sequence=tick, tick=tick, session=1)
        session.put("lab/rig/states", pb.StateBatch(states=[state]).SerializeToString())
        session.put("lab/rig/status", status)

    return repeated(publish, 0.02)


def test_a_tick_is_sent_alone_only_where_somebody_subscribes_to_ticks(endpoint: str) -> None:
    rig = Rig(seed=2)
    rig.hold(HELD)
    singles: list[pb.Divergence] = []
    together: list[pb.Divergence] = []
    with router(endpoint) as session, TwinService(Model.load("ce152"), site="lab", endpoints=(endpoint,)) as service:
        batches = session.declare_subscriber(
            "lab/rig/twin/states", lambda s: together.extend(pb.TwinBatch.FromString(s.payload.to_bytes()).divergences)
        )
        introduce(session, service, rig)
        publish(session, list(rig.run(100, HELD)))
        wait_for_count(lambda: len(together), 100, "divergences together")

        ticks = session.declare_subscriber(
            "lab/rig/twin/divergence", lambda s: singles.append(pb.Divergence.FromString(s.payload.to_bytes()))
        )

        def noticed() -> bool:
            publish(session, list(rig.run(10, HELD)))
            return bool(singles)

        wait(noticed, "tick alone")
        wait(lambda: bool(singles) and singles[-1] == together[-1], "end of both")
        assert singles == together[-len(singles) :]
        assert singles[0].tick > together[99].tick, "none before the subscription"
        del batches, ticks
