"""Logs of a lab and recordings of a plant, made message by message, and what one lacks of the other."""

from __future__ import annotations

import random
from collections import Counter
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from threading import Event, Thread

import zenoh
from google.protobuf.message import Message

from gateway.record.blocks import locate
from gateway.record.writer import LogWriter
from gateway.sites.server import LogServer
from protocol.bus import board51_pb2 as pb
from protocol.bus.endpoint import zenoh_config
from protocol.bus.topics import RECORDED
from protocol.log.reader import LogReader
from tests.harness.gateway.gateway_peers import wait_for
from tests.harness.ports import free_endpoint

BEGAN_NS = 1_767_225_600 * 10**9  # when the lab's log began
TICK_NS = 2_000_000
TICKS_A_SECOND = 500
Records = list[tuple[str, bytes, int]]


def flight(
    count: int, *, board: str = "rig1", session: int = 7, first: int = 1000, seed: int = 1, began_ns: int = BEGAN_NS
) -> Records:
    """Return a gateway's records of `count` ticks.

    They are states, a twin, each second a status and a model, and now and then an event.
    """
    draw, records = random.Random(seed), Records()

    def add(topic: str, message: Message, now_ns: int) -> None:
        records.append((f"board51/{board}/{topic}", message.SerializeToString(), now_ns))

    for tick in range(first, first + count):
        now_ns = began_ns + tick * TICK_NS
        state = pb.State(tick=tick, sequence=tick & 0xFFFF, session=session, host_time_ns=now_ns, x_m=draw.random())
        add("state", state, now_ns)
        add("twin/state", pb.TwinState(tick=tick, session=session), now_ns + 300_000)
        if tick % TICKS_A_SECOND == 0:
            add("status", pb.Status(host_time_ns=now_ns, samples=tick), now_ns)
            add("twin/model", pb.TwinModel(session=session, name="ce152", host_time_ns=now_ns), now_ns)
            add("twin/model", pb.TwinModel(session=session, name="of an older twin"), now_ns)
            add("twin/alarms", pb.TwinAlarms(host_time_ns=now_ns), now_ns)
        if draw.random() < 1e-3:
            add("event", pb.Event(host_time_ns=now_ns, name="limit-hit", text=str(draw.random())), now_ns)
            add("twin/alarm", pb.Alarm(host_time_ns=now_ns, tick=tick, session=session, name="divergence-x"), now_ns)
    return records


def write(path: Path, records: Iterable[tuple[str, bytes, int]], *, finish: bool = True) -> LogWriter:
    """Write a part; flushed often, as a recorder does."""
    path.parent.mkdir(exist_ok=True)
    writer = LogWriter(path)
    for number, record in enumerate(records):
        writer.write(*record)
        if number % 200 == 199:
            writer.flush()
    writer.flush()
    if finish:
        writer.close()
    return writer


def without(records: Records, *cuts: tuple[float, float]) -> Records:
    """The records that do not lie in these shares of the time."""
    first_ns, span_ns = records[0][2], records[-1][2] - records[0][2]
    return [r for r in records if not any(a <= (r[2] - first_ns) / span_ns < b for a, b in cuts)]


def held(folder: Path, *, before_ns: int = 1 << 64, parts: str = "*.mcap") -> Counter[tuple[str, bytes]]:
    """The records of a folder that a fill is about, and how often each is there."""
    counts: Counter[tuple[str, bytes]] = Counter()
    for path in folder.glob(parts):
        if path.stat().st_size:
            records = LogReader(path).raw(topics_=RECORDED)
            counts.update((r.key, r.data) for r in records if r.time_ns < before_ns and locate(r) is not None)
    return counts


def missing(lab: Path, plant: Path, *, before_ns: int = 1 << 64, parts: str = "*.mcap") -> int:
    """Return how many records of the lab's log the plant lacks."""
    counts = held(plant, parts=parts)
    return sum(key not in counts for key in held(lab, before_ns=before_ns))


def account(lab: Path, plant: Path) -> tuple[int, int]:
    """Return how many records of the lab's log the plant lacks, and how many it has more than once."""
    return missing(lab, plant), sum(n > 1 for n in held(plant).values())


@contextmanager
def answering(session: zenoh.Session, folder: Path, *, site: str = "board51") -> Iterator[None]:
    """A log server on a session."""
    stop = Event()
    thread = Thread(target=LogServer(folder, site).serve, args=(session, stop))
    thread.start()
    try:
        yield
    finally:
        stop.set()
        thread.join()


@contextmanager
def served(folder: Path, *, site: str = "board51") -> Iterator[str]:
    """A router with a log server; its endpoint."""
    endpoint = free_endpoint()
    with (
        zenoh.open(zenoh.Config.from_json5(zenoh_config("router", listen=[endpoint]))) as session,
        answering(session, folder, site=site),
    ):
        wait_for(lambda: list(session.get(f"{site}/_logs/*", payload=b"")), "log server")
        yield endpoint
