"""The surroundings of a gateway in its tests: a scripted board on a real pty, a collecting sink, a running daemon."""

from __future__ import annotations

import itertools
import json
import os
import select
import threading
import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeVar

import zenoh
from google.protobuf.message import Message as ProtoMessage

from gateway import daemon
from gateway.access.authorize import Sender
from gateway.config import BoardConfig, GatewayConfig, LogConfig, ZenohConfig
from protocol.bus import board51_pb2 as pb
from protocol.bus import topics
from protocol.bus.endpoint import zenoh_config
from protocol.log.reader import read
from protocol.wire.codec import encode_body
from protocol.wire.decoder import StreamDecoder
from protocol.wire.framing import encode_frame
from protocol.wire.messages import ROW_OF_NAME, Flag, Message
from tests.harness.ports import free_port
from tests.patience import HANG_S

T = TypeVar("T")


def wait_for(look: Callable[[], T | None], what: str, timeout_s: float = HANG_S) -> T:
    """The first truthy value of `look`, polled; fails with `what` at the deadline.

    A look may ask a server.  The longer it takes, the rarer it is asked: what is awaited needs the processor.
    """
    start_s = time.monotonic()
    while (waited_s := time.monotonic() - start_s) < timeout_s:
        value = look()
        if value:
            return value
        time.sleep(min(0.1, 0.005 + 0.02 * waited_s))
    raise AssertionError(f"no {what} within {timeout_s:g} s")


def frame(name: str, /, **values: Any) -> bytes:
    return encode_frame(encode_body(name, **values))


def identity_values(*, version: int = 1, board_id: int = 7) -> dict[str, Any]:
    return {
        "version": version, "firmware_major": 1, "firmware_minor": 0, "board_id": board_id, "sample_time": 2000,
        "adc_bits": 12, "dac_bits": 12, "i_offset": 0.0, "i_lsb": 5e-4, "x_offset": 0.0, "x_lsb": 1.5e-6,
        "u_offset": 0.0, "u_lsb": 1.25e-3, "capture_time": 40, "capture_size": 2000, "reset_cause": 1,
        "build": b"scripted",
    }  # fmt: skip


def parameters_values() -> dict[str, Any]:
    gains = {f"k{n}_{part}": 1 for n in range(1, 5) for part in ("mantissa", "shift")}
    return {
        "law": 0, **gains, "i_0": 1, "x_0": 1, "u_0": 1, "x_ref_min": 0, "x_ref_max": 4000, "x_ref_step": 4000,
        "x_ref_slew": 4000, "u_max": 4000, "divider": 1, "policy": 1, "timeout": 1000, "tick": 0,
    }  # fmt: skip


def usual_answer(command: Message, tick: int) -> bytes:
    """Return the answer of a board in good order."""
    number = command.int("id")
    match command.name:
        case "HELLO":
            return frame("IDENTITY", id=number, tick=tick, **identity_values())
        case "PING":
            return frame("PONG", id=number, tick=tick, bad_frames=0, overruns=0)
        case "GET_PARAMETERS":
            return frame("PARAMETERS", id=number, **parameters_values())
        case name:
            return frame("ACK", id=number, command=ROW_OF_NAME[name].type, tick=tick)


