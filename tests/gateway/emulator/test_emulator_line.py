"""A board on its line: pace, time, faults of the board; in emulated time, without a port to the outside."""

from __future__ import annotations

from itertools import pairwise

import pytest

from gateway.emulator.faults import parse
from gateway.emulator.firmware_model.flash import BOOT_TICKS, INPUT, WATCHDOG_TICKS
from gateway.emulator.line import BoardLine
from gateway.emulator.serve import Server, build_lines
from protocol.wire.decoder import BadFrame, Event, State, StreamDecoder
from protocol.wire.messages import EventCode, Message, Mode
from tests.harness.gateway.board_host import Bench, Host, frame

pytestmark = pytest.mark.usefixtures("each_firmware")


class Wire:
    """A port in memory that notes in which tick which byte passed."""

    def __init__(self) -> None:
        self.to_board = b""
        self.from_board: list[bytes] = []
        self.opened: list[bool] = []  # renamed or not
        self.is_open = False
        self.reads = 0

    @property
    def url(self) -> str:
        return "memory"

    def open(self, *, renamed: bool = False) -> None:
        self.opened.append(renamed)
        self.is_open = True

    def close(self) -> None:
        self.is_open = False

    def connected(self) -> bool:
        return self.is_open

    def read(self, limit: int) -> bytes:
        self.reads += 1
        data, self.to_board = self.to_board[:limit], self.to_board[limit:]
        return data

    def write(self, data: bytes, wait_s: float = 0.0) -> int:
        if not self.is_open:
            return 0
        self.from_board.append(data)
        return len(data)

    def events(self) -> list[Event]:
        return StreamDecoder().feed(b"".join(self.from_board))


def run(line: BoardLine, ticks: int) -> None:
    for _ in range(ticks):
        line.step()


def on_a_line(*faults: str, baud: int = 115200, seed: int = 0) -> tuple[BoardLine, Wire, Bench]:
    wire, bench = Wire(), Bench()
    return BoardLine(Host.make(bench), wire, baud=baud, faults=[parse(text) for text in faults], seed=seed), wire, bench


def states(wire: Wire) -> list[State]:
    return [event for event in wire.events() if isinstance(event, State)]


def codes(wire: Wire) -> list[int]:
    return [event.int("code") for event in wire.events() if isinstance(event, Message) and event.name == "EVENT"]


@pytest.mark.parametrize("baud", [9600, 19200, 115200, 921600])
def test_never_more_bytes_than_the_baud_rate_allows(baud: int) -> None:
    line, wire, _ = on_a_line(baud=baud)
    per_tick = baud * 0.002 / 10
    for n in range(1, 60):  # answers of 59 bytes, so that there is always something to send
        wire.to_board += frame("HELLO", id=n, session=1, version_min=1, version_max=1)

    sent = [0]
    for _ in range(500):
        line.step()
        sent.append(sum(map(len, wire.from_board)))

    for window in (1, 10, 100, 500):
        assert all(b - a <= window * per_tick + 1 for a, b in zip(sent, sent[window:], strict=False))
    if baud < 115200:  # STATE alone asks for 75 kbit/s: the line is full all the time
        assert sent[-1] == int(500 * per_tick)
        assert line.counts.frames_dropped > 0


def test_at_115200_the_stream_takes_65_percent_and_nothing_is_dropped() -> None:
    line, wire, _ = on_a_line()

    run(line, 1000)

    assert line.counts.bytes_sent == 1000 * 15 + 2 * 14  # STATE, and two events: reset, host lost
    assert line.counts.bytes_sent < 0.66 * 2.0 * 11520
    assert line.counts.frames_dropped == 0
    assert [state.sequence for state in states(wire)] == list(range(1000))


def test_bytes_to_the_board_take_their_time_too() -> None:
    line, wire, _ = on_a_line(baud=9600)  # 1.92 bytes per tick
    wire.to_board = frame("HELLO", id=1, session=1, version_min=1, version_max=1) + frame("SET_MODE", id=2, mode=1)

    ticks = 0
    while line.firmware.mode == Mode.IDLE:
        line.step()
        ticks += 1

    assert ticks == 10  # 19 bytes take 19.8 ms


