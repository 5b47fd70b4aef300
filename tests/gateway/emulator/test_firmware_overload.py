"""Tests of more commands than a tick's budget, or than the line has room to answer: rules 1, 4, 5 and 13."""

from __future__ import annotations

from collections import Counter

import pytest

from protocol.wire.decoder import BadFrame, State, StreamDecoder
from protocol.wire.messages import EventCode, Message, Mode, Reason
from tests.harness.gateway.board_host import Bench, Host, frame, refusal
from tests.harness.protocol.port import take_output

pytestmark = pytest.mark.usefixtures("each_firmware")


def overloaded(bench: Bench | None = None) -> Host:
    """A board in open loop whose answers and commands are all waiting, as its line takes nothing."""
    host = Host(bench)
    host.request("SET_MODE", mode=1)
    host.request("EXCITE", shape=0, target=0, offset=900, amplitude=0, period=1, period_end=1, seed=1, duration=0)
    for n in range(8):
        host.firmware.feed(frame("PING", id=100 + n))
        host.firmware.tick()
    return host


def test_each_frame_of_a_flood_is_answered_or_counted() -> None:
    """The line has room for a STATE and, in every second tick, for one more frame."""
    host, decoder, got = Host(), StreamDecoder(), []
    before, sent = host.firmware.bad_frames, 0
    for tick in range(600):
        for _ in range(4):
            sent += 1
            host.firmware.feed(frame("PING", id=1 + sent % 255))
        host.firmware.tick()
        for _ in range(1 + tick % 2):
            got += decoder.feed(host.firmware.take_frame())
    for _ in range(20):
        host.firmware.tick()
        got += decoder.feed(take_output(host.firmware))

    names = Counter(event.name for event in got if isinstance(event, Message))
    codes = [EventCode(event.int("code")) for event in got if isinstance(event, Message) and event.name == "EVENT"]
    assert names["PONG"] + names["NACK"] + host.firmware.bad_frames - before == sent
    assert names["PONG"] > 250
    assert len([event for event in got if isinstance(event, State)]) == 620
    assert not [event for event in got if isinstance(event, BadFrame)]
    assert codes.count(EventCode.OVERLOAD) == 2  # one in a second
    assert host.firmware.dropped == 0


def test_a_stop_acts_though_nothing_has_room() -> None:
    bench = Bench()
    host = overloaded(bench)
    for n in range(8):
        host.firmware.feed(frame("SET_MODE", id=120 + n, mode=2))
    host.firmware.feed(frame("SET_MODE", id=130, mode=2))
    full = host.firmware.bad_frames
    host.firmware.feed(frame("STOP", id=131), into_tick_us=500)
    at_once = host.firmware.u
    states = host.run(20)[-20:]  # before them came what the queue had

    assert full == 1
    assert host.firmware.bad_frames == 2  # its ACK has no room, and that is counted, too
    assert at_once == 0
    assert {(s.u_c, s.flags & 3) for s in states} == {(0, Mode.IDLE)}
    assert [refusal(answer) for answer in host.answers[-8:]] == [(Reason.BUSY, 0)] * 8  # revoked


@pytest.mark.parametrize(("name", "fields"), [("SET_MODE", {"mode": 2}), ("CAPTURE", {"u_from": 900, "u_to": 0})])
def test_what_a_stop_has_overtaken_is_refused_for_good(name: str, fields: dict[str, int]) -> None:
    host = Host()
    extra = {"pre": 0, "count": 5} if name == "CAPTURE" else {}
    overtaken = frame(name, id=90, **fields, **extra)

    host.firmware.feed(frame("PING", id=89) + overtaken + frame("STOP", id=91))
    states = host.run(3)
    repeated = host.send(overtaken)

    assert {(state.u_c, state.flags) for state in states} == {(0, Mode.IDLE)}
    assert refusal(repeated) == (Reason.BUSY, 0)
    assert {answer.name for answer in host.answers if answer.int("id") == 91} == {"ACK"}


def test_a_reset_does_not_wait_for_what_a_host_goes_on_asking() -> None:
    """Each tick the line takes a STATE and an answer, and the host asks for two more."""
    host = Host()
    host.firmware.feed(frame("RESET", id=50))
    ticks = 0
    while host.firmware.next_tick and ticks < 30:
        ticks += 1
        for n in range(2):
            host.firmware.feed(frame("GET_PARAMETERS", id=60 + 2 * ticks + n))
            host.firmware.feed(frame("STOP", id=160 + 2 * ticks + n))
        host.firmware.tick()
        for _ in range(2):
            host.firmware.take_frame()

    assert ticks <= 2
