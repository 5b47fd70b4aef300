"""The conversation with one board, against a scripted board and a clock in the test's hand."""

from __future__ import annotations

import random
from typing import Any

import pytest

from protocol.wire.codec import encode_body
from protocol.wire.decoder import StreamDecoder
from protocol.wire.events import Answer, BoardEvent, Event, Opened, Restarted, Sample, VersionRefused
from protocol.wire.framing import encode_frame
from protocol.wire.messages import ROW_OF_NAME, EventCode, Message, Reason
from protocol.wire.session import Session
from tests.harness.protocol.port import take_output

SCALES = {"i_offset": 0.0, "i_lsb": 1e-3, "x_offset": 0.0, "x_lsb": 1e-6, "u_offset": 0.0, "u_lsb": 1e-3}


def frame(name: str, /, **values: Any) -> bytes:
    return encode_frame(encode_body(name, **values))


def identity(id: int, *, tick: int = 10_000, version: int = 1) -> bytes:
    return frame(
        "IDENTITY", id=id, version=version, firmware_major=1, firmware_minor=2, board_id=7, tick=tick, sample_time=2000,
        adc_bits=12, dac_bits=12, capture_time=40, capture_size=2000, reset_cause=1, build=b"test    ", **SCALES,
    )  # fmt: skip


def state(tick: int) -> bytes:
    return frame("STATE", sequence=tick & 0xFFFF, i_c=1, x=2, u_c=3, x_ref=4, flags=0)


def sent(session: Session) -> list[Message]:
    messages = StreamDecoder().feed(take_output(session))
    assert all(isinstance(m, Message) for m in messages)
    return [m for m in messages if isinstance(m, Message)]


def new_session(**options: Any) -> Session:
    return Session(choose_session=lambda: 0x1234, **options)


def opened(*, tick: int = 10_000, **options: Any) -> Session:
    session = new_session(**options)
    session.connect(0.0)
    session.poll(0.0)
    (hello,) = sent(session)
    (event,) = session.feed(identity(hello.int("id"), tick=tick), 0.0)
    assert isinstance(event, Opened)
    return session


def ack(command: Message, *, tick: int = 0) -> bytes:
    return frame("ACK", id=command.int("id"), command=ROW_OF_NAME[command.name].type, tick=tick)


def nack(command: Message, reason: Reason, detail: int = 0) -> bytes:
    return frame(
        "NACK", id=command.int("id"), command=ROW_OF_NAME[command.name].type, reason=int(reason), detail=detail
    )


def answers(events: list[Event]) -> list[Answer]:
    return [event for event in events if isinstance(event, Answer)]


def test_hello_is_repeated_until_the_board_answers() -> None:
    session = new_session(hello_s=0.25)
    session.connect(0.0)

    hellos: list[Message] = []
    for n in range(5):
        session.poll(n * 0.25)
        hellos += sent(session)

    assert [m.name for m in hellos] == ["HELLO"] * 5
    assert len({m.int("id") for m in hellos}) == 1
    assert not session.is_open


def test_states_before_the_identity_are_not_samples() -> None:
    session = new_session()
    session.connect(0.0)
    session.poll(0.0)
    (hello,) = sent(session)

    events = session.feed(state(9_999) + identity(hello.int("id")) + state(10_000) + state(10_001), 0.0)

    assert [type(e) for e in events] == [Opened, Sample, Sample]
    assert [e.tick for e in events if isinstance(e, Sample)] == [10_000, 10_001]


@pytest.mark.parametrize("reply", ["identity", "nack"])
def test_another_protocol_version_ends_the_handshake(reply: str) -> None:
    session = new_session()
    session.connect(0.0)
    session.poll(0.0)
    (hello,) = sent(session)

    data = identity(hello.int("id"), version=2) if reply == "identity" else nack(hello, Reason.VERSION, 2)
    events = session.feed(data, 0.0)

    assert events == [VersionRefused(2)]
    session.poll(10.0)
    assert sent(session) == []


def test_one_command_is_outstanding_and_the_others_follow_in_order() -> None:
    session = opened()
    first = session.submit("PING", 0.0)
    second = session.submit("SET_MODE", 0.0, mode=1)
    (ping,) = sent(session)

    events = session.feed(frame("PONG", id=ping.int("id"), tick=10_001, bad_frames=0, overruns=0), 0.01)
    (set_mode,) = sent(session)
    events += session.feed(ack(set_mode, tick=10_002), 0.02)

    assert [(a.token, a.outcome) for a in answers(events)] == [(first, "ack"), (second, "ack")]


