"""Commands through a real gateway while line, board or gateway fail: what was given up never acts, nothing twice."""

from __future__ import annotations

import contextlib
import itertools
import os
import socket
import subprocess
import sys
import termios
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import pytest

import board51
from gateway.emulator.serve import Emulator
from gateway.views.opcua.address_space.model import methods
from gateway.views.opcua.operations import called, code_of
from protocol.bus import board51_pb2 as pb
from protocol.wire.messages import Message
from tests.harness.gateway.gateway_peers import Bus, ScriptedBoard, client, gateway_and_client, gateway_config, wait_for
from tests.harness.ports import free_port

QUICK: dict[str, Any] = {"command_timeout_s": 0.3, "command_retries": 1}
CLOSED = pb.SetMode(mode=pb.MODE_CLOSED_LOOP)


class SocketBoard(ScriptedBoard):
    """The same behind a TCP port, as a serial server."""

    def __init__(self) -> None:
        super().__init__()
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.url = f"socket://127.0.0.1:{self._listener.getsockname()[1]}"
        self._pty = self.master

    def _work(self) -> None:
        connection, _ = self._listener.accept()
        self.master = connection.fileno()
        with connection, self._listener, contextlib.suppress(OSError):  # the gateway ends before the board
            super()._work()
        self.master = self._pty


def modes(board: ScriptedBoard) -> list[int]:
    """Return the mode of each SET_MODE; the repetitions of one have its id and do not count."""
    return list({m.int("id"): m.int("mode") for m in board.received if m.name == "SET_MODE"}.values())


def unanswered(reply: pb.CommandReply) -> pb.CommandReply | None:
    return reply if reply.reason == "timed-out" else None


def ping_after(board: ScriptedBoard) -> None:
    """Wait until the board has read everything that was written before now."""
    count = board.names().count("PING")
    wait_for(lambda: board.names().count("PING") > count + 1, "PINGs")


# -- a line that stops


@pytest.mark.slow
@pytest.mark.parametrize("kind", [ScriptedBoard, SocketBoard])
def test_what_was_given_up_while_the_board_did_not_read_never_reaches_it(kind: type[ScriptedBoard]) -> None:
    """The pipe in between (a pty, the buffers of a serial server) takes all the gateway writes, and gives it later."""
    with kind() as board, gateway_and_client(gateway_config(board.url, **QUICK)) as bus:
        wait_for(lambda: bus.messages["rig/parameters"], "parameters")
        board.reading = False
        ids = (f"early{n}" for n in itertools.count())  # the last one perhaps before the gateway can know
        early = wait_for(lambda: unanswered(bus.command(next(ids), set_mode=CLOSED)), "time-out")
        unsent = [bus.command(f"late{n}", set_mode=pb.SetMode(mode=pb.MODE_OPEN_LOOP)) for n in range(3)]
        gains = bus.command("gains", set_reference=pb.SetReference(x_ref_m=1e-3))

        board.reading = True
        ping_after(board)
        again = bus.command("late0", set_mode=pb.SetMode(mode=pb.MODE_OPEN_LOOP))

    assert [(r.reason, r.attempts) for r in (*unsent, gains)] == [("timed-out", 0)] * 4
    assert all("never will" in r.text for r in unsent)
    assert early.attempts == 0 or "unknown" in early.text
    assert again.accepted  # the line moves again, and so do commands; it is the only one in open loop
    assert modes(board).count(1) == 1
    assert "SET_REFERENCE" not in board.names()


def test_what_the_port_does_not_take_expires_and_stop_goes_first() -> None:
    with ScriptedBoard() as board, gateway_and_client(gateway_config(board.url, **QUICK)) as bus:
        wait_for(lambda: bus.messages["rig/parameters"], "parameters")
        termios.tcflow(board.slave, termios.TCOOFF)  # the kernel takes no more bytes of this port
        ping_limit = len(board.received)
        mode = bus.command("mode", set_mode=CLOSED)
        stop = bus.command("stop", stop=pb.Stop())

        termios.tcflow(board.slave, termios.TCOON)
        wait_for(lambda: "STOP" in board.names(), "STOP")
        ping_after(board)

    assert (mode.reason, mode.attempts) == ("timed-out", 0)
    assert (stop.reason, stop.attempts) == ("timed-out", 0)
    assert "is sent as soon as" in stop.text
    assert modes(board) == []
    assert [m.name for m in board.received[ping_limit:] if m.name not in ("PING", "GET_PARAMETERS")] == ["STOP"]


