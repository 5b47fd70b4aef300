"""Tests of a session's reports on a board, by field: samples, events, outcomes, counters, and the stream's rate."""

from __future__ import annotations

import math

import pytest

from protocol.wire.decoder import State
from protocol.wire.events import Answer, BoardEvent, Opened, Restarted, Sample
from protocol.wire.messages import EventCode, Message, Reason
from protocol.wire.session import Session
from tests.protocol.test_session import ack, answers, frame, identity, nack, new_session, opened, sent, state

PARAMETERS = {f"k{n}_{part}": 1 for n in range(1, 5) for part in ("mantissa", "shift")} | {
    "law": 0, "i_0": 1, "x_0": 2, "u_0": 3, "x_ref_min": 0, "x_ref_max": 4000, "x_ref_step": 100, "x_ref_slew": 100,
    "u_max": 4000, "policy": 0, "timeout": 1000, "tick": 10_001,
}  # fmt: skip


def event(number: int, *, tick: int = 10_001, code: EventCode = EventCode.LIMIT_HIT, detail: int = 0) -> bytes:
    return frame("EVENT", number=number, tick=tick, code=int(code), detail=detail)


def submit_command(session: Session, name: str, now_s: float, **values: int) -> tuple[int, Message]:
    token = session.submit(name, now_s, **values)
    (command,) = sent(session)
    return token, command


def test_a_sample_has_tick_session_losses_counts_and_time() -> None:
    session = opened(first_number=5)
    submit_command(session, "SET_STREAM", 0.0, divider=1)

    events = session.feed(state(10_000) + state(10_001), 0.1) + session.feed(state(10_004) + state(10_005), 0.2)

    assert events == [
        Sample(10_000, 5, 0, State(10_000, 1, 2, 3, 4, 0), 0.1),
        Sample(10_001, 5, 0, State(10_001, 1, 2, 3, 4, 0), 0.1),
        Sample(10_004, 5, 2, State(10_004, 1, 2, 3, 4, 0), 0.2),
        Sample(10_005, 5, 0, State(10_005, 1, 2, 3, 4, 0), 0.2),
    ]


def test_sessions_are_numbered_from_the_first_number_on() -> None:
    session = new_session()
    numbers = []
    for _ in range(2):
        session.connect(0.0)
        session.poll(0.0)
        (hello,) = sent(session)
        (opening,) = session.feed(identity(hello.int("id")), 0.0)
        assert isinstance(opening, Opened)
        assert opening.identity.values["board_id"] == 7
        numbers.append(opening.session)
        session.disconnect()

    assert numbers == [1, 2]


def test_frames_are_counted_over_all_reads_and_by_kind() -> None:
    session = new_session()
    session.connect(0.0)
    session.poll(0.0)
    session.feed(state(1) + state(2), 0.0)
    session.feed(state(3), 0.0)
    (hello,) = sent(session)
    session.feed(identity(hello.int("id")) + state(10_000), 0.0)
    session.feed(state(10_001) + event(1) + event(2), 0.0)
    session.feed(state(10_002) + state(10_003), 0.0)

    counters = session.counters
    assert session.states_ignored["no-session"] == counters.states_without_session == 3
    assert counters.states == 7
    assert counters.samples == 4
    assert counters.valid_frames == 10
    assert sum(counters.bad_frames.values()) == 0

    damaged = bytearray(state(10_004))
    damaged[3] ^= 0x10
    session.feed(bytes(damaged) + bytes(damaged), 0.0)
    assert sum(counters.bad_frames.values()) == 2
    assert counters.valid_frames == 10


def test_answers_to_nobody_are_counted_and_echoes_are_not_late() -> None:
    session = opened()

    session.feed(frame("STOP", id=9) * 2, 0.0)
    assert (session.counters.stray_answers, session.counters.stray_board_answers) == (2, 0)

    session.feed(frame("ACK", id=9, command=3, tick=0) * 2, 0.0)
    assert (session.counters.stray_answers, session.counters.stray_board_answers) == (4, 2)


def test_a_refusal_is_the_answer_with_the_board_s_words() -> None:
    session = opened()
    token, command = submit_command(session, "SET_MODE", 0.0, mode=2)

    (answer,) = answers(session.feed(nack(command, Reason.BUSY, 3), 0.01))

    assert answer == Answer(token, "nack", 1, answer.message)
    assert answer.message is not None
    assert answer.message.values["reason"] == Reason.BUSY
    assert answer.message.values["detail"] == 3


def test_every_session_that_the_board_forgot_is_a_reset() -> None:
    session = opened()
    for resets in (1, 2):
        _, command = submit_command(session, "SET_MODE", 0.0, mode=1)

        assert session.feed(nack(command, Reason.NO_SESSION), 0.0)[0] == Restarted("no-session", True)
        assert not session.is_open
        assert session.counters.board_resets == resets

        session.poll(0.0)
        (hello,) = sent(session)
        session.feed(identity(hello.int("id")), 0.0)
        assert session.is_open