def test_a_command_is_repeated_with_its_id_and_given_up_after_a_bound() -> None:
    session = opened(timeout_s=0.1, retries=4)
    token = session.submit("SET_MODE", 0.0, mode=2)

    events: list[Event] = []
    tries = sent(session)
    for n in range(1, 8):
        events += session.poll(0.1 * n + 1e-6)
        tries += sent(session)

    assert len(tries) == 5
    assert len({m.int("id") for m in tries}) == 1
    assert answers(events) == [Answer(token, "timed-out", 5)]
    assert session.deadline_s == float("inf")


def test_an_answer_to_the_second_try_counts_once() -> None:
    session = opened()
    session.submit("SET_MODE", 0.0, mode=2)
    (first,) = sent(session)
    session.poll(0.11)
    (second,) = sent(session)

    events = session.feed(ack(first) + ack(second), 0.12)

    assert [a.attempts for a in answers(events)] == [2]
    assert session.counters.stray_answers == 1


def test_an_ack_for_another_command_type_is_not_an_answer() -> None:
    session = opened()
    session.submit("SET_MODE", 0.0, mode=2)
    (command,) = sent(session)

    events = session.feed(frame("ACK", id=command.int("id"), command=ROW_OF_NAME["SET_GAINS"].type, tick=1), 0.01)

    assert answers(events) == []


def test_stop_goes_out_at_once_and_cancels_what_could_move_the_ball() -> None:
    session = opened()
    moving = session.submit("SET_MODE", 0.0, mode=2)
    waiting = session.submit("SET_REFERENCE", 0.0, x_ref=100)
    harmless = session.submit("GET_PARAMETERS", 0.0)
    sent(session)

    stop = session.submit("STOP", 0.001)
    cancelled = answers(session.take_outcomes())
    out = sent(session)
    events = session.feed(ack(out[0]), 0.01)
    session.poll(5.0)

    assert out[0].name == "STOP"
    assert [(a.token, a.why) for a in cancelled] == [(moving, "stop"), (waiting, "stop")]
    assert [a.token for a in answers(events)] == [stop]
    assert {m.name for m in sent(session)} | {m.name for m in out} == {"STOP", "GET_PARAMETERS"}
    assert harmless not in [a.token for a in cancelled]


def test_stop_needs_no_session() -> None:
    session = new_session()
    session.connect(0.0)

    session.submit("STOP", 0.0)

    assert "STOP" in [m.name for m in sent(session)]


def test_a_reset_event_cancels_commands_and_makes_the_handshake_again() -> None:
    session = opened()
    token = session.submit("SET_MODE", 0.0, mode=2)
    sent(session)
    number = session.number
    reset = frame("EVENT", number=0, tick=0, code=int(EventCode.RESET_WATCHDOG), detail=1)

    events = session.feed(state(10_999) + state(11_000) + reset + state(0) + state(1), 2.0)
    session.poll(2.0)
    hello = sent(session)[-1]
    events += session.feed(identity(hello.int("id"), tick=2) + state(2) + state(3), 2.01)

    names = [type(e).__name__ for e in events]
    assert names == ["Sample", "Sample", "BoardEvent", "Restarted", "Answer", "Opened", "Sample", "Sample"]
    assert Answer(token, "cancelled", 1, None, "board-reset") in answers(events)
    assert session.number == number + 1
    assert session.counters.board_resets == 1


def test_a_reset_is_one_reset_when_its_event_follows_the_identity() -> None:
    session = opened()
    session.feed(state(10_000) + state(10_001), 0.0)

    events = session.feed(state(0) + state(1), 0.1)
    session.poll(0.1)
    (hello,) = sent(session)
    events += session.feed(identity(hello.int("id"), tick=3), 0.11)
    events += session.feed(frame("EVENT", number=0, tick=0, code=int(EventCode.RESET_WATCHDOG), detail=1), 0.12)

    assert [type(e) for e in events] == [Restarted, Opened, BoardEvent]
    assert session.counters.board_resets == 1
    assert session.is_open


def test_a_board_that_forgot_the_session_is_greeted_again() -> None:
    session = opened()
    session.submit("SET_MODE", 0.0, mode=1)
    (command,) = sent(session)

    events = session.feed(nack(command, Reason.NO_SESSION), 0.01)
    session.poll(0.01)

    assert [type(e) for e in events] == [Restarted, Answer]
    assert [m.name for m in sent(session)] == ["HELLO"]


def test_every_submitted_command_is_answered_when_the_port_goes() -> None:
    session = opened()
    tokens = [session.submit("PING", 0.0), session.submit("SET_MODE", 0.0, mode=1), session.submit("STOP", 0.0)]

    events = session.take_outcomes() + session.disconnect()

    assert sorted(a.token for a in answers(events)) == sorted(tokens)