# -- a gateway that is killed


@contextmanager
def gateway_process(url: str, endpoint: str) -> Iterator[subprocess.Popen[bytes]]:
    environment = {k: v for k, v in os.environ.items() if not k.startswith("BOARD51_")}
    words = [sys.executable, "-m", "board51", "gateway", "--board", f"rig={url}", "--listen", endpoint, "--no-log"]
    process = subprocess.Popen(words, env=environment, stderr=subprocess.DEVNULL)
    try:
        yield process
    finally:
        process.kill()
        process.wait()


def test_a_command_whose_answer_died_with_the_gateway_is_not_executed_again_by_the_next() -> None:
    def answers(message: Message) -> bytes | None:
        return b"" if message.name == "SET_MODE" else None  # it is executed; the ACK does not come

    endpoint = f"tcp/127.0.0.1:{free_port()}"
    with ScriptedBoard(answers=answers) as board:
        with gateway_process(board.url, endpoint) as first, client(endpoint) as bus:
            wait_for(bus.states, "states")
            wait_for(lambda: dated(bus, ping=pb.Ping()).accepted, "a gateway that is old enough")
            command = pb.Command(id="once", issued_ns=time.time_ns(), set_mode=CLOSED)
            replies = bus.session.get("board51/rig/command", payload=command.SerializeToString(), timeout=5.0)
            wait_for(lambda: modes(board), "the execution")
            first.kill()
            assert [reply for reply in replies if reply.ok is not None] == []
        board._answers = lambda _: None
        with gateway_process(board.url, endpoint), client(endpoint) as bus:
            wait_for(bus.states, "states")
            again = bus.request(command.SerializeToString())
            wait_for(lambda: dated(bus, ping=pb.Ping()).accepted, "a gateway that is old enough")
            later = bus.request(command.SerializeToString())

    assert (again.reason, later.reason) == ("not-fresh", "not-fresh")
    next_commands = board.names()[len(board.names()) - board.names()[::-1].index("HELLO") :]
    assert "GET_PARAMETERS" in next_commands
    assert "SET_MODE" not in next_commands


def dated(bus: Bus, **what: Any) -> pb.CommandReply:
    return bus.request(pb.Command(id=os.urandom(8).hex(), issued_ns=time.time_ns(), **what).SerializeToString())


def test_a_client_of_ours_gets_through_to_a_gateway_that_has_just_started() -> None:
    with ScriptedBoard() as board:
        config = gateway_config(board.url)
        with gateway_and_client(config):
            words = ["send", "rig", "mode", "closed-loop", "--connect", config.zenoh.listen[0]]

            assert board51.main(words) == 0
        assert modes(board) == [2]


# -- on the shipped emulator, as people send


@pytest.fixture(scope="module")
def line() -> Iterator[tuple[Bus, str]]:
    with Emulator() as emulator:
        config = gateway_config(*emulator.urls)
        with gateway_and_client(config) as bus:
            yield bus, config.zenoh.listen[0]


def send(endpoint: str, *words: str) -> int:
    return board51.main(["send", "rig", *words, "--connect", endpoint])


def in_mode(bus: Bus, mode: int) -> None:
    wait_for(lambda: bus.states()[-1].mode == mode, f"mode {mode}")


def test_stop_by_the_same_id_stops_every_time(line: tuple[Bus, str]) -> None:
    bus, endpoint = line
    for _ in range(2):
        assert send(endpoint, "mode", "closed-loop") == 0
        in_mode(bus, pb.MODE_CLOSED_LOOP)
        assert send(endpoint, "stop", "--id", "panel") == 0
        in_mode(bus, pb.MODE_IDLE)


def end_from_command_line(bus: Bus, endpoint: str) -> None:
    assert send(endpoint, "excite", "none") == 0


def end_from_page(bus: Bus, endpoint: str) -> None:
    reply = bus.command(os.urandom(8).hex(), excite=pb.Excite(shape=pb.SHAPE_NONE, on_reference=True))
    assert reply.accepted, reply.text