def test_ticks_that_run_together_send_together_what_single_ticks_send() -> None:
    single, wire, _ = on_a_line()
    together, collected, _ = on_a_line()

    run(single, 40)
    for _ in range(10):
        together.step(4)

    assert b"".join(collected.from_board) == b"".join(wire.from_board)
    assert len(collected.from_board) == 10


def test_ticks_that_run_together_ask_a_silent_host_once() -> None:
    line, wire, _ = on_a_line()

    line.step(4)
    reads_of_silence = wire.reads
    wire.to_board = frame("HELLO", id=1, session=1, version_min=1, version_max=1) * 4
    line.step(4)

    assert reads_of_silence == 1
    assert wire.reads == 1 + 3  # two ticks carry them, and then there is none
    assert not wire.to_board


def test_a_latency_timer_makes_ticks_run_together() -> None:
    wire = Wire()

    Server(build_lines([wire]), latency_timer_s=20e-3).run(0.5)

    assert len(states(wire)) == 250
    assert len(wire.from_board) <= 25  # fewer on a busy machine


def test_what_was_sent_before_the_plug_was_pulled_arrives() -> None:
    line, wire, _ = on_a_line("disconnect=1@0.02")

    line.step(40)

    assert [state.sequence for state in states(wire)] == list(range(10))


@pytest.mark.parametrize("name", ["HELLO", "READ_CAPTURE"])
def test_an_answer_leaves_within_20_ms(name: str) -> None:
    line, wire, _ = on_a_line()
    wire.to_board = frame("HELLO", id=1, session=1, version_min=1, version_max=1)
    run(line, 20)
    wire.to_board = frame("CAPTURE", id=2, u_from=0, u_to=0, pre=0, count=64)
    run(line, 40)
    again = {
        "HELLO": frame("HELLO", id=3, session=1, version_min=1, version_max=1),
        "READ_CAPTURE": frame("READ_CAPTURE", id=3, index=0),
    }
    wire.from_board.clear()

    wire.to_board = again[name]
    ticks = 0
    while not any(isinstance(event, Message) and event.values.get("id") == 3 for event in wire.events()):
        line.step()
        ticks += 1

    assert ticks * 2 <= 20 + 2  # its own last byte comes in within the first tick


def test_stop_acts_when_its_last_byte_is_in() -> None:
    line, wire, bench = on_a_line()
    wire.to_board = frame("HELLO", id=1, session=1, version_min=1, version_max=1) + frame("SET_MODE", id=2, mode=1)
    run(line, 2)
    wire.to_board = frame(
        "EXCITE", id=3, shape=0, target=0, amplitude=0, offset=900, period=1, period_end=1, seed=1, duration=0
    )
    run(line, 2)
    bench.inputs.clear()

    wire.to_board = frame("STOP", id=4)
    line.step()

    # 7 bytes of 86.8 us, cut to the 20 us of the plant's time.
    assert bench.inputs == [(INPUT.to_si(900), 600), (0.0, 1400)]


def test_flips_show_as_bad_frames_and_gaps() -> None:
    line, wire, _ = on_a_line("flip=1e-3:tx")

    run(line, 2000)

    bad = [event for event in wire.events() if isinstance(event, BadFrame)]
    got = [state.sequence for state in states(wire)]
    assert line.counts.bytes_damaged > 0
    assert 0 < len(bad) <= line.counts.bytes_damaged * 2
    assert len(got) >= 2000 - line.counts.bytes_damaged
    assert all(b > a for a, b in pairwise(got))


@pytest.mark.parametrize("fault", ["flip=0.05:rx", "lost=0.05:rx", "duplicate=0.05:rx", "insert=0.05:rx", "baud=9:rx"])
def test_damage_on_the_way_to_the_board_is_counted_by_the_board(fault: str) -> None:
    line, wire, _ = on_a_line(fault)

    wire.to_board = b"".join(frame("PING", id=1 + n % 255) for n in range(300))
    run(line, 150)

    assert line.firmware.bad_frames > 0
    assert all(not isinstance(event, BadFrame) for event in wire.events())


