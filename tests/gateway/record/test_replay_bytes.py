"""The bytes of a log as a board: untouched but for answers, which are given anew to whoever asks now."""

from __future__ import annotations

import os
import select
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from contextlib import closing
from pathlib import Path

import pytest

import board51
from gateway.commands.logs.replay_bytes import serve
from gateway.emulator.ports import pty_ports
from gateway.record.byte_replay import RecordedBoard
from gateway.record.writer import LogWriter
from protocol.bus import board51_pb2 as pb
from protocol.errors import DataError
from protocol.wire.codec import encode_body
from protocol.wire.decoder import Event, State, StreamDecoder
from protocol.wire.framing import encode_frame
from protocol.wire.messages import ROW_OF_NAME, EventCode, Message, Reason, Value
from tests.patience import HANG_S

REPO = Path(__file__).parents[3]
IDENTITY: dict[str, Value] = {
    "id": 9, "version": 1, "firmware_major": 1, "firmware_minor": 2, "board_id": 77, "tick": 70_000,
    "sample_time": 2000, "adc_bits": 12, "dac_bits": 12, "i_offset": 0.0, "i_lsb": 0.001, "x_offset": 0.0,
    "x_lsb": 1e-6, "u_offset": 0.0, "u_lsb": 0.001, "capture_time": 40, "capture_size": 2000, "reset_cause": 1,
    "build": b"test    ",
}  # fmt: skip
ACK = encode_frame(encode_body("ACK", id=9, command=3, tick=70_010))
NOISE = b"\x00\x07noise\x00\x02\x02"


def state_frame(tick: int) -> bytes:
    return encode_frame(encode_body("STATE", sequence=tick & 0xFFFF, i_c=1, x=2, u_c=3, x_ref=4, flags=2))


def identity(**changed: Value) -> bytes:
    return encode_frame(encode_body("IDENTITY", **{**IDENTITY, **changed}))


def reset(tick: int = 0) -> bytes:
    return encode_frame(encode_body("EVENT", number=1, tick=tick, code=int(EventCode.RESET_WATCHDOG), detail=1))


def raw(*pieces: bytes, step_ns: int = 2_000_000) -> list[pb.RawBytes]:
    return [pb.RawBytes(host_time_ns=5 + n * step_ns, data=data) for n, data in enumerate(pieces)]


def request(board: RecordedBoard, name: str, values: dict[str, Value], *, position: int = 0) -> Message:
    answer = board.answer(encode_frame(encode_body(name, **values)), position=position)
    (event,) = StreamDecoder().feed(answer)
    assert isinstance(event, Message)
    return event


def hello(number: int = 1) -> dict[str, Value]:
    return {"id": number, "session": 4242, "version_min": 1, "version_max": 1}


def test_everything_but_answers_goes_out_as_it_came() -> None:
    event = encode_frame(encode_body("EVENT", number=1, tick=3, code=11, detail=0))
    board = RecordedBoard(raw(state_frame(69_990) + NOISE, identity() + ACK + event, state_frame(70_001)))

    events = StreamDecoder().feed(b"".join(piece.data for piece in board.pieces))

    expected = StreamDecoder().feed(state_frame(69_990) + NOISE + b"\x00" + event + state_frame(70_001))
    assert events == expected
    assert board.removed == 2


def test_cuts_of_the_reads_do_not_matter() -> None:
    stream = state_frame(69_999) + identity() + ACK + state_frame(70_000) + state_frame(70_001)

    whole = RecordedBoard(raw(stream))
    bytewise = RecordedBoard(raw(*(stream[n : n + 1] for n in range(len(stream)))))

    assert bytewise.removed == whole.removed == 2
    sent = [StreamDecoder().feed(b"".join(p.data for p in board.pieces)) for board in (whole, bytewise)]
    assert sent[0] == sent[1]


def test_bytes_to_the_board_are_not_replayed() -> None:
    mine = pb.RawBytes(host_time_ns=6, to_board=True, data=encode_frame(encode_body("PING", id=3)))

    board = RecordedBoard([*raw(identity() + state_frame(70_001)), mine])

    assert [type(e) for p in board.pieces for e in StreamDecoder().feed(p.data)] == [State]