def test_the_old_tick_in_the_answer_to_a_repeated_ping_is_not_a_reset() -> None:
    session = opened(timeout_s=1.0)
    session.submit("PING", 0.0)
    (ping,) = sent(session)
    session.poll(1.01)
    sent(session)
    states = b"".join(state(10_000 + n) for n in range(600))

    events = session.feed(states + frame("PONG", id=ping.int("id"), tick=10_001, bad_frames=0, overruns=0), 1.2)

    assert [type(e) for e in events[600:]] == [Answer]
    assert session.is_open


def pong(command: Message, tick: int) -> bytes:
    return frame("PONG", id=command.int("id"), tick=tick, bad_frames=0, overruns=0)


def test_a_ping_that_finds_the_tick_behind_asks_again_and_then_it_is_a_reset() -> None:
    session = opened()
    session.feed(b"".join(state(10_000 + n) for n in range(600)), 1.2)
    session.submit("PING", 1.2)
    (ping,) = sent(session)

    first = session.feed(pong(ping, 40), 1.21)
    (again,) = sent(session)
    second = session.feed(pong(again, 43), 1.22)

    assert [type(e) for e in first] == [Answer]
    assert [e for e in second if isinstance(e, Restarted)] == [Restarted("tick", True, (10_000, 10_599))]
    assert session.counters.board_resets == 1


def test_one_wrong_pong_moves_nothing() -> None:
    session = opened()
    session.feed(b"".join(state(10_000 + n) for n in range(600)), 1.2)
    session.submit("PING", 1.2)
    (ping,) = sent(session)

    session.feed(pong(ping, 10_600 + (1 << 30)), 1.2)
    events = session.feed(b"".join(state(10_600 + n) for n in range(5)), 1.21)
    (again,) = sent(session)
    session.feed(pong(again, 10_605), 1.21)
    events += session.feed(b"".join(state(10_605 + n) for n in range(5)), 1.22)

    assert [e.tick for e in events if isinstance(e, Sample)] == list(range(10_600, 10_610))
    assert session.unwrapper.lost == 0
    assert sent(session) == []


def test_a_reset_event_alone_ends_nothing() -> None:
    session = opened()
    session.feed(b"".join(state(10_000 + n) for n in range(600)), 1.2)

    events = session.feed(frame("EVENT", number=0, tick=0, code=int(EventCode.RESET_WATCHDOG), detail=1), 1.2)
    (ping,) = sent(session)
    events += session.feed(state(10_600) + pong(ping, 10_601), 1.21)

    assert ping.name == "PING"
    assert [type(e) for e in events] == [BoardEvent, Sample, Answer]
    assert session.is_open


def test_lost_and_doubled_events_are_seen() -> None:
    session = opened()
    first = frame("EVENT", number=4, tick=10_001, code=int(EventCode.LIMIT_HIT), detail=0)
    later = frame("EVENT", number=7, tick=10_009, code=int(EventCode.LIMIT_HIT), detail=0)

    events = session.feed(first + first + later, 2.0)

    assert [e.missed for e in events if isinstance(e, BoardEvent)] == [0, 2]
    assert session.counters.events_lost == 2


def test_a_value_out_of_range_is_refused_before_it_gets_a_place_in_the_queue() -> None:
    session = opened()

    with pytest.raises(ValueError, match="mode"):
        session.submit("SET_MODE", 0.0, mode=3)

    assert session.waiting == 0


def test_no_bytes_make_it_raise() -> None:
    rng = random.Random(11)
    session = opened()
    session.submit("PING", 0.0)
    good = [state(10_000 + n) for n in range(50)] + [identity(3), frame("PONG", id=9, tick=5, bad_frames=0, overruns=0)]

    for n in range(3000):
        data = bytearray(rng.choice(good))
        for _ in range(rng.randrange(3)):
            data[rng.randrange(len(data))] = rng.randrange(256)
        session.feed(bytes(data) + rng.randbytes(rng.randrange(6)), n * 0.002)
        session.poll(n * 0.002)

    assert sum(session.counters.bad_frames.values()) > 1000


def test_ids_stay_within_a_byte_and_skip_zero() -> None:
    session = opened()
    ids = set()

    for n in range(600):
        session.submit("PING", 0.0)
        (ping,) = sent(session)
        ids.add(ping.int("id"))
        session.feed(frame("PONG", id=ping.int("id"), tick=10_000 + n, bad_frames=0, overruns=0), 0.0)

    assert ids == set(range(1, 256))
