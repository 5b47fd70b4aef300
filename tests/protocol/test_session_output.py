"""Tests of a session's output when the port is slow, stops, or swallows frames for later."""

from __future__ import annotations

from protocol.wire.events import Answer
from protocol.wire.exchange import MAX_STOPS, PROVEN_S, WAIT_S
from protocol.wire.framing import DELIMITER
from protocol.wire.messages import Message
from protocol.wire.session import Session
from tests.protocol.test_session import ack, answers, frame, identity, new_session, opened, sent


def pong(ping: Message) -> bytes:
    return frame("PONG", id=ping.int("id"), tick=10_001, bad_frames=0, overruns=0)


def names(session: Session) -> list[str]:
    return [message.name for message in sent(session)]


def take(session: Session, count: int) -> bytes:
    data = session.output()[:count]
    session.wrote(len(data))
    return data


def test_a_command_that_the_port_never_took_is_gone_when_it_is_given_up() -> None:
    session = opened()
    token = session.submit("SET_MODE", 0.0, mode=2)

    events = [event for n in range(1, 8) for event in session.poll(0.1 * n + 1e-6)]

    assert answers(events) == [Answer(token, "timed-out", 0)]
    assert session.output() == b""


def test_a_repetition_that_the_port_did_not_take_is_one_frame_not_five() -> None:
    session = opened()
    session.submit("SET_MODE", 0.0, mode=2)

    for n in range(1, 5):
        session.poll(0.1 * n + 1e-6)

    assert names(session) == ["SET_MODE"]


def test_a_frame_that_was_begun_is_not_finished_for_nobody() -> None:
    session = opened()
    token = session.submit("SET_MODE", 0.0, mode=2)
    begun = take(session, 4)

    events = [event for n in range(1, 8) for event in session.poll(0.1 * n + 1e-6)]
    session.submit("STOP", 1.0)

    assert answers(events) == [Answer(token, "timed-out", 1)]
    assert session.output().startswith(DELIMITER)  # what was begun ends as a bad frame, the next one is whole
    assert names(session) == ["STOP"]
    assert begun


def test_a_command_waits_for_its_turn_for_so_long_and_no_longer() -> None:
    session = opened(timeout_s=10.0)
    first = session.submit("PING", 0.0)
    brief = session.submit("SET_MODE", 0.0, 0.3, mode=2)
    patient = session.submit("SET_MODE", 0.0, mode=1)

    early = session.poll(0.31)
    (ping,) = sent(session)
    later = session.poll(WAIT_S)
    session.feed(pong(ping), WAIT_S)

    assert session.waiting == 0
    assert answers(early) == [Answer(brief, "timed-out", 0)]
    assert answers(later) == [Answer(patient, "timed-out", 0)]
    assert names(session) == []
    assert first


def test_the_end_of_the_waiting_is_a_deadline() -> None:
    session = opened(timeout_s=10.0)
    session.submit("PING", 0.0)
    session.submit("SET_MODE", 0.0, 0.3, mode=2)

    assert session.deadline_s == 0.3


def test_a_command_after_a_silence_is_preceded_by_a_question() -> None:
    session = opened()
    later = PROVEN_S + 0.1
    token = session.submit("SET_MODE", later, mode=2)

    (ping,) = sent(session)
    events = session.feed(pong(ping), later + 0.01)
    (set_mode,) = sent(session)
    events += session.feed(ack(set_mode), later + 0.02)

    assert (ping.name, set_mode.name) == ("PING", "SET_MODE")
    assert [(a.token, a.outcome) for a in answers(events)] == [(token, "ack")]


def test_a_command_that_was_given_up_takes_the_proof_with_it() -> None:
    session = opened(timeout_s=0.02, retries=0)
    session.submit("SET_MODE", 0.0, mode=2)
    assert names(session) == ["SET_MODE"]
    session.poll(0.03)

    session.submit("SET_REFERENCE", 0.04, x_ref=100)

    assert names(session) == ["PING"]


