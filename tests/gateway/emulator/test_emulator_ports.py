"""Ports, the server and the command, with raw sockets and file descriptors: nothing of the gateway in between."""

from __future__ import annotations

import contextlib
import json
import os
import select
import signal
import socket
import subprocess
import sys
import termios
import threading
import time
from collections.abc import Callable, Iterator
from itertools import combinations
from pathlib import Path
from typing import Self

import pytest

import board51
from gateway.emulator.ports import PtyPort, TcpPort
from gateway.emulator.serve import Emulator, Server, build_lines
from protocol.errors import ServiceError, UsageError
from protocol.wire.decoder import BadFrame, Event, State, StreamDecoder
from protocol.wire.messages import EventCode, Message
from tests.harness.gateway.board_host import frame
from tests.patience import HANG_S


class Wire:
    """A raw connection to a URL of the emulator."""

    def __init__(self, url: str) -> None:
        self._socket: socket.socket | None = None
        if url.startswith("socket://"):
            host, _, port = url.removeprefix("socket://").rpartition(":")
            self._socket = socket.create_connection((host, int(port)), timeout=HANG_S)
            self._file = self._socket.fileno()
        else:
            self._file = os.open(url, os.O_RDWR | os.O_NOCTTY)
        os.set_blocking(self._file, False)
        self._decoder = StreamDecoder()
        self.events: list[Event] = []
        self.bytes_read = 0

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        if self._socket is not None:
            self._socket.close()
        else:
            os.close(self._file)

    def write(self, data: bytes) -> None:
        assert os.write(self._file, data) == len(data)

    def until(self, wanted: Callable[[Event], bool]) -> Event:
        """Read until an event is what is wanted."""
        end = time.monotonic() + HANG_S
        while time.monotonic() < end:
            for event in self.read():
                if wanted(event):
                    return event
        raise AssertionError(f"not among {len(self.events)} events: {self.events[-5:]}")

    def until_hung_up(self) -> None:
        """Read until the other end has gone: an end of file, or an error of the port."""
        end = time.monotonic() + HANG_S
        with contextlib.suppress(EOFError, OSError):
            while time.monotonic() < end:
                self.read()
        assert time.monotonic() < end

    def read(self) -> list[Event]:
        if not select.select([self._file], [], [], 0.1)[0]:
            return []
        data = os.read(self._file, 4096)
        if not data:
            raise EOFError
        self.bytes_read += len(data)
        events = self._decoder.feed(data)
        self.events += events
        return events

    def local_flags(self) -> int:
        """The terminal's c_lflag."""
        flags = termios.tcgetattr(self._file)[3]
        assert isinstance(flags, int)
        return flags

    def hello(self, session: int = 1) -> Message:
        self.write(frame("HELLO", id=200, session=session, version_min=1, version_max=1))
        event = self.until(lambda event: isinstance(event, Message) and event.name == "IDENTITY")
        assert isinstance(event, Message)
        return event

    def states(self) -> list[State]:
        return [event for event in self.events if isinstance(event, State)]


def is_state(event: Event) -> bool:
    return isinstance(event, State)


def is_event(code: EventCode) -> Callable[[Event], bool]:
    return lambda event: isinstance(event, Message) and event.name == "EVENT" and event.int("code") == code


def until(condition: Callable[[], bool]) -> None:
    end = time.monotonic() + HANG_S
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.002)


@pytest.fixture(params=["tcp", "pty"])
def emulator(request: pytest.FixtureRequest) -> Iterator[Emulator]:
    with Emulator(tcp=request.param == "tcp") as emulator:
        yield emulator


def test_a_round_trip_over_the_real_port(emulator: Emulator) -> None:
    with Wire(emulator.urls[0]) as wire:
        identity = wire.hello()
        wire.write(frame("SET_MODE", id=2, mode=2))
        wire.until(lambda event: isinstance(event, State) and abs(event.x - event.x_ref) < 50)

    assert identity.int("board_id") == 1
    assert not any(isinstance(event, BadFrame) for event in wire.events[1:])  # it may begin in the middle of a frame


