"""The way of one STATE frame through the gateway, step by step: processor time of the thread that does it.

One process and the gateway's own code; frames encoded before, one per read, as boards at 500 Hz give them.  The
baseline is bare_loop.py's for the same step.  What zenoh does in its own threads, and what the threads take from each
other, is in the end-to-end rows alone.
"""

from __future__ import annotations

import os
import selectors
import statistics
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path
from typing import Any

import zenoh
from mcap.writer import Writer

from gateway.board.scaling import StateEncoder
from gateway.bus.publisher import BoardSink, Publisher, Publishers
from gateway.config import BoardConfig
from gateway.link.clock import HostClock
from gateway.link.driver import BoardDriver
from gateway.link.io_thread import LinkThread
from gateway.link.port import Port, open_port
from gateway.link.sink import Sink
from gateway.record.recorder import Recorder, RecorderOptions
from gateway.record.writer import LogWriter
from protocol.bus.encoding import batch, descriptor_set
from protocol.bus.endpoint import zenoh_config
from protocol.wire.decoder import StreamDecoder
from protocol.wire.events import Sample
from protocol.wire.framing import encode_frame
from protocol.wire.messages import Message
from tests.bench.line.bare_loop import cobs, state_of
from tests.bench.line.load import Board, encode, recorded_states, reply
from tests.harness.ports import free_port

FRAMES, BLOCK = 20_000, 200
PERIOD_NS = 2_000_000
NOW_NS = 1_700_000_000_000_000_000
START_NS = 1_000_000_000_000  # monotonic, of tick 0
READS = ("read", "round")
STATE, RAW = "bench/b0/state", "bench/b0/raw"
GATHERED = 10  # states in a message of `states`
Work = Callable[[int], object]  # of frame n


class Nowhere:
    """A sink that drops everything."""

    def states(self, payloads: list[bytes], host_time_ns: int, read_mono_ns: int) -> None:
        """Drop samples."""

    def send(self, topic: str, message: object, host_time_ns: int) -> None:
        """Drop a message."""

    def raw(self, data: bytes, host_time_ns: int, *, to_board: bool) -> None:
        """Drop bytes."""

    def alive(self, *, alive: bool) -> None:
        """Drop the sign of life."""


def run() -> list[dict[str, Any]]:
    """Rows for `board51 bench gateway --part steps`."""
    frames = encode(recorded_states(1000), FRAMES)
    with tempfile.TemporaryDirectory(prefix="board51-steps-") as name, _bus() as bus:
        folder = Path(name)
        board = Board(folder, 0)
        us = measured(
            _reads(folder) | _serial_thread(folder, frames, bus) | _other_threads(folder, frames, bus),
            lambda n: os.write(board.master, frames[n]),
        )
    gateway_us = {
        "read: select, read": us["read"],
        "loop: the port's turn, nothing to write": us["round"] - us["read"],
        "decode: COBS, CRC, counts": us["decode"],
        "session: tick, losses": us["session"] - us["decode"],
        "SI units, protobuf": us["encode"],
        "driver: link, deadlines": us["driver"] - us["session"] - us["encode"],
        "hand-over to bus and log": us["hand-over"] - us["driver"],
        "log: rows of state and bytes": us["row"] + us["row of bytes"],
        "put: state": us["put"],
        f"put: states, {GATHERED} in one": us["put batch"] / GATHERED,
    }
    bare = {
        "read: select, read": us["read"],
        "decode: COBS, CRC, counts": us["bare decode"],
        "SI units, protobuf": us["bare state"] - us["bare decode"],
        "log: rows of state and bytes": us["bare row"],
        "put: state": us["put"],
    }
    gateway_us["sum"], bare["sum"] = sum(gateway_us.values()), sum(bare.values())
    return [
        {"name": f"step: {step}", "value": value, "unit": "us/frame", "baseline": bare.get(step),
         "ratio": value / bare[step] if step in bare else None, "note": "baseline: bare loop"}
        for step, value in gateway_us.items()
    ]  # fmt: skip


def measured(works: dict[str, Work], arrive: Work) -> dict[str, float]:
    """Return the thread's processor time of one call, us: the best of all blocks, each by its lowest decile.

    `arrive` comes before each call of READS, and is not counted.
    """
    best: dict[str, float] = {}
    # In turns: what disturbs the machine for a second disturbs them all.
    for start in range(0, FRAMES, BLOCK):
        for name, work in {"nothing": lambda _: None, **works}.items():
            times_ns = []
            for n in range(start, start + BLOCK):
                if name in READS:
                    arrive(n)
                begin_ns = time.thread_time_ns()
                work(n)
                times_ns.append(time.thread_time_ns() - begin_ns)
            us = statistics.quantiles(times_ns, n=10)[0] * 1e-3
            best[name] = min(best.get(name, us), us)
    return {name: best[name] - best["nothing"] for name in works}