def test_hello_is_answered_as_then_with_the_id_and_tick_of_now() -> None:
    board = RecordedBoard(raw(state_frame(69_990), identity(), *(state_frame(t) for t in range(70_001, 70_051))))

    first, later = request(board, "HELLO", hello(1)), request(board, "HELLO", hello(2), position=31)

    assert first.name == "IDENTITY"
    assert first.values == {**IDENTITY, "id": 1, "tick": 69_990} | {
        name: first.values[name]
        for name in ("i_lsb", "x_lsb", "u_lsb")  # f32
    }
    assert (later.int("id"), later.int("tick")) == (2, 70_031)


def test_another_protocol_version_is_refused_as_the_board_would() -> None:
    board = RecordedBoard(raw(identity() + state_frame(70_001)))

    answer = request(board, "HELLO", {**hello(), "version_min": 2, "version_max": 9})

    assert (answer.name, answer.int("reason"), answer.int("detail")) == ("NACK", Reason.VERSION, 1)


def test_after_a_reset_the_board_says_what_it_said_after_it() -> None:
    again = identity(tick=50, firmware_minor=3)
    board = RecordedBoard(
        raw(identity(), state_frame(70_001), state_frame(70_002), reset(), state_frame(1), again, state_frame(51))
    )

    before, after = request(board, "HELLO", hello()), request(board, "HELLO", hello(), position=3)

    assert (before.int("firmware_minor"), before.int("tick")) == (2, 70_001)
    assert (after.int("firmware_minor"), after.int("tick")) == (3, 1)


def test_a_sequence_that_wraps_and_a_long_pause_keep_the_tick() -> None:
    ticks = [70_001, 90_000, 131_071, 131_072, 180_000]
    board = RecordedBoard(raw(identity(), *(state_frame(tick) for tick in ticks)))

    assert [piece.tick for piece in board.pieces] == ticks


@pytest.mark.parametrize("name", sorted({r.name for r in ROW_OF_NAME.values() if r.to_board} - {"HELLO", "PING"}))
def test_a_recording_cannot_be_influenced(name: str) -> None:
    board = RecordedBoard(raw(identity() + state_frame(70_001)))
    values: dict[str, Value] = {field.name: int(field.low or 0) for field in ROW_OF_NAME[name].fields}
    values["id"] = 5

    answer = request(board, name, values)

    assert answer.values == {
        "id": 5,
        "command": ROW_OF_NAME[name].type,
        "reason": int(Reason.NOT_AVAILABLE),
        "detail": 0,
    }
    assert board.refused == 1


def test_ping_and_parameters_are_answered_from_the_log() -> None:
    parameters = {field.name: int(field.low or 0) for field in ROW_OF_NAME["PARAMETERS"].fields} | {
        "id": 7,
        "k1_shift": 9,
    }
    pong = encode_frame(encode_body("PONG", id=6, tick=70_005, bad_frames=3, overruns=1))
    stream = identity() + encode_frame(encode_body("PARAMETERS", **parameters)) + pong
    board = RecordedBoard(raw(stream, state_frame(70_010), state_frame(70_020)))

    assert request(board, "GET_PARAMETERS", {"id": 12}).values == {**parameters, "id": 12}
    assert request(board, "PING", {"id": 13}, position=1).values == {
        "id": 13,
        "tick": 70_020,
        "bad_frames": 3,
        "overruns": 1,
    }


def test_noise_from_the_host_is_not_answered() -> None:
    board = RecordedBoard(raw(identity() + state_frame(70_001)))

    assert board.answer(b"\x00\x03noise\x00" + state_frame(3), position=0) == b""


@pytest.mark.parametrize(
    ("pieces", "says"), [([], "no bytes of the board"), ([state_frame(3)], "no IDENTITY"), ([NOISE], "no IDENTITY")]
)
def test_a_log_that_cannot_be_a_board_is_told(pieces: list[bytes], says: str) -> None:
    with pytest.raises(DataError, match=says):
        RecordedBoard(raw(*pieces))