def test_hosts_come_and_go_and_find_no_stale_bytes(emulator: Emulator) -> None:
    with Wire(emulator.urls[0]) as first:
        first.until(is_state)
        left_at = first.states()[-1].sequence
    until(lambda: emulator.counts().bytes_not_taken > 2000)

    with Wire(emulator.urls[0]) as second:
        second.until(is_state)

    assert second.states()[0].sequence > left_at + 2000 // 15 - 10


def test_what_one_host_left_unread_is_not_for_the_next(tmp_path: Path) -> None:
    port = PtyPort(tmp_path / "board")
    port.open()

    def sent(data: bytes) -> int:
        """A host that has `data` to read."""
        host = os.open(port.url, os.O_RDWR | os.O_NOCTTY)
        port.read(1)
        assert port.write(data) == len(data)
        assert select.select([host], [], [], HANG_S)[0]
        return host

    os.close(sent(b"old"))
    assert port.read(1) == b""
    host = sent(b"new")
    assert os.read(host, 100) == b"new"
    os.close(host)
    port.close()


def test_unplug_ends_the_connection_and_plug_brings_it_back(emulator: Emulator) -> None:
    with Wire(emulator.urls[0]) as wire:
        wire.until(is_state)
        emulator.disconnect()
        wire.until_hung_up()
    with pytest.raises(OSError, match=r"refused|No such file"):
        Wire(emulator.urls[0])

    emulator.reconnect()

    with Wire(emulator.urls[0]) as wire:
        wire.until(is_state)


def test_reset_shows_as_a_new_start(emulator: Emulator) -> None:
    with Wire(emulator.urls[0]) as wire:
        wire.until(lambda event: isinstance(event, State) and event.sequence > 50)
        emulator.reset_board()
        wire.until(is_event(EventCode.RESET_POWER_ON))
        state = wire.until(is_state)

    assert isinstance(state, State)
    assert state.sequence < 50


def test_a_pty_is_raw_and_may_come_back_under_another_name(tmp_path: Path) -> None:
    link = tmp_path / "rig"
    with Emulator(tcp=False, pty=link) as emulator:
        with Wire(str(link)) as wire:
            wire.until(is_state)
            local_flags = wire.local_flags()
        emulator.disconnect()
        emulator.reconnect(renamed=True)
        with Wire(emulator.urls[0]) as wire:
            wire.until(is_state)
        renamed = emulator.urls[0]
        assert not link.exists()

    assert local_flags & (termios.ECHO | termios.ICANON | termios.ISIG) == 0
    assert renamed == f"{link}-renamed"
    assert list(tmp_path.iterdir()) == []


def test_one_host_at_a_time_on_tcp() -> None:
    with Emulator() as emulator, Wire(emulator.urls[0]) as first:
        first.until(is_state)
        with Wire(emulator.urls[0]) as second:
            second.until_hung_up()
        first.until(is_state)


def test_a_host_that_does_not_read_costs_bytes_and_not_the_board() -> None:
    with Emulator(tcp=False, speed=50.0) as emulator, Wire(emulator.urls[0]) as wire:
        until(lambda: emulator.counts().bytes_not_taken > 100_000)
        until(lambda: bool(wire.read()) and emulator.counts().time_s > 1.0)
        wire.until(is_state)


def test_real_time_is_kept() -> None:
    with Emulator() as emulator, Wire(emulator.urls[0]) as wire:
        wire.until(is_state)
        before_s = time.monotonic()
        first_s = emulator.counts().time_s
        start_s = time.monotonic()

        def ran_s() -> float:
            return emulator.counts().time_s - first_s

        until(lambda: time.monotonic() - start_s > 1.5)
        # Read in this order, whatever comes between two readings, only a board that is fast looks fast.
        most_s, wall_s = ran_s(), time.monotonic() - before_s
        # Deadlines are absolute: what a busy machine held up is caught up.
        until(lambda: time.monotonic() - start_s - ran_s() < 0.1)

    assert most_s < wall_s + 0.01