@pytest.mark.parametrize("fault", ["lost=0.01:tx", "duplicate=0.01:tx", "insert=0.01:tx", "baud=1@1:tx"])
def test_damage_on_the_way_to_the_host_is_seen_by_the_host(fault: str) -> None:
    line, wire, _ = on_a_line(fault)

    run(line, 1000)

    assert any(isinstance(event, BadFrame) for event in wire.events())
    assert 100 < len(states(wire)) < 1000


def test_a_stall_delays_and_loses_nothing() -> None:
    line, wire, _ = on_a_line("stall=0.3@0.5")

    run(line, 500)
    during = b"".join(wire.from_board[250:])
    wire.from_board.clear()

    assert [state.sequence for state in StreamDecoder().feed(during) if isinstance(state, State)][-1] == 499
    assert line.counts.bytes_damaged == 0
    assert line.counts.bytes_not_taken == 0


def test_a_disconnect_closes_the_port_and_opens_it_again() -> None:
    line, wire, _ = on_a_line("disconnect=0.2@0.5:renamed")

    run(line, 300)
    was_closed = not wire.is_open
    run(line, 100)

    assert was_closed
    assert wire.is_open
    assert wire.opened == [False, True]
    sequences = [state.sequence for state in states(wire)]
    assert max(b - a for a, b in pairwise(sequences)) == pytest.approx(100, abs=2)


def test_a_reset_restarts_the_board_and_a_hang_ends_in_a_watchdog_reset() -> None:
    line, wire, _ = on_a_line("reset@0.4", "watchdog@1")

    run(line, 800)

    sequences = [state.sequence for state in states(wire)]
    restarts = [n for n, (a, b) in enumerate(pairwise(sequences)) if b < a]
    assert len(restarts) == 2
    assert sequences[restarts[0]] == 199
    assert sequences[restarts[0] + 1] == 0
    assert sequences[restarts[1]] == 500 - 200 - BOOT_TICKS - 1
    assert sequences[-1] == 800 - 500 - WATCHDOG_TICKS - BOOT_TICKS - 1
    assert [code for code in codes(wire) if code <= EventCode.RESET_COMMANDED] == [
        EventCode.RESET_POWER_ON,
        EventCode.RESET_POWER_ON,
        EventCode.RESET_WATCHDOG,
    ]


def test_a_power_cycle_cuts_the_frame_on_the_line() -> None:
    line, wire, _ = on_a_line()
    wire.to_board = frame("HELLO", id=1, session=1, version_min=1, version_max=1)
    run(line, 2)  # the 59 bytes of IDENTITY have begun

    line.power_cycle()
    run(line, 20)

    events = wire.events()
    assert sum(isinstance(event, BadFrame) for event in events) == 1
    assert not any(isinstance(event, Message) and event.name == "IDENTITY" for event in events)


def test_a_commanded_reset_lets_its_ack_leave_the_line() -> None:
    line, wire, _ = on_a_line()
    wire.to_board = frame("HELLO", id=1, session=1, version_min=1, version_max=1) + frame("RESET", id=2)
    run(line, 40)

    messages = [event for event in wire.events() if isinstance(event, Message)]
    ack = next(n for n, event in enumerate(messages) if event.name == "ACK" and event.int("command") == 0x0D)
    assert [event.int("code") for event in messages[ack + 1 :]] == [EventCode.RESET_COMMANDED]
    assert not any(isinstance(event, BadFrame) for event in wire.events())


def test_a_reset_does_not_hide_what_was_dropped_before() -> None:
    line, _, _ = on_a_line("watchdog@0.9", baud=9600)

    run(line, 440)
    before = line.counts.frames_dropped
    run(line, 60)

    assert line.counts.frames_dropped >= before > 100


def test_an_overrun_is_reported() -> None:
    line, wire, _ = on_a_line("overrun@0.1/0.1")

    run(line, 100)

    assert codes(wire).count(EventCode.OVERRUN) == 1  # the flag tells the others, the event comes once a second
    assert [state.sequence for state in states(wire) if state.flags & 0x20] == [50]


def test_a_fault_injected_later_counts_from_then() -> None:
    line, wire, _ = on_a_line()
    run(line, 100)

    line.inject(parse("lost=1@0.1+0.1:tx"))
    run(line, 300)

    lost = set(range(400)) - {state.sequence for state in states(wire)}
    assert lost >= set(range(151, 199))
    assert lost <= set(range(149, 201))
