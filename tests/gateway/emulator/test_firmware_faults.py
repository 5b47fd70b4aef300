"""'Behaviour of the board' in protocol/README.md, rules 10, 11 and 13: a silent host, faults of the sensors, STOP."""

from __future__ import annotations

import pytest

from gateway.emulator.firmware_model.flash import INPUT
from protocol.wire.decoder import StreamDecoder
from protocol.wire.framing import encode_frame
from protocol.wire.messages import EventCode, Flag, HostLoss, Message, Mode
from tests.harness.gateway.board_host import QUIET, Bench, Host, frame, open_loop
from tests.harness.protocol.port import take_output

pytestmark = pytest.mark.usefixtures("each_firmware")


# Rule 10


@pytest.mark.parametrize(
    ("policy", "mode", "expected"),
    [
        (HostLoss.KEEP, 2, 2),
        (HostLoss.KEEP, 1, 1),
        (HostLoss.COIL_OFF, 2, 0),
        (HostLoss.HOLD, 2, 2),
        (HostLoss.HOLD, 1, 0),
    ],
)
def test_rule_10_the_policy_acts_once_when_the_host_is_silent(policy: HostLoss, mode: int, expected: int) -> None:
    host = Host()
    host.request("SET_MODE", mode=mode)
    host.request("EXCITE", shape=2, target=mode - 1, offset=1000, **(QUIET | {"amplitude": 50, "period": 4}))
    host.request("SET_HOST_LOSS", policy=policy, timeout=100)

    before = host.run(48, alive=False)  # and the tick of the command itself: 98 ms
    after = host.run(60, alive=False)
    host.firmware.feed(frame("PING", id=250))
    back = host.run(1, alive=False)[0]

    assert not any(state.flags & Flag.HOST_LOST for state in before)
    assert all(state.flags & Flag.HOST_LOST for state in after[1:])
    assert after[-1].flags & 3 == expected
    assert not back.flags & Flag.HOST_LOST
    assert back.flags & 3 == expected
    assert host.details(EventCode.HOST_LOST) == [policy]
    assert host.codes().count(EventCode.HOST_BACK) == 1
    if policy is HostLoss.HOLD and mode == 2:
        assert {state.x_ref for state in after[2:]} == {1000}
    if policy is HostLoss.KEEP and mode == 2:
        assert {state.x_ref for state in after[2:]} == {950, 1050}
    if expected == 0:
        assert after[-1].u_c == 0


def test_rule_10_noise_does_not_keep_the_host_alive() -> None:
    host = Host()
    host.request("SET_HOST_LOSS", policy=1, timeout=50)

    for _ in range(40):
        host.firmware.feed(b"\x00garbage\x00" + frame("PING", id=3)[:-2] + b"\x00")
        host.run(1, alive=False)

    assert EventCode.HOST_LOST in host.codes()


def test_rule_10_the_timer_runs_without_a_host_and_any_frame_with_an_id_restarts_it() -> None:
    silent = Host(session=False)
    silent.run(249, alive=False)
    before = silent.codes()
    silent.run(1, alive=False)
    talked_to = Host()
    for _ in range(600):
        talked_to.firmware.feed(encode_frame(b"\x3f\x09"))  # a type that nobody knows
        talked_to.run(1, alive=False)

    assert EventCode.HOST_LOST not in before
    assert EventCode.HOST_LOST in silent.codes()
    assert EventCode.HOST_LOST not in talked_to.codes()


# Rule 11


def test_rule_11_current_at_the_top_for_50_ticks_is_a_fault() -> None:
    bench = Bench()
    host = open_loop(1000, bench)

    bench.i_a = 2.5
    host.run(49)
    before = host.states[-1]
    host.run(1)

    assert before.flags & Flag.CURRENT_RANGE
    assert not before.flags & Flag.FAULT
    assert (host.states[-1].u_c, host.states[-1].flags & 3) == (0, Mode.IDLE)
    assert host.states[-1].flags & Flag.FAULT
    assert host.details(EventCode.OVER_CURRENT) == [4095]


def test_rule_11_a_current_that_leaves_the_top_in_between_is_not() -> None:
    bench = Bench()
    host = Host(bench)

    for _ in range(4):
        bench.i_a = 2.5
        host.run(49)
        bench.i_a = 0.0
        host.run(1)

    assert EventCode.OVER_CURRENT not in host.codes()


@pytest.mark.parametrize(("x_m", "count"), [(-1.0, 0), (1.0, 4095)])
def test_rule_11_a_position_at_an_end_for_500_ticks_of_closed_loop_is_a_fault(x_m: float, count: int) -> None:
    bench = Bench(x_m=x_m)
    host = Host(bench)
    host.run(600)
    open_before = EventCode.SENSOR_FAULT in host.codes()

    host.request("SET_MODE", mode=2)
    host.run(498)
    before = host.states[-1].flags
    host.run(1)

    assert not open_before
    assert before & 0xCB == Flag.POSITION_RANGE | Mode.CLOSED_LOOP
    assert host.states[-1].flags & 3 == Mode.IDLE
    assert host.details(EventCode.SENSOR_FAULT) == [count]