def read_until(
    read: Callable[[], bytes], enough: Callable[[list[Event]], bool], *, seconds: float = HANG_S
) -> list[Event]:
    decoder, events = StreamDecoder(), list[Event]()
    deadline = time.monotonic() + seconds
    while not enough(events):
        assert time.monotonic() < deadline, f"only {len(events)} events came"
        events += decoder.feed(read())
    return events


def states(events: list[Event]) -> list[int]:
    return [event.sequence for event in events if isinstance(event, State)]


@pytest.mark.parametrize(("speed", "minimum_s"), [(0.0, 0.0), (5.0, 0.4)])
def test_a_pty_waits_for_hello_then_keeps_time(tmp_path: Path, speed: float, minimum_s: float) -> None:
    board = RecordedBoard(raw(identity(), *(state_frame(tick) for tick in range(70_001, 71_001))))  # 2 s
    link, stop = tmp_path / "board", threading.Event()
    (port,) = pty_ports(link, 1)
    port.open()
    with closing(port):
        thread = threading.Thread(target=serve, args=(board, port), kwargs={"speed": speed, "stop": stop})
        thread.start()
        host = os.open(link, os.O_RDWR | os.O_NOCTTY)
        try:
            assert select.select([host], [], [], 0.2)[0] == []  # silent: nobody asked yet
            begin = time.monotonic()
            os.write(host, encode_frame(encode_body("HELLO", **hello())))
            events = read_until(lambda: os.read(host, 4096), lambda received: len(states(received)) == 1000)
        finally:
            stop.set()
            thread.join()
            os.close(host)

    assert time.monotonic() - begin >= minimum_s - 0.002
    assert isinstance(events[0], Message)
    assert events[0].name == "IDENTITY"
    assert states(events) == [tick & 0xFFFF for tick in range(70_001, 71_001)]
    assert not link.exists()


def test_the_command_serves_a_log_on_tcp(tmp_path: Path) -> None:
    log = tmp_path / "run.mcap"
    writer = LogWriter(log)
    for message in raw(identity(), *(state_frame(tick) for tick in range(70_001, 70_301))):
        writer.write("board51/rig/raw", message.SerializeToString(), message.host_time_ns)
    writer.close()
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    process = subprocess.Popen(
        [sys.executable, "board51.py", "replay", str(log), "--bytes", "--tcp", f"127.0.0.1:{port}", "--speed", "0"],
        cwd=REPO, stdout=subprocess.PIPE, text=True,
    )  # fmt: skip
    assert process.stdout is not None
    assert process.stdout.readline() == f"board on socket://127.0.0.1:{port}\n"

    with _connect(port) as host:
        host.sendall(encode_frame(encode_body("HELLO", **hello())))
        events = read_until(lambda: host.recv(4096), lambda received: len(states(received)) == 300)
    output, _ = process.communicate(timeout=HANG_S)

    assert states(events) == [tick & 0xFFFF for tick in range(70_001, 70_301)]
    assert "pieces 300, of 300, answers_removed 1, refused 0" in output
    assert process.returncode == 0


def _connect(port: int) -> socket.socket:
    deadline = time.monotonic() + HANG_S
    while True:
        try:
            return socket.create_connection(("127.0.0.1", port), timeout=HANG_S)
        except ConnectionRefusedError:
            assert time.monotonic() < deadline
            time.sleep(0.02)


@pytest.mark.parametrize(
    ("options", "says"),
    [
        (["--bytes"], "needs a destination"),
        (["--bytes", "--tcp", "nowhere"], "is not an address"),
        (["--bytes", "--tcp", "127.0.0.1:9", "--loop"], "does not go with"),
    ],
)
def test_wrong_use_is_told(tmp_path: Path, options: list[str], says: str, capsys: pytest.CaptureFixture[str]) -> None:
    log = tmp_path / "run.mcap"
    writer = LogWriter(log)
    (message,) = raw(identity() + state_frame(70_001))
    writer.write("board51/rig/raw", message.SerializeToString(), 5)
    writer.close()

    assert board51.main(["replay", str(log), *options]) == 2

    error_output = capsys.readouterr().err
    assert says in error_output
    assert error_output.count("\n") == 1
