"""Tests of one board on a real pty behind the serial thread: states, reasons, sign of life, commands."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import pytest

from gateway.board.conditions import TO_BOARD
from gateway.config import BoardConfig
from gateway.link.clock import HostClock
from gateway.link.driver import BoardDriver
from gateway.link.io_thread import LinkThread
from protocol.bus import board51_pb2 as pb
from protocol.wire.decoder import StreamDecoder
from protocol.wire.messages import ROW_OF_NAME, EventCode, Message, Reason
from tests.harness.gateway.gateway_peers import (
    Collector,
    ScriptedBoard,
    anybody,
    frame,
    identity_values,
    parameters_values,
    wait_for,
)

NS = 1_000_000_000


@contextmanager
def linked(url: str, **options: Any) -> Iterator[tuple[BoardDriver, LinkThread, Collector]]:
    collector = Collector()
    config = BoardConfig(name="rig", port=url, **{"reconnect_s": 0.05, "stale_s": 0.3, **options})
    driver = BoardDriver(config, collector, HostClock())
    link = LinkThread([driver])
    link.start()
    try:
        yield driver, link, collector
    finally:
        link.stop()


def send_command(driver: BoardDriver, link: LinkThread, command: pb.Command) -> pb.CommandReply:
    replies: list[pb.CommandReply] = []
    link.command(driver, command.SerializeToString(), replies.append, anybody())
    return wait_for(lambda: replies[0] if replies else None, "reply")


def test_a_board_streams_after_the_handshake() -> None:
    with ScriptedBoard() as board, linked(board.url) as (driver, _, collector):
        wait_for(lambda: len(collector.samples) > 20, "samples")
        wait_for(lambda: collector.messages["parameters"], "parameters")

        assert driver.link == "streaming"
        assert collector.is_alive
        assert {"SET_STREAM", "SET_HOST_LOSS", "GET_PARAMETERS"} <= set(board.names())
        ticks = [s.tick for s in collector.samples]
        assert ticks == list(range(ticks[0], ticks[0] + len(ticks)))
        # the same numbers in SI units by the scalings of IDENTITY, which are singles on the wire
        assert collector.samples[0].x_m == pytest.approx(2 * 1.5e-6, rel=1e-6)
        parameters, limits = collector.messages["parameters"][0], driver.config.limits
        assert (parameters.gateway_x_ref_min_m, parameters.gateway_x_ref_max_m) == (
            limits.x_ref_min_m,
            limits.x_ref_max_m,
        )


def test_the_gateway_commands_neither_mode_nor_reference_by_itself() -> None:
    with ScriptedBoard() as board:
        with linked(board.url) as (_, _, collector):
            wait_for(lambda: len(collector.samples) > 20, "samples")
            wait_for(lambda: board.names().count("PING") > 3, "pings")

        assert not {"SET_MODE", "SET_REFERENCE", "SET_GAINS", "EXCITE", "STOP", "RESET"} & set(board.names())


def test_a_silent_board_is_called_silent_and_streams_again() -> None:
    with ScriptedBoard() as board, linked(board.url) as (driver, _, collector):
        wait_for(lambda: driver.link == "streaming", "stream")
        board.streaming = False
        board._answers = lambda _: b""

        wait_for(lambda: driver.link == "silent", "silence")
        assert not collector.is_alive
        board.streaming = True
        wait_for(lambda: driver.link == "streaming", "stream")

        assert collector.event("link-silent")


@pytest.mark.parametrize("from_the_start", [True, False])
def test_a_board_that_streams_and_answers_nothing_is_called_unanswered_until_it_answers(from_the_start: bool) -> None:
    """The line to the board is cut, or its receiver is dead: nothing but the missing answers shows it."""
    dead = from_the_start

    def answers(_: Message) -> bytes | None:
        return b"" if dead else None

    with ScriptedBoard(answers=answers) as board, linked(board.url) as (driver, link, collector):
        if not from_the_start:
            wait_for(lambda: driver.link == "streaming" and driver.to_board.state == "answering", "answers")
            dead = True

        event = wait_for(lambda: collector.event(TO_BOARD), "the event")
        stop = send_command(driver, link, pb.Command(id="s", stop=pb.Stop()))
        since, link_state = driver.report.unanswered, driver.link
        dead = False
        wait_for(lambda: driver.to_board.state == "answering", "an answer")

        assert (event.severity, "STOP" in event.text) == ("fault", True)
        assert (stop.refused_by, stop.reason) == ("link", "timed-out")
        assert since is not None
        assert link_state == ("handshake" if from_the_start else "streaming")
        assert collector.event("board-answers")
        assert driver.report.unanswered is None
        wait_for(lambda: driver.link == "streaming", "stream")


def test_a_board_that_answers_but_sends_no_state_is_not_streaming() -> None:
    with ScriptedBoard() as board, linked(board.url) as (driver, _, collector):
        wait_for(lambda: driver.link == "streaming", "stream")
        wait_for(lambda: collector.messages["parameters"], "parameters")
        board.streaming = False

        event = wait_for(lambda: collector.event("no-states"), "the event")
        before = board.names().count("PING")
        wait_for(lambda: board.names().count("PING") > before + 2, "more answers")
        link_state = (driver.link, driver.to_board.state)
        board.streaming = True
        wait_for(lambda: driver.link == "streaming", "stream")

        assert event.severity == "warning"
        assert link_state == ("silent", "answering")


@pytest.mark.slow
def test_an_answer_that_comes_too_late_for_its_command_shows_that_the_board_hears() -> None:
    """A pipe or a computer that holds answers up for longer than all repetitions last is no cut line."""
    held: list[bytes] = []

    def answers(message: Message) -> bytes | None:
        if message.name != "PING":
            return None
        held.append(frame("PONG", id=message.int("id"), tick=board.tick, bad_frames=0, overruns=0))
        return held.pop(0) if len(held) > 8 else b""

    options = {"command_timeout_s": 0.05, "command_retries": 1}
    with ScriptedBoard(answers=answers) as board, linked(board.url, **options) as (driver, _, collector):
        wait_for(lambda: driver.session.counters.stray_board_answers > 8, "late answers")
        events = [event for event in collector.messages["event"] if event.name == TO_BOARD]
        first = driver.to_board.state
        since = driver.session.counters.stray_board_answers
        wait_for(lambda: driver.session.counters.stray_board_answers > since + 40, "more of them")

        assert first == driver.to_board.state == "answering"
        assert [event for event in collector.messages["event"] if event.name == TO_BOARD] == events


def test_a_stream_that_is_switched_off_is_not_missed() -> None:
    def answers(message: Message) -> bytes | None:
        if message.name == "GET_PARAMETERS":
            return frame("PARAMETERS", id=message.int("id"), **{**parameters_values(), "divider": 0})
        return None

    with ScriptedBoard(answers=answers, streaming=False) as board, linked(board.url) as (driver, _, collector):
        wait_for(lambda: collector.messages["parameters"], "parameters")
        wait_for(lambda: board.names().count("PING") > 8, "a second of answers")

        assert (driver.link, driver.to_board.state) == ("streaming", "answering")
        assert not collector.event("no-states")


def test_bytes_without_frames_are_not_a_board() -> None:
    with ScriptedBoard(answers=lambda _: b"", streaming=False) as board, linked(board.url) as (_, _, collector):
        wait_for(lambda: board.received, "HELLO")
        board.send(b"$GPGGA,123519,4807.038,N*47\r\n" * 3)

        event = wait_for(lambda: collector.event("not-a-board"), "verdict")
        assert "baud" in event.text


def test_an_open_port_without_bytes_gets_a_hint() -> None:
    with ScriptedBoard(answers=lambda _: b"", streaming=False) as board, linked(board.url) as (_, _, collector):
        assert "powered" in wait_for(lambda: collector.event("no-answer"), "verdict").text


_IMPLAUSIBLE: tuple[tuple[dict[str, float], str], ...] = (
    ({"x_lsb": 0.0}, "x_lsb = 0 m"),
    ({"i_lsb": 3e38}, "i_lsb = 3e+38 A"),
    ({"u_lsb": -1e-45}, "u_lsb = -1.4013e-45 V"),
    ({"x_offset": 3e38}, "x_offset = 3e+38 m"),
    ({"u_offset": -2000.0}, "within 1000 V"),
    ({"sample_time": 65_535}, "65535 us"),
)


@pytest.mark.parametrize(
    ("answer", "options", "name", "text"),
    [
        (
            lambda m: frame("IDENTITY", id=m.int("id"), tick=0, **identity_values(version=2)),
            {},
            "version-mismatch",
            "2",
        ),
        (
            lambda m: frame("NACK", id=m.int("id"), command=1, reason=int(Reason.VERSION), detail=3),
            {},
            "version-mismatch",
            "3",
        ),
        (lambda m: None, {"board_id": 8}, "wrong-board", "7"),
        *(
            (
                lambda m, wrong=wrong: frame("IDENTITY", id=m.int("id"), tick=0, **{**identity_values(), **wrong}),
                {},
                "bad-identity",
                text,
            )
            for wrong, text in _IMPLAUSIBLE
        ),
    ],
    ids=["version", "version-nack", "board-id", *(next(iter(wrong)) for wrong, _ in _IMPLAUSIBLE)],
)
def test_a_board_that_cannot_be_served_is_left_alone(
    answer: Callable[[Message], bytes | None], options: dict[str, Any], name: str, text: str
) -> None:
    def answers(message: Message) -> bytes | None:
        return answer(message) if message.name == "HELLO" else None

    with ScriptedBoard(answers=answers) as board, linked(board.url, **options) as (driver, _, collector):
        event = wait_for(lambda: collector.event(name), name)

        assert text in event.text
        assert (driver.link, collector.samples) == ("handshake", [])
        assert set(board.names()) == {"HELLO"}


def test_the_reply_says_how_often_it_was_tried() -> None:
    tries: list[int] = []

    def answers(message: Message) -> bytes | None:
        if message.name != "SET_MODE":
            return None
        tries.append(message.int("id"))
        return b"" if len(tries) < 3 else None

    with ScriptedBoard(answers=answers) as board, linked(board.url, command_timeout_s=0.5) as (driver, link, _):
        wait_for(lambda: driver.link == "streaming", "stream")

        reply = send_command(driver, link, pb.Command(id="m", set_mode=pb.SetMode(mode=pb.MODE_OPEN_LOOP)))

    assert (reply.accepted, reply.attempts) == (True, 3)
    assert len(set(tries)) == 1


def test_a_command_that_is_never_answered_is_a_timeout_and_is_not_tried_again_for_the_same_id() -> None:
    def answers(message: Message) -> bytes | None:
        return b"" if message.name == "SET_MODE" else None

    options = {"command_timeout_s": 0.02, "command_retries": 1}
    with ScriptedBoard(answers=answers) as board, linked(board.url, **options) as (driver, link, collector):
        wait_for(lambda: driver.link == "streaming", "stream")
        command = pb.Command(id="m", who="me", set_mode=pb.SetMode(mode=pb.MODE_OPEN_LOOP))

        replies = [send_command(driver, link, command), send_command(driver, link, command)]

        assert [(r.refused_by, r.reason) for r in replies] == [("link", "timed-out")] * 2
        (record,) = collector.messages["command/record"]
        assert (record.command.who, record.reply.reason) == ("me", "timed-out")
        assert record.received_ns < record.answered_ns
        send_command(driver, link, pb.Command(id="p", ping=pb.Ping()))  # so the board has read what came before
        assert board.names().count("SET_MODE") == 2


def test_stop_overtakes_a_command_that_waits_for_its_answer() -> None:
    def answers(message: Message) -> bytes | None:
        return b"" if message.name == "SET_MODE" else None

    with ScriptedBoard(answers=answers) as board, linked(board.url, command_timeout_s=5.0) as (driver, link, _):
        wait_for(lambda: driver.link == "streaming", "stream")
        replies: list[pb.CommandReply] = []
        mode = pb.Command(id="m", set_mode=pb.SetMode(mode=pb.MODE_CLOSED_LOOP))
        link.command(driver, mode.SerializeToString(), replies.append, anybody())
        wait_for(lambda: "SET_MODE" in board.names(), "SET_MODE")

        stop = send_command(driver, link, pb.Command(id="s", stop=pb.Stop()))

        assert stop.accepted
        assert [r.reason for r in replies] == ["superseded-by-stop"]


def test_a_lost_port_answers_what_was_under_way() -> None:
    def answers(message: Message) -> bytes | None:
        return b"" if message.name == "SET_MODE" else None

    board = ScriptedBoard(answers=answers)
    with linked(board.url, command_timeout_s=5.0) as (driver, link, collector):
        replies: list[pb.CommandReply] = []
        with board:
            wait_for(lambda: driver.link == "streaming", "stream")
            mode = pb.Command(id="m", set_mode=pb.SetMode(mode=pb.MODE_OPEN_LOOP))
            link.command(driver, mode.SerializeToString(), replies.append, anybody())
            wait_for(lambda: "SET_MODE" in board.names(), "SET_MODE")

        wait_for(lambda: replies, "reply")
        assert replies[0].reason == "disconnected"
        reply = send_command(driver, link, pb.Command(id="n", ping=pb.Ping()))
        assert (reply.refused_by, reply.reason) == ("link", "link-down")
        assert collector.event("port-lost")


def test_a_restart_of_the_board_is_a_new_session() -> None:
    with ScriptedBoard() as board, linked(board.url) as (_, _, collector):
        wait_for(lambda: len(collector.samples) > 20, "samples")
        before = collector.samples[-1].session

        board.tick = 0
        board.send(frame("EVENT", number=0, tick=0, code=int(EventCode.RESET_WATCHDOG), detail=3))
        wait_for(lambda: collector.samples[-1].session != before, "new session")

        new = [s for s in collector.samples if s.session != before]
        assert new[0].lost_before == 0
        assert new[0].tick < 500
        event = collector.event("reset-watchdog")
        assert event is not None
        assert (event.severity, event.source) == ("fault", "board")


def test_noise_without_a_delimiter_is_one_bad_frame() -> None:
    with ScriptedBoard() as board, linked(board.url) as (driver, _, collector):
        wait_for(lambda: len(collector.samples) > 5, "samples")
        os.write(board.master, b"\x07" * 3000)  # 3 kB of nothing, and no delimiter

        wait_for(lambda: driver.session.counters.bad_frames["oversize"] == 1, "oversize frame")
        count = len(collector.samples)
        wait_for(lambda: len(collector.samples) > count + 5, "samples after the noise")


def test_a_step_of_the_wall_clock_is_seen_once_and_does_not_reach_the_session() -> None:
    now = {"wall": 1_700_000_000 * NS, "mono": 5 * NS}
    clock = HostClock(lambda: now["wall"], lambda: now["mono"])
    collector = Collector()
    driver = BoardDriver(BoardConfig(name="rig", port="x"), collector, clock)
    driver.port_opened("x", 5.0)
    driver.poll(5.0)
    hello = driver.output()
    number = _hello_id(hello)

    driver.received(frame("IDENTITY", id=number, tick=100, **identity_values()) + _state(100), 5 * NS)
    now["wall"] += 3600 * NS + NS
    now["mono"] += NS
    step = clock.step_ns()
    driver.received(_state(600), 6 * NS)

    assert step == 3600 * NS
    assert clock.step_ns() == 0
    first, second = collector.samples
    assert second.host_time_ns - first.host_time_ns == NS


def test_a_gateway_that_restarts_numbers_its_sessions_anew_wherever_its_clock_is() -> None:
    numbers = {BoardDriver(BoardConfig(name="rig", port="x"), Collector(), HostClock()).session.number for _ in "12345"}

    assert len(numbers) == 5


def test_samples_read_together_with_the_begin_of_their_session_have_its_time() -> None:
    """The clock has stepped since the session before."""
    now = {"wall": 1_700_000_000 * NS, "mono": 5 * NS}
    collector = Collector()
    clock = HostClock(lambda: now["wall"], lambda: now["mono"])
    driver = BoardDriver(BoardConfig(name="rig", port="x"), collector, clock)
    driver.port_opened("x", 5.0)
    driver.poll(5.0)
    now["wall"] -= 3600 * NS

    identity = frame("IDENTITY", id=_hello_id(driver.output()), tick=100, **identity_values())
    driver.received(identity + _state(100) + _state(101), 5 * NS)
    driver.received(_state(102), 6 * NS)

    assert [s.host_time_ns - now["wall"] for s in collector.samples] == [0, 0, NS]


def _state(tick: int) -> bytes:
    return frame("STATE", sequence=tick & 0xFFFF, i_c=1, x=2, u_c=3, x_ref=4, flags=0)


def _hello_id(data: bytes) -> int:
    (hello,) = StreamDecoder().feed(data)
    assert isinstance(hello, Message)
    assert hello.name == "HELLO"
    assert ROW_OF_NAME[hello.name].to_board
    return hello.int("id")