def test_rule_11_a_current_still_at_the_top_is_a_fault_again_at_the_tick_after_set_mode() -> None:
    bench = Bench(i_a=5.0)
    host = Host(bench)
    host.run(60)

    host.request("SET_MODE", mode=1)

    assert host.codes().count(EventCode.OVER_CURRENT) == 2
    assert host.states[-1].flags & (Flag.FAULT | 3) == Flag.FAULT


def test_rule_11_a_closed_loop_that_was_left_and_entered_between_two_ticks_counts_anew() -> None:
    bench = Bench(x_m=-1.0)
    host = Host(bench)
    host.request("SET_MODE", mode=2)
    host.run(498)

    host.firmware.feed(frame("SET_MODE", id=201, mode=0))
    host.firmware.feed(frame("SET_MODE", id=202, mode=2))
    host.run(500)
    before = EventCode.SENSOR_FAULT in host.codes()
    host.run(1)

    assert not before
    assert host.codes()[-2:] == [EventCode.SENSOR_FAULT, EventCode.MODE_CHANGED]


# Rule 13


def test_rule_13_stop_turns_the_coil_off_between_two_ticks() -> None:
    bench = Bench()
    host = open_loop(1000, bench)
    bench.inputs.clear()

    host.firmware.feed(frame("STOP", id=99), into_tick_us=610)
    state = host.run(1)[0]

    assert bench.inputs == [(INPUT.to_si(1000), 600), (0.0, 1400)]  # the plant's time has steps of 20 us
    assert (state.u_c, state.flags) == (0, Mode.IDLE)
    assert host.answers[-1].int("tick") == state.sequence


def test_rule_13_a_command_that_came_before_stop_does_not_turn_the_coil_on_again() -> None:
    host = Host()

    host.firmware.feed(frame("SET_MODE", id=90, mode=2) + frame("STOP", id=91))
    states = host.run(3)

    assert {(state.u_c, state.flags) for state in states} == {(0, Mode.IDLE)}
    assert [(answer.name, answer.int("command")) for answer in host.answers[-2:]] == [("ACK", 0x07), ("NACK", 0x03)]


def test_rule_13_a_capture_that_came_before_stop_does_not_begin() -> None:
    bench = Bench()
    host = Host(bench)
    bench.inputs.clear()

    host.firmware.feed(frame("CAPTURE", id=90, u_from=900, u_to=900, pre=0, count=5), into_tick_us=200)
    host.firmware.feed(frame("STOP", id=91), into_tick_us=1000)
    host.run(20)

    assert {u for u, _ in bench.inputs} == {0.0}
    assert EventCode.CAPTURE_DONE not in host.codes()


def test_rule_13_stop_ends_a_capture_and_leaves_the_stream() -> None:
    host = Host()
    host.request("SET_STREAM", divider=3)
    host.request("CAPTURE", u_from=100, u_to=200, pre=50, count=2000)

    host.request("STOP")
    states = host.run(9)

    assert len(states) == 3
    assert {state.u_c for state in states} == {0}
    assert EventCode.CAPTURE_DONE not in host.codes()


def test_rule_13_the_ack_of_a_stop_carries_the_tick_that_comes_next() -> None:
    host = Host()
    host.request("SET_MODE", mode=1)
    last_sequence = host.run(3)[-1].sequence

    host.firmware.feed(frame("STOP", id=77), into_tick_us=700)
    answered = StreamDecoder().feed(take_output(host.firmware))
    off = host.firmware.u
    state = host.run(1)[0]

    (ack, changed) = [event for event in answered if isinstance(event, Message)]
    assert (ack.name, ack.int("tick"), changed.int("tick")) == ("ACK", last_sequence + 1, last_sequence + 1)
    assert off == 0
    assert (state.sequence, state.flags) == (last_sequence + 1, Mode.IDLE)


def test_rule_13_a_stop_leaves_a_fault() -> None:
    bench = Bench(i_a=5.0)
    host = Host(bench)
    host.run(60)
    bench.i_a = 0.0

    host.request("STOP")

    assert host.states[-1].flags == Flag.FAULT | Mode.IDLE


def test_rule_13_a_stop_is_executed_whatever_its_id() -> None:
    host = Host()
    host.send(frame("STOP", id=5))
    host.request("SET_MODE", mode=1)

    again = host.send(frame("STOP", id=5))

    assert again.name == "ACK"
    assert host.states[-1].flags == Mode.IDLE