class ScriptedBoard:
    """Answers on the master side of a pty as far as its script goes; streams when told.

    `answers(command)` may return bytes instead of the usual answer, b"" for silence, None for the usual one.
    """

    def __init__(self, *, answers: Callable[[Message], bytes | None] = lambda _: None, streaming: bool = True) -> None:
        self.master, slave = os.openpty()
        import tty  # not on Windows, where the rest of this is used

        tty.setraw(slave)
        self.url = os.ttyname(slave)
        self.slave = slave  # held, so that the pty outlives a gateway that closes it
        self.received: list[Message] = []
        self.tick = 1000
        self.streaming = streaming
        self.reading = True
        self.flags = 0
        self.dropped_ticks: list[int] = []  # ticks whose STATE found the pty full
        self._answers = answers
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._work, daemon=True)

    def __enter__(self) -> ScriptedBoard:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stop.set()
        self._thread.join()
        os.close(self.master)
        os.close(self.slave)

    def send(self, data: bytes) -> bool:
        if not select.select([], [self.master], [], 0.0)[1]:  # a full pty drops, as a wire would
            return False
        os.write(self.master, data)
        return True

    def names(self) -> list[str]:
        return [message.name for message in self.received]

    def _work(self) -> None:
        decoder = StreamDecoder()
        while not self._stop.is_set():
            if select.select([self.master] if self.reading else [], [], [], 0.004)[0]:
                for message in decoder.feed(os.read(self.master, 4096)):
                    if isinstance(message, Message):
                        self.received.append(message)
                        self._answer(message)
            if self.streaming:
                self.tick += 1
                u_c = 0 if self.flags & Flag.FAULT else 3
                state = frame("STATE", sequence=self.tick & 0xFFFF, i_c=1, x=2, u_c=u_c, x_ref=4, flags=self.flags)
                if not self.send(state):
                    self.dropped_ticks.append(self.tick)

    def _answer(self, message: Message) -> None:
        scripted = self._answers(message)
        self.send(usual_answer(message, self.tick) if scripted is None else scripted)


def anybody() -> Sender:
    """Return a sender that sends now, on a bus that is not guarded."""
    return Sender(name="", role=None, arrived_ns=time.time_ns(), arrived_s=time.monotonic(), started_ns=0)


class Collector:
    """A sink that keeps what it is given."""

    def __init__(self) -> None:
        self.samples: list[pb.State] = []
        self.messages: dict[str, list[Any]] = defaultdict(list)
        self.is_alive = False

    def states(self, payloads: list[bytes], host_time_ns: int, read_mono_ns: int) -> None:
        self.samples += [pb.State.FromString(payload) for payload in payloads]

    def send(self, topic: str, message: ProtoMessage, host_time_ns: int) -> None:
        self.messages[topic].append(message)

    def raw(self, data: bytes, host_time_ns: int, *, to_board: bool) -> None:
        self.messages["raw"].append(pb.RawBytes(data=data, to_board=to_board, host_time_ns=host_time_ns))

    def alive(self, *, alive: bool) -> None:
        self.is_alive = alive

    def event(self, name: str) -> pb.Event | None:
        return next((e for e in self.messages["event"] if e.name == name), None)


class Bus:
    """A client session that keeps everything published about the boards."""

    def __init__(self, session: zenoh.Session) -> None:
        self.session = session
        self.messages: dict[str, list[Any]] = defaultdict(list)
        self._subscriber = session.declare_subscriber("board51/**", self._on_sample)

    def _on_sample(self, sample: zenoh.Sample) -> None:
        _, board, topic = topics.split(str(sample.key_expr)) or ("", "", "")
        if topic:
            message = topics.TOPIC_OF_NAME[topic].message.FromString(sample.payload.to_bytes())
            self.messages[f"{board}/{topic}"].append(message)

    def states(self, board: str = "rig") -> list[pb.State]:
        return self.messages[f"{board}/state"]

    def bad_frames_while_streaming(self, board: str = "rig") -> dict[str, int]:
        """Return the counts of bad frames while streaming, by cause.

        Opening a line on which a board already sends cuts one frame: that one comes before.
        """
        streaming = [s.bad_frames for s in self.messages[f"{board}/status"] if s.link == "streaming"]
        first, last = streaming[0], streaming[-1]
        return {cause: last[cause] - first.get(cause, 0) for cause in last if last[cause] != first.get(cause, 0)}

    def event(self, name: str, board: str = "rig") -> pb.Event | None:
        return next((e for e in self.messages[f"{board}/event"] if e.name == name), None)

    def await_event(self, name: str, board: str = "rig", timeout_s: float = HANG_S) -> pb.Event:
        return wait_for(lambda: self.event(name, board), f"event {name}", timeout_s)

    def await_states(self, count: int, board: str = "rig", timeout_s: float = HANG_S) -> list[pb.State]:
        """`count` states more than there are now."""
        start = len(self.states(board))
        wait_for(lambda: len(self.states(board)) >= start + count, f"{count} states", timeout_s)
        return self.states(board)[start:]

    def request(self, payload: bytes, board: str = "rig", timeout_s: float = HANG_S) -> pb.CommandReply:
        """The one reply to a query on the board's command key."""
        replies = list(self.session.get(f"board51/{board}/command", payload=payload, timeout=timeout_s))
        assert len(replies) == 1, "every command is answered, once"
        assert replies[0].ok is not None
        return pb.CommandReply.FromString(replies[0].ok.payload.to_bytes())

    def command(self, id: str, board: str = "rig", **what: Any) -> pb.CommandReply:
        return self.request(pb.Command(id=id, who="test", **what).SerializeToString(), board)


