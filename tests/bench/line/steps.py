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
from functools import cache
from pathlib import Path
from typing import Any

import zenoh
from mcap.writer import Writer

from gateway.board.scaling import StateEncoder
from gateway.bus.publisher import BoardSink, Publisher, Publishers
from gateway.config import BoardConfig
from gateway.link.clock import HostClock
from gateway.link.driver import BoardDriver
from gateway.link.port import Port, open_port
from gateway.link.sink import Sink
from gateway.record.recorder import Recorder, RecorderOptions
from gateway.record.writer import LogWriter
from protocol.bus.encoding import descriptor_set, state_batch
from protocol.bus.endpoint import zenoh_config
from protocol.wire.decoder import StreamDecoder
from protocol.wire.events import Sample
from protocol.wire.framing import encode_frame
from protocol.wire.messages import Message
from tests.bench.line.bare_loop import state_of
from tests.bench.line.load import Board, encode, recorded_states, reply
from tests.harness.ports import free_port

FRAMES = 4000
PERIOD_NS = 2_000_000
NOW_NS = 1_700_000_000_000_000_000
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


@cache
def _idle_us() -> float:
    """The processor time of a call that does nothing."""
    return _timed(lambda _: None, lambda _: None)


def us_per_frame(work: Work, before: Work = lambda _: None) -> float:
    """Return the thread's processor time of one call, us, the lowest decile; `before` is not counted."""
    return _timed(work, before) - _idle_us()


def _timed(work: Work, before: Work) -> float:
    times_ns = []
    for n in range(FRAMES):
        before(n)
        start_ns = time.thread_time_ns()
        work(n)
        times_ns.append(time.thread_time_ns() - start_ns)
    return statistics.quantiles(times_ns, n=10)[0] * 1e-3  # the tenth that others on the machine disturb least


def run() -> list[dict[str, Any]]:
    """Rows for `board51 bench gateway --part steps`."""
    frames = encode(recorded_states(1000), FRAMES)
    with tempfile.TemporaryDirectory(prefix="board51-steps-") as name, _bus() as bus:
        ours = _serial_thread(Path(name), frames, bus) | _other_threads(Path(name), frames, bus)
        bare = _bare(Path(name), frames, bus, ours["read: select, read"])
    ours["sum"], bare["sum"] = sum(ours.values()), sum(bare.values())
    return [
        {"name": f"step: {step}", "value": us, "unit": "us/frame", "baseline": bare.get(step),
         "ratio": us / bare[step] if bare.get(step) else None, "note": "baseline: bare loop"}
        for step, us in ours.items()
    ]  # fmt: skip


def _serial_thread(folder: Path, frames: list[bytes], bus: zenoh.Session) -> dict[str, float]:
    options = RecorderOptions(prefix="steps", rotate_bytes=1 << 40, rotate_s=1e9)
    publishers = Publishers(*(Publisher(name, 10_000) for name in Publishers._fields))  # no thread is started
    sink = BoardSink(bus, "bench", "b0", publishers, Recorder(folder, options), log_raw=True)
    decoder = StreamDecoder()
    decode = us_per_frame(lambda n: decoder.feed(frames[n]))
    driver, start_ns = _streaming(Nowhere())
    session = us_per_frame(lambda n: driver.session.feed(frames[n], (start_ns + n * PERIOD_NS) * 1e-9))
    scaling, states = driver.known.scaling, StreamDecoder().feed(b"".join(frames))
    assert scaling is not None
    samples = [Sample(n, 1, 0, state, 0.0) for n, state in enumerate(states)]  # type: ignore[arg-type]  # all are
    encoder = StateEncoder(scaling, 1)
    encoded = us_per_frame(lambda n: encoder.encode(samples[n], NOW_NS))
    received = []
    for to in (Nowhere(), sink):
        driver, start_ns = _streaming(to)
        received.append(us_per_frame(lambda n: driver.received(frames[n], start_ns + n * PERIOD_NS)))  # noqa: B023
    return {
        "read: select, read": _read(folder, frames),
        "decode: COBS, CRC, counts": decode,
        "session: tick, losses": session - decode,
        "SI units, protobuf": encoded,
        "driver: link, deadlines": received[0] - session - encoded,
        "hand-over to bus and log": received[1] - received[0],
    }


def _read(folder: Path, frames: list[bytes]) -> float:
    board, port, selector = Board(folder, 0), open_port(f"{folder}/tty0", 115200), selectors.DefaultSelector()
    assert isinstance(port, Port)
    selector.register(port.fd, selectors.EVENT_READ)
    return us_per_frame(lambda _: (selector.select(0), port.read()), lambda n: os.write(board.master, frames[n]))


def _other_threads(folder: Path, frames: list[bytes], bus: zenoh.Session) -> dict[str, float]:
    log = LogWriter(folder / "ours.mcap")
    state, put = _state(frames), bus.declare_publisher(STATE, congestion_control=zenoh.CongestionControl.BLOCK).put
    put_all = bus.declare_publisher("bench/b0/states", congestion_control=zenoh.CongestionControl.BLOCK).put
    batch = [state] * GATHERED
    return {
        "log: a row for the state": us_per_frame(lambda n: log.write(STATE, state, NOW_NS + n)),
        "log: a row for the bytes": us_per_frame(lambda n: log.write(RAW, frames[n], NOW_NS + n)),
        "put: state, subscribed": us_per_frame(lambda _: put(state)),
        f"put: states, {GATHERED} in one": us_per_frame(lambda _: put_all(state_batch(batch))) / GATHERED,
    }


def _bare(folder: Path, frames: list[bytes], bus: zenoh.Session, read: float) -> dict[str, float]:
    with (folder / "bare.mcap").open("wb") as stream:
        log = Writer(stream)
        log.start()
        channel = log.register_channel(STATE, "protobuf", log.register_schema("State", "protobuf", descriptor_set()))
        put, state = bus.declare_publisher(STATE).put, _state(frames)
        return {
            "read: select, read": read,
            "SI units, protobuf": us_per_frame(lambda n: [state_of(f, NOW_NS) for f in frames[n].split(b"\0")[1:-1]]),
            "log: a row for the state": us_per_frame(lambda n: log.add_message(channel, n, state, n)),
            "put: state, subscribed": us_per_frame(lambda _: put(state)),
        }


def _state(frames: list[bytes]) -> bytes:
    state = state_of(frames[0].strip(b"\0"), NOW_NS)
    assert state is not None
    return state


def _streaming(sink: Sink) -> tuple[BoardDriver, int]:
    """A driver after the handshake, and the time of tick 0."""
    driver, start_ns = BoardDriver(BoardConfig(name="b0", port="none"), sink, HostClock()), time.monotonic_ns()
    driver.port_opened("none", start_ns * 1e-9)
    for _ in range(8):
        driver.poll(start_ns * 1e-9)
        asked = driver.output()
        driver.wrote(len(asked))
        for command in StreamDecoder().feed(asked):
            assert isinstance(command, Message)
            driver.received(encode_frame(reply(command, 0, 0)), start_ns)
    return driver, start_ns


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
        subscriber.undeclare()  # type: ignore[no-untyped-call]  # the stub has no return type