def _serial_thread(folder: Path, frames: list[bytes], bus: zenoh.Session) -> dict[str, Work]:
    options = RecorderOptions(prefix="steps", rotate_bytes=1 << 40, rotate_s=1e9, queue=2 * FRAMES)
    publishers = Publishers(*(Publisher(name, FRAMES) for name in Publishers._fields))  # no thread is started
    sink = BoardSink(bus, "bench", "b0", publishers, Recorder(folder, options), log_raw=True)
    decoder, (session, driver, whole) = StreamDecoder(), (_streaming(to) for to in (Nowhere(), Nowhere(), sink))
    scaling, states = driver.known.scaling, StreamDecoder().feed(b"".join(frames))
    assert scaling is not None
    samples = [Sample(n, 1, 0, state, 0.0) for n, state in enumerate(states)]  # type: ignore[arg-type]  # all are
    encoder = StateEncoder(scaling, 1)
    return {
        "decode": lambda n: decoder.feed(frames[n]),
        "session": lambda n: session.session.feed(frames[n], (START_NS + n * PERIOD_NS) * 1e-9),
        "encode": lambda n: encoder.encode(samples[n], NOW_NS),
        "driver": lambda n: driver.received(frames[n], START_NS + n * PERIOD_NS),
        "hand-over": lambda n: whole.received(frames[n], START_NS + n * PERIOD_NS),
    }


def _reads(folder: Path) -> dict[str, Work]:
    """Select and read alone, and a round of the serial thread in which the driver does nothing."""
    port, selector = open_port(f"{folder}/tty0", 115200), selectors.DefaultSelector()
    assert isinstance(port, Port)
    selector.register(port.fd, selectors.EVENT_READ)
    driver = _streaming(Nowhere())
    link = LinkThread([driver])
    link._opened(link._lines[0], port)
    driver.received = lambda data, now_ns: None  # type: ignore[method-assign]
    return {
        "read": lambda _: (selector.select(0), port.read()),
        "round": lambda _: link._round(0.0),
    }


def _other_threads(folder: Path, frames: list[bytes], bus: zenoh.Session) -> dict[str, Work]:
    """The rows of the log and the puts; then what the bare loop does instead."""
    log, plain = LogWriter(folder / "ours.mcap"), Writer(BytesIO())
    plain.start()
    channel = plain.register_channel(STATE, "protobuf", plain.register_schema("State", "protobuf", descriptor_set()))
    block = zenoh.CongestionControl.BLOCK
    put, put_all = (bus.declare_publisher(key, congestion_control=block).put for key in (STATE, f"{STATE}s"))
    single = frames[0].strip(b"\0")
    state = state_of(single, NOW_NS)
    assert state is not None
    return {
        "row": lambda n: log.write(STATE, state, NOW_NS + n),
        "row of bytes": lambda n: log.write(RAW, frames[n], NOW_NS + n),
        "put": lambda _: put(state),
        "put batch": lambda _: put_all(batch("state", [state] * GATHERED)),
        "bare decode": lambda n: [cobs(frame) for frame in frames[n].split(b"\0")],
        "bare state": lambda n: [state_of(frame, NOW_NS) for frame in frames[n].split(b"\0")],
        "bare row": lambda n: plain.add_message(channel, n, state, n),
    }


def _streaming(sink: Sink) -> BoardDriver:
    """A driver after the handshake; tick 0 was at START_NS."""
    driver = BoardDriver(BoardConfig(name="b0", port="none"), sink, HostClock())
    driver.port_opened("none", START_NS * 1e-9)
    for _ in range(8):
        driver.poll(START_NS * 1e-9)
        output = driver.output()
        driver.wrote(len(output))
        for command in StreamDecoder().feed(output):
            assert isinstance(command, Message)
            driver.received(encode_frame(reply(command, 0, 0)), START_NS)
    return driver


@contextmanager
def _bus() -> Iterator[zenoh.Session]:
    """A router with a subscriber of another session, which takes no time of a thread here."""
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    with (
        zenoh.open(zenoh.Config.from_json5(zenoh_config("router", listen=[endpoint]))) as router,
        zenoh.open(zenoh.Config.from_json5(zenoh_config("client", connect=[endpoint]))) as client,
    ):
        subscriber = client.declare_subscriber("bench/**", zenoh.handlers.RingChannel(1))
        time.sleep(0.5)  # until the router knows it
        yield router
        subscriber.undeclare()