def test_what_a_busy_machine_held_up_is_not_caught_up_at_once() -> None:
    """All at once, a board would see no frame of its host for the whole time, and call it lost."""
    server = Server(build_lines([TcpPort("127.0.0.1", 0)]))
    thread = threading.Thread(target=server.run)
    thread.start()
    held_up, readings = threading.Event(), list[tuple[float, float, float]]()

    def board_s() -> float:
        return server.lines[0].counts.time_s

    def hold_up() -> None:
        time.sleep(1.0)
        held_up.set()

    def caught_up() -> bool:
        readings.append((time.monotonic(), board_s(), time.monotonic()))
        return board_s() > 3.0

    try:
        until(lambda: board_s() > 0.1)
        server.call(hold_up)
        until(held_up.is_set)
        until(caught_up)
    finally:
        server.stop()
        thread.join()

    for (begin_s, first_s, _), (_, last_s, end_s) in combinations(readings[::50], 2):
        assert last_s - first_s <= 2.0 * (end_s - begin_s) + 0.11


def test_speed_runs_the_board_faster() -> None:
    with Emulator(speed=20.0) as emulator:
        start, first = time.monotonic(), emulator.counts().time_s
        # 20 on an idle machine; on a busy one at times.
        until(lambda: emulator.counts().time_s - first > 5 * (time.monotonic() - start) + 2.0)


def test_as_fast_as_possible_waits_for_a_host_and_loses_nothing() -> None:
    with Emulator(speed=0.0) as emulator:
        time_before = emulator.counts().time_s
        with Wire(emulator.urls[0]) as wire:
            wire.until(lambda event: isinstance(event, State) and event.sequence >= 3000)
        sequences = [state.sequence for state in wire.states()]

    assert time_before == 0.0
    assert sequences == list(range(len(sequences)))