def end_from_opcua(bus: Bus, endpoint: str) -> None:
    from asyncua import ua

    excite = next(method for method in methods() if method.name == "Excite")
    values = {"on_reference": True, "shape": 0, "seed": 0}
    command = called(excite, [ua.Variant(values.get(a.name, 0.0), a.variant) for a in excite.arguments])
    assert isinstance(command, pb.Command)
    command.id = os.urandom(8).hex()
    reply = bus.request(command.SerializeToString())
    assert reply.accepted, reply.text


@pytest.mark.parametrize(
    ("reason", "code"), [("not-fresh", "BadInvalidTimestamp"), ("internal-error", "BadInternalError")]
)
def test_opcua_says_of_what_kind_a_refusal_is(reason: str, code: str) -> None:
    from asyncua import ua

    assert code_of(pb.CommandReply(reason=reason)) == getattr(ua.StatusCodes, code)


@pytest.mark.parametrize("end", [end_from_command_line, end_from_page, end_from_opcua])
@pytest.mark.parametrize(
    ("mode", "signal", "amplitude", "words"),
    [
        ("closed-loop", "x_ref_m", 2e-4, ["--on-reference", "--offset", "2.85e-3"]),
        ("open-loop", "u_c_v", 0.3, ["--offset", "0.6"]),
    ],
)
def test_an_excitation_ends_and_nothing_jumps(
    line: tuple[Bus, str], mode: str, signal: str, amplitude: float, words: list[str], end: Any
) -> None:
    bus, endpoint = line
    assert send(endpoint, "mode", mode) == 0
    sine = ["--amplitude", str(amplitude), "--period", "2", "--period-end", "2", "--duration", "500"]
    assert send(endpoint, "excite", "chirp", *words, *sine) == 0
    # Samples of before may come after a reply, which takes another way: at the beginning, and at the end.
    before = len(bus.states())
    wait_for(lambda: len({getattr(s, signal) for s in bus.states()[before:]}) > 50, "a signal that moves")
    first = len(bus.states())

    end(bus, endpoint)
    ended = len(bus.states())

    # No 0.6 s of the sine are constant.
    def is_constant() -> bool:
        states = bus.states()
        return len(states) > ended + 300 and len({getattr(s, signal) for s in states[-300:]}) == 1

    wait_for(is_constant, "a constant signal")
    values = [getattr(s, signal) for s in bus.states()[first:]]
    # The reply to the command needs a few ms, in which the sine goes on: far less than to any end of its range.
    assert max(abs(b - a) for a, b in itertools.pairwise(values)) < 0.5 * amplitude
    assert bus.states()[-1].mode == (pb.MODE_CLOSED_LOOP if mode == "closed-loop" else pb.MODE_OPEN_LOOP)
    assert send(endpoint, "stop") == 0
    in_mode(bus, pb.MODE_IDLE)


def test_an_endless_excitation_needs_the_word_and_a_gateway_without_a_bound(
    line: tuple[Bus, str], capsys: pytest.CaptureFixture[str]
) -> None:
    _, endpoint = line
    assert send(endpoint, "mode", "open-loop") == 0
    signal = ["excite", "rectangle", "--amplitude", "0.1", "--offset", "0.5", "--period", "1"]

    assert send(endpoint, *signal) == 2
    assert "--duration endless" in capsys.readouterr().err
    assert send(endpoint, *signal, "--duration", "endless") == 1
    assert "out-of-range: A duration of 0 s, endless, is outside the gateway's limit, up to 600 s" in (
        capsys.readouterr().out
    )
    assert send(endpoint, "stop") == 0


@pytest.mark.parametrize(
    "words",
    [
        ["stream", "5000000000"],
        ["stream", "-1"],
        ["excite", "prbs", "--seed", "5000000000", "--duration", "1"],
        ["excite", "prbs", "--duration", "0"],
        ["excite", "prbs", "--duration", "-1"],
        ["excite", "none", "--on-reference", "--offset", "0.003"],
        ["mark", "bad \udcff byte"],
        ["ping", "--who", "bad \udcff byte"],
        ["ping", "--timeout", "0"],
        ["ping", "--issued", "yesterday"],
    ],
)
def test_what_no_command_can_hold_is_bad_usage(words: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    try:
        code: object = send(f"tcp/127.0.0.1:{free_port()}", *words)
    except SystemExit as error:
        code = error.code

    assert code == 2
    assert "Traceback" not in capsys.readouterr().err
