"""A bus for twins under test: a router in this process, a board that publishes, a subscriber that remembers."""

from __future__ import annotations

import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import zenoh

from protocol.bus import board51_pb2 as pb
from protocol.bus import topics
from protocol.bus.encoding import BATCH_OF, parts
from protocol.bus.endpoint import zenoh_config
from tests.harness.twin.rig import Rig
from tests.patience import HANG_S
from twin.mirror.bus.service import TwinService


@contextmanager
def router(endpoint: str) -> Iterator[zenoh.Session]:
    with zenoh.open(zenoh.Config.from_json5(zenoh_config("router", listen=[endpoint]))) as session:
        yield session


def wait(condition: Callable[[], bool], what: str, seconds: float = HANG_S) -> None:
    deadline = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < deadline, f"no {what} within {seconds} s"
        time.sleep(0.01)


def wait_for_count(read_count: Callable[[], int], count: int, what: str, seconds: float = HANG_S) -> None:
    deadline = time.monotonic() + seconds
    while (now := read_count()) != count:
        assert time.monotonic() < deadline, f"{now} instead of {count} {what} within {seconds} s"
        time.sleep(0.01)


class Subscriber:
    """A subscriber to everything of one site: messages by key, and each tick as its batch has it.

    `singles` are the messages of one tick: sent only once the twin has noticed that somebody subscribes to them.
    """

    def __init__(self, session: zenoh.Session, site: str) -> None:
        self.payloads: dict[str, list[bytes]] = defaultdict(list)
        self.singles: dict[str, list[bytes]] = defaultdict(list)
        self.encodings: dict[str, str] = {}
        session.declare_subscriber(f"{site}/**", self._take)

    def _take(self, sample: zenoh.Sample) -> None:
        key, data = str(sample.key_expr), sample.payload.to_bytes()
        self.encodings[key] = str(sample.encoding)
        beginning, _, topic = key.partition("/twin/")
        if f"twin/{topic}" in BATCH_OF:
            self.singles[key].append(data)
        elif topic == "states":
            for name, part in parts("twin/states", pb.TwinBatch.FromString(data)):
                self.payloads[f"{beginning}/{name}"].append(part.SerializeToString())
        else:
            self.payloads[key].append(data)


def publish(session: zenoh.Session, states: list[pb.State], *, board: str = "rig") -> None:
    """Publish samples as a gateway does: blocking, so that nothing is lost here."""
    publish_to(session, topics.key("lab", board, "states"), states)


def publish_to(session: zenoh.Session, key: str, states: list[pb.State]) -> None:
    """Publish samples in batches of ten, as a gateway makes them of 500 Hz."""
    for first in range(0, len(states), 10):
        batch = pb.StateBatch(states=states[first : first + 10])
        session.put(key, batch.SerializeToString(), congestion_control=zenoh.CongestionControl.BLOCK)


def introduce(session: zenoh.Session, service: TwinService, rig: Rig, *, board: str = "rig") -> None:
    """`introduce_to` of a board of the site `lab`."""
    introduce_to(session, service, rig, topics.key("lab", board, "parameters"))


def introduce_to(session: zenoh.Session, service: TwinService, rig: Rig, key: str) -> None:
    """Repeat the parameters, as a gateway does, until the twin has heard them; then messages get through.

    `matching_status` does not say that: zenoh drops what is sent before its routes are computed, some ms after it.
    """
    count_before = service.parameters_received

    def has_arrived() -> bool:
        session.put(key, rig.parameters().SerializeToString())
        return service.parameters_received > count_before

    wait(has_arrived, "parameters at the twin")