@pytest.mark.parametrize("words", [[], ["--pty", "PTY"]])
def test_as_fast_as_possible_a_duration_passes_without_a_host(
    words: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = [str(tmp_path / "board") if word == "PTY" else word for word in words]
    code = board51.main(["emulate", *words, "--speed", "0", "--duration", "0.2", "--json"])

    told = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert (code, told["counts"]["time_s"]) == (0, 0.2)


def test_a_fault_can_be_injected_while_it_runs() -> None:
    with Emulator() as emulator, Wire(emulator.urls[0]) as wire:
        wire.until(is_state)
        emulator.inject("flip=0.05:tx")
        wire.until(lambda event: isinstance(event, BadFrame))

        with pytest.raises(UsageError):
            emulator.inject("flop=1")


def test_several_boards_differ_in_id_and_noise_only() -> None:
    with Emulator(boards=3, board_id=40) as emulator:
        found = []
        for url in emulator.urls:
            with Wire(url) as wire:
                found.append((wire.hello().int("board_id"), tuple(state.x for state in wire.states())))

    assert [board for board, _ in found] == [40, 41, 42]
    assert len({readings for _, readings in found}) == 3


def test_a_port_in_use_is_an_error_and_leaves_nothing_open(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(UsageError, match="File exists"):
        Emulator(tcp=False, pty=tmp_path / "file")

    with Emulator() as emulator:
        port = int(emulator.urls[0].rpartition(":")[2])
        assert board51.main(["emulate", "--tcp", f"127.0.0.1:{port}"]) == ServiceError.exit_code


# The command


@pytest.fixture
def _same_signals() -> Iterator[None]:
    """A command in this process leaves its handlers behind."""
    before = {number: signal.getsignal(number) for number in (signal.SIGTERM, signal.SIGINT)}
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


@pytest.mark.slow
def test_the_command_serves_until_a_signal_and_cleans_up(tmp_path: Path) -> None:
    call = [sys.executable, "-m", "board51", "emulate", "--pty", str(tmp_path / "rig"), "--boards", "2"]
    process = subprocess.Popen(call, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert process.stdout is not None
    lines = [process.stdout.readline() for _ in range(2)]
    with Wire(lines[1].split()[-1]) as wire:
        wire.until(is_state)

    process.send_signal(signal.SIGINT)  # SIGTERM takes the same way: protocol/ending.py
    _, errors = process.communicate(timeout=HANG_S)

    assert [line.split() for line in lines] == [
        ["board", "1:", f"{tmp_path}/rig-1"],
        ["board", "2:", f"{tmp_path}/rig-2"],
    ]
    assert process.returncode == 0, errors
    assert "Traceback" not in errors
    assert list(tmp_path.iterdir()) == []


def test_the_command_serves_although_nobody_can_take_its_output(tmp_path: Path) -> None:
    words = ["emulate", "--pty", str(tmp_path / "rig"), "--duration", "0.1"]
    with open("/dev/full", "w") as full:  # as a file on a disk that has no room
        done = subprocess.run(
            [sys.executable, "-m", "board51", *words], stdout=full, stderr=subprocess.PIPE, text=True, check=False
        )

    assert done.returncode == 0, done.stderr


@pytest.mark.usefixtures("_same_signals")
def test_the_command_seals_its_secret_and_prints_json(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    secret = ["--secret", "7", "--sealed", str(tmp_path / "sealed.json")]
    assert board51.main(["emulate", "--tcp", "127.0.0.1:0", "--json", "--duration", "0.1", *secret]) == 0

    told = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert told[0]["board_id"] == 1
    assert told[0]["url"].startswith("socket://127.0.0.1:")
    assert (tmp_path / "sealed.json").exists()
    assert told[1]["commitment"]
    assert told[2]["counts"]["time_s"] == pytest.approx(0.1)


@pytest.mark.usefixtures("_same_signals")
@pytest.mark.parametrize(("host", "lines"), [("0.0.0.0", 1), ("127.0.0.1", 0), ("localhost", 0)])
def test_a_listener_beyond_this_machine_is_one_line_of_warning(
    host: str, lines: int, capsys: pytest.CaptureFixture[str]
) -> None:
    assert board51.main(["emulate", "--tcp", f"{host}:0", "--duration", "0.02"]) == 0

    warnings = [line for line in capsys.readouterr().err.splitlines() if "open to the network" in line]
    assert len(warnings) == lines
    assert all(f"--tcp {host}:0" in line and "may command" in line for line in warnings)


@pytest.mark.parametrize(
    "arguments",
    [
        ["--fault", "flood=1"],
        ["--effect", "magic=1"],
        ["--effect", "quadratic-drag"],
        ["--boards", "0"],
        ["--baud", "1"],
        ["--speed", "nan"],
        ["--tcp", "nonsense"],
        ["--tcp", "127.0.0.1:65535", "--boards", "2"],
        ["--pty", "/nowhere/at/all"],
        ["--secret", "1"],
        ["--secret", "1", "--sealed", "f", "--effect", "quadratic-drag=1"],
    ],
)
def test_bad_usage_is_one_line_and_exit_code_2(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    code = board51.main(["emulate", *arguments])

    errors = capsys.readouterr().err
    assert code == 2
    assert errors.count("\n") == 1
    assert errors.startswith("board51 emulate: ")


def test_the_help_lists_effects_and_faults(capsys: pytest.CaptureFixture[str]) -> None:
    with contextlib.suppress(SystemExit):
        board51.main(["emulate", "--help"])

    text = capsys.readouterr().out
    assert "quadratic-drag" in text
    assert "disconnect=S" in text
    assert "examples:" in text