def test_while_nothing_is_answered_one_command_is_on_the_line_and_never_a_second() -> None:
    session = opened()
    first = session.submit("SET_MODE", 0.0, mode=2)
    out, ends = sent(session), []
    for n in range(1, 60):  # 6 s during which a pipe takes all and the board hears nothing
        second = session.submit("SET_REFERENCE", 0.1 * n, x_ref=100) if n == 6 else 0
        ends += answers(session.poll(0.1 * n + 1e-6))
        out += sent(session)
        assert second or n

    assert {message.name for message in out} == {"SET_MODE", "PING"}
    assert [(a.token == first, a.outcome, a.attempts) for a in ends] == [
        (True, "timed-out", 5),
        (False, "timed-out", 0),
    ]


def test_questions_do_not_wait_behind_a_command_that_is_held_back() -> None:
    session = opened()
    session.submit("SET_MODE", 1.0, mode=2)
    (probe,) = sent(session)
    session.submit("GET_PARAMETERS", 1.0)

    out: list[str] = []
    for n in range(1, 8):
        session.poll(1.0 + 0.1 * n + 1e-6)
        out += names(session)

    assert probe.name == "PING"  # it is given up, and the next question is somebody's own
    assert set(out) == {"PING", "GET_PARAMETERS"}


def test_stop_overtakes_what_the_port_has_not_taken() -> None:
    session = opened()
    session.submit("GET_PARAMETERS", 0.0)

    session.submit("STOP", 0.0)

    assert names(session) == ["STOP", "GET_PARAMETERS"]


def test_stop_ends_a_command_whose_frame_is_half_written() -> None:
    session = opened()
    moving = session.submit("SET_MODE", 0.0, mode=2)
    take(session, 3)

    session.submit("STOP", 0.0)

    assert [(a.token, a.why) for a in answers(session.take_outcomes())] == [(moving, "stop")]
    assert names(session) == ["STOP"]


def test_a_stop_that_was_given_up_still_goes_out_once() -> None:
    session = opened()
    tokens = [session.submit("STOP", 0.0) for _ in range(3)]

    events = [event for n in range(1, 8) for event in session.poll(0.1 * n + 1e-6)]

    assert answers(events) == [Answer(token, "timed-out", 0) for token in tokens]
    assert names(session) == ["STOP"]


def test_every_stop_has_its_own_frame_and_answer() -> None:
    session = opened()
    tokens = [session.submit("STOP", 0.0) for _ in range(5)]
    stops = sent(session)

    events = [event for n, stop in enumerate(stops) for event in session.feed(ack(stop, tick=100 + n), 0.01)]

    ticks = {a.token: a.message.int("tick") for a in answers(events) if a.message is not None}
    assert sorted(ticks) == sorted(tokens)
    assert sorted(ticks.values()) == [100, 101, 102, 103, 104]


def test_a_flood_of_stop_at_a_board_that_is_silent_ends_in_time_and_one_goes_out_last() -> None:
    session = opened()

    tokens = {session.submit("STOP", 0.0) for _ in range(1000)}
    out, events = sent(session), []
    for n in range(1, 15):
        events += session.poll(0.1 * n + 1e-6)
        out += sent(session)

    assert len(tokens) == MAX_STOPS + 1
    assert sorted(a.token for a in answers(events)) == sorted(tokens)
    assert len(out) == 5 * len(tokens)  # no more than the line carries


def test_what_is_asked_for_beyond_them_is_in_a_frame_of_its_own_that_goes_out_later() -> None:
    session = opened()
    first = [session.submit("STOP", 0.0) for _ in range(MAX_STOPS)]
    stops = sent(session)
    shared = {session.submit("STOP", 0.0) for _ in range(3)}
    assert names(session) == []

    session.feed(ack(stops[0], tick=100), 0.01)
    (last,) = sent(session)
    (answer,) = answers(session.feed(ack(last, tick=200), 0.02))

    assert len(shared) == 1
    assert answer.token in shared - set(first)
    assert answer.message is not None
    assert answer.message.int("tick") == 200


def test_a_new_connection_begins_with_a_whole_hello() -> None:
    session = opened()
    session.submit("SET_MODE", 0.0, mode=2)
    take(session, 3)

    session.disconnect()
    session.connect(1.0)
    session.poll(1.0)
    (hello,) = sent(session)

    assert hello.name == "HELLO"
    session.feed(identity(hello.int("id")), 1.0)
    assert session.is_open
    assert new_session().output() == b""