def test_an_event_is_told_whole_and_lost_ones_add_up() -> None:
    session = opened()

    events = session.feed(event(1, tick=10_003, detail=6) + event(3) + event(6), 0.1)

    assert events[0] == BoardEvent(10_003, EventCode.LIMIT_HIT, 6, 0)
    assert [e.missed for e in events if isinstance(e, BoardEvent)] == [0, 1, 2]
    assert session.counters.events_lost == 3


@pytest.mark.parametrize(("old", "new"), [(2, 10), (10, 2)])
def test_the_rate_is_the_new_one_from_the_ack_on_and_the_slower_of_both_before(old: int, new: int) -> None:
    session = opened()
    assert session.unwrapper.divider is None
    _, command = submit_command(session, "SET_STREAM", 0.0, divider=old)
    assert session.unwrapper.divider is None
    session.feed(ack(command), 0.0)
    assert session.unwrapper.divider == old

    _, command = submit_command(session, "SET_STREAM", 0.0, divider=new)
    assert session.unwrapper.divider == 10
    session.feed(ack(command), 0.0)
    assert session.unwrapper.divider == new


def test_other_commands_leave_the_rate_as_it_is() -> None:
    session = opened()
    _, command = submit_command(session, "SET_STREAM", 0.0, divider=2)
    session.feed(ack(command), 0.0)

    _, command = submit_command(session, "SET_MODE", 0.0, mode=1)
    session.feed(ack(command), 0.0)

    assert session.unwrapper.divider == 2


@pytest.mark.parametrize(("waits", "divider"), [(False, 7), (True, 5)])
def test_the_board_s_parameters_tell_the_rate_unless_a_new_one_waits(waits: bool, divider: int) -> None:
    session = opened()
    _, first = submit_command(session, "SET_STREAM", 0.0, divider=3)
    session.feed(ack(first), 0.0)
    _, question = submit_command(session, "GET_PARAMETERS", 0.0)
    if waits:
        session.submit("SET_STREAM", 0.0, divider=5)

    session.feed(frame("PARAMETERS", id=question.int("id"), divider=7, **PARAMETERS), 0.0)

    assert [message.name for message in sent(session)] == ["SET_STREAM"] * waits
    assert session.unwrapper.divider == divider  # 5: the slower of 3 and 5


def test_a_block_of_a_capture_answers_the_question_for_its_index_only() -> None:
    session = opened()
    token, question = submit_command(session, "READ_CAPTURE", 0.0, index=32)

    def block(index: int) -> bytes:
        return frame("CAPTURE_BLOCK", id=question.int("id"), index=index, total=64, tick=1, samples=bytes(48))

    assert session.feed(block(0), 0.01) == []
    (answer,) = answers(session.feed(block(32), 0.02))
    assert (answer.token, answer.outcome) == (token, "ack")


def test_after_the_loss_of_the_port_nothing_is_due_and_nothing_goes_out() -> None:
    session = opened()
    token = session.submit("SET_MODE", 0.0, mode=1)

    assert session.disconnect() == [Answer(token, "cancelled", 0, None, "disconnected")]
    assert session.is_open is False
    assert session.deadline_s == math.inf
    assert session.output() == b""
    assert session.waiting == 0


def test_a_greeting_that_was_begun_is_not_finished_after_the_loss_of_the_port() -> None:
    session = new_session()
    assert session.is_open is False
    assert session.deadline_s == math.inf
    session.connect(0.0)
    session.poll(0.0)
    session.wrote(len(session.output()[:3]))

    session.disconnect()

    assert b"\0" not in session.output()[1:]  # at most the mark that ends what was begun
    session.poll(10.0)
    assert sent(session) == []


def test_ids_begin_where_the_session_says() -> None:
    """A board that kept answers to the ids of another host would answer with them, and act on nothing."""
    session = new_session()
    session.connect(0.0)
    session.poll(0.0)

    (hello,) = sent(session)

    assert hello.int("id") == 0x34 + 1


def test_a_greeting_refused_for_its_id_is_repeated_with_another_when_it_is_due() -> None:
    session = new_session(hello_s=0.25)
    session.connect(0.0)
    session.poll(0.0)
    (hello,) = sent(session)

    assert session.feed(nack(hello, Reason.BUSY), 0.01) == []
    session.poll(0.2)
    assert sent(session) == []
    session.poll(0.25)

    (again,) = sent(session)
    assert again.name == "HELLO"
    assert again.int("id") != hello.int("id")


def test_an_event_before_the_board_has_a_session_is_told() -> None:
    session = new_session()
    session.connect(0.0)

    assert session.feed(event(4), 0.0) == [BoardEvent(10_001, EventCode.LIMIT_HIT, 0, 0)]


def test_what_was_answered_is_not_repeated() -> None:
    session = new_session()
    session.connect(0.0)
    session.poll(0.0)
    (hello,) = sent(session)
    session.poll(0.25)  # repeats it, and the port has not taken it yet

    session.feed(identity(hello.int("id")), 0.26)
    assert session.output() == b""

    _, command = submit_command(session, "SET_MODE", 0.3, mode=1)
    session.poll(0.4)
    session.feed(ack(command), 0.41)
    assert session.output() == b""
