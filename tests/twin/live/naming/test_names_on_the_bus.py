"""The twin publishes the cause that it names, and its end when it runs on another model."""

from __future__ import annotations

from functools import partial

import pytest
import zenoh

from protocol.bus import board51_pb2 as pb
from tests.harness.ports import free_endpoint
from tests.harness.twin.named_flight import AtOnce, NamedFlight
from tests.harness.twin.true_model import true_model
from tests.harness.twin.twin_bus import Subscriber, publish, router, wait
from twin.live.naming.namer import Namer
from twin.mirror.bus.client import hand_over
from twin.mirror.bus.handover import believe
from twin.mirror.bus.service import TwinService

TOPIC = "lab/rig/twin/diagnosis"


def last(subscriber: Subscriber) -> pb.TwinDiagnosis:
    payloads = subscriber.payloads[TOPIC]
    return pb.TwinDiagnosis.FromString(payloads[-1]) if payloads else pb.TwinDiagnosis()


def publish_first(session: zenoh.Session, service: TwinService, rig: NamedFlight) -> bool:
    """Publish the first sample; what is sent before zenoh has its routes is lost, and a repetition does no harm."""
    publish(session, rig.states[:1])
    return "rig" in service.boards


def has_processed(service: TwinService, count: int) -> bool:
    return service.boards["rig"].samples >= count


@pytest.mark.slow
def test_a_name_is_published_repeated_and_ended_by_another_model() -> None:
    rig = NamedFlight()
    rig.run(8.0)
    rig.begin({"coulomb-friction": 0.002})
    expected = rig.run(10.0)[-1]
    endpoint = free_endpoint()

    with router(endpoint) as session:
        subscriber = Subscriber(session, "lab")
        with TwinService(
            rig.model, site="lab", endpoints=(endpoint,), namers=partial(Namer, executor=AtOnce())
        ) as service:
            wait(lambda: publish_first(session, service, rig), "subscriber")
            for first in range(1, len(rig.states), 1000):  # less than its queue takes
                piece, count = rig.states[first : first + 1000], service.boards["rig"].samples
                publish(session, piece)
                wait(partial(has_processed, service, count + len(piece)), "samples")
            wait(
                lambda: last(subscriber).since_ns == expected.since_ns and last(subscriber).for_s == expected.for_s,
                "a name",
            )
            assert last(subscriber).SerializeToString() == expected.SerializeToString()
            count = len(subscriber.payloads[TOPIC])
            wait(lambda: len(subscriber.payloads[TOPIC]) > count, "repetition")
            assert last(subscriber).cause == "coulomb-friction"

            better = true_model(effects={"coulomb-friction": 0.002})
            hand_over(believe(better), site="lab", board="rig", endpoints=(endpoint,))

            wait(lambda: last(subscriber).cause == "", "end of the name")
    assert service.failure is None