@contextmanager
def client(endpoint: str) -> Iterator[Bus]:
    config = json.loads(zenoh_config("client", connect=[endpoint]))
    config["connect"]["timeout_ms"] = round(1e3 * HANG_S)  # a gateway that was just started may take long
    with zenoh.open(zenoh.Config.from_json5(json.dumps(config))) as session:
        yield Bus(session)


def gateway_config(*urls: str, log: Path | None = None, **board: Any) -> GatewayConfig:
    """Boards `rig` (one) or `rig0`, `rig1`, ...; the router on a free port."""
    names = ["rig"] if len(urls) == 1 else [f"rig{n}" for n in range(len(urls))]
    options = {"reconnect_s": 0.05, "stale_s": 0.3, **board}
    return GatewayConfig(
        boards=tuple(BoardConfig(name=name, port=url, **options) for name, url in zip(names, urls, strict=True)),
        zenoh=ZenohConfig(listen=(f"tcp/127.0.0.1:{free_port()}",)),
        # Without a log no plant card can be kept, which one test would leave to another.
        log=LogConfig(enabled=log is not None, directory=str(log or os.devnull), min_free_bytes=0),
    )


@contextmanager
def running(config: GatewayConfig) -> Iterator[None]:
    """The daemon in a thread of this process; its exceptions come out here."""
    stop, failures = threading.Event(), []

    def work() -> None:
        try:
            daemon.run(config, stop)
        except Exception as error:
            failures.append(error)

    thread = threading.Thread(target=work)
    thread.start()
    try:
        yield
    finally:
        stop.set()
        thread.join(20.0)
        assert not thread.is_alive(), "the gateway does not end"
        if failures:
            raise failures[0]


@contextmanager
def gateway_and_client(config: GatewayConfig) -> Iterator[Bus]:
    """A running gateway and a client that sees its samples."""
    with running(config), client(config.zenoh.listen[0]) as bus:
        first = config.boards[0].name
        wait_for(lambda: bus.states(first), "first sample")
        yield bus


def with_log(config: GatewayConfig, **log: Any) -> GatewayConfig:
    return replace(config, log=replace(config.log, **log))


def gapless(states: list[pb.State]) -> bool:
    return all(b.tick == a.tick + 1 and b.lost_before == 0 for a, b in itertools.pairwise(states))


def consistent(states: list[pb.State]) -> bool:
    """Within a session every missing tick is counted."""
    pairs = itertools.pairwise(states)
    return all(b.session != a.session or b.tick == a.tick + 1 + b.lost_before for a, b in pairs)


def closed_loop(bus: Bus, board: str = "rig") -> None:
    assert bus.command("mode", board, set_mode=pb.SetMode(mode=pb.MODE_CLOSED_LOOP)).accepted


def logged_messages(log: Path, topic: str) -> list[Any]:
    return [record.message for record in read(log, topics=[topic])]
