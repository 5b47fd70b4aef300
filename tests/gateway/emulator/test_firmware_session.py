"""'Behaviour of the board' in protocol/README.md, rules 1 to 3: reset, session, ids.

More of rule 3 is in test_firmware_once.py.
"""

from __future__ import annotations

import pytest

from gateway.emulator.firmware_model.flash import BOOT_TICKS, GAINS, INPUT, LIMITS, POSITION, WATCHDOG_TICKS
from protocol.wire.decoder import State, StreamDecoder
from protocol.wire.framing import encode_frame
from protocol.wire.messages import EventCode, HostLoss, Message, Mode, Reason
from tests.harness.gateway.board_host import Bench, Host, frame, open_loop, refusal
from tests.harness.protocol.port import take_output

pytestmark = pytest.mark.usefixtures("each_firmware")


# Rule 1


def test_rule_1_a_board_boots_idle_with_defaults_from_flash() -> None:
    host = Host(session=False)

    first, *_ = host.run(3)
    host.hello(5)
    parameters = host.request("GET_PARAMETERS")

    assert first == State(0, 0, POSITION.to_count(2.85e-3), 0, GAINS.x_0, Mode.IDLE)
    assert [state.sequence for state in host.states[:3]] == [0, 1, 2]
    assert host.codes() == [EventCode.RESET_POWER_ON]
    assert parameters.values["divider"] == 1
    assert (parameters.values["policy"], parameters.values["timeout"]) == (HostLoss.COIL_OFF, 500)
    assert (parameters.values["i_0"], parameters.values["x_0"], parameters.values["u_0"]) == (
        GAINS.i_0,
        GAINS.x_0,
        GAINS.u_0,
    )
    assert parameters.values["k4_mantissa"] == GAINS.mantissas[3]
    assert parameters.values["tick"] == 0


def test_rule_1_reset_is_acknowledged_first_and_forgets_everything() -> None:
    host = open_loop(1000)
    host.request("SET_STREAM", divider=2)

    answer = host.request("RESET")
    host.run(BOOT_TICKS + 3, alive=False)

    assert answer.name == "ACK"
    assert host.events[-1].int("code") == EventCode.RESET_COMMANDED
    assert host.events[-1].int("detail") == 1
    assert [state.sequence for state in host.states[-2:]] == [0, 1]
    assert host.states[-1].u_c == 0
    assert refusal(host.request("SET_STREAM", divider=1)) == (Reason.NO_SESSION, 0)


def test_rule_1_a_hanging_firmware_holds_its_output_until_the_watchdog_resets_it() -> None:
    bench = Bench()
    host = open_loop(1000, bench)
    host.run(1)

    host.firmware.hang()
    bench.inputs.clear()
    silent = host.run(WATCHDOG_TICKS, alive=False)
    held = {u for u, _ in bench.inputs}
    host.run(BOOT_TICKS + 1, alive=False)

    assert silent == []
    assert held == {INPUT.to_si(1000)}
    assert host.details(EventCode.RESET_WATCHDOG) == [1]
    assert host.states[-1].sequence == 0
    assert bench.inputs[-1][0] == 0.0


def test_rule_1_state_goes_out_where_the_divider_divides_the_tick_whenever_it_was_set() -> None:
    host = Host()
    host.run(3)

    answer = host.request("SET_STREAM", divider=7)
    host.run(40)
    back = host.request("SET_STREAM", divider=1)

    since = [state.sequence for state in host.states if state.sequence >= answer.int("tick")]
    assert answer.int("tick") % 7
    assert since == [tick for tick in range(answer.int("tick"), back.int("tick")) if tick % 7 == 0] + [back.int("tick")]


def test_rule_1_the_phase_of_the_stream_counts_from_0_again_where_the_tick_wraps() -> None:
    host = Host()
    host.request("SET_STREAM", divider=10)
    host.firmware.next_tick = 2**32 - 20

    states = host.run(40)

    assert [state.sequence for state in states] == [65520, 65530, 0, 10]


def test_rule_1_the_allowance_is_full_after_a_reset() -> None:
    host = Host()
    host.request("SET_REFERENCE", x_ref=LIMITS.x_ref_max)
    host.request("RESET")
    host.run(BOOT_TICKS + 1, alive=False)
    host.hello(2)

    too_far = host.request("SET_REFERENCE", x_ref=GAINS.x_0 - LIMITS.x_ref_step - 1)
    whole = host.request("SET_REFERENCE", x_ref=GAINS.x_0 - LIMITS.x_ref_step)

    assert refusal(too_far) == (Reason.SLEW, LIMITS.x_ref_step)
    assert whole.name == "ACK"


# Rule 2


def test_rule_2_without_a_session_only_hello_ping_and_stop_are_heard() -> None:
    host = Host(session=False)

    refused = [
        host.request("SET_MODE", mode=2),
        host.request("SET_REFERENCE", x_ref=GAINS.x_0),
        host.request("GET_PARAMETERS"),
        host.request("RESET"),
        host.request("READ_CAPTURE", index=0),
    ]
    stopped = host.request("STOP")
    host.firmware.feed(frame("PING", id=77))
    host.firmware.tick()
    pong = StreamDecoder().feed(take_output(host.firmware))[1]

    assert {refusal(answer) for answer in refused} == {(Reason.NO_SESSION, 0)}
    assert stopped.name == "ACK"
    assert isinstance(pong, Message)
    assert (pong.name, pong.int("id"), pong.int("tick")) == ("PONG", 77, host.firmware.next_tick - 1)


def test_rule_2_hello_changes_neither_mode_nor_reference() -> None:
    host = Host()
    host.request("SET_MODE", mode=2)
    host.request("SET_REFERENCE", x_ref=GAINS.x_0 + 100)

    host.hello(99)
    state = host.run(1)[0]

    assert state.flags & 3 == Mode.CLOSED_LOOP
    assert state.x_ref == GAINS.x_0 + 100


def test_rule_2_the_same_session_keeps_the_ids_and_a_new_one_forgets_them() -> None:
    host = Host()
    first = host.send(frame("SET_STREAM", id=50, divider=1))

    host.hello(1)
    again = host.send(frame("SET_STREAM", id=50, divider=1))
    host.hello(2)
    anew = host.send(frame("SET_STREAM", id=50, divider=1))

    assert again == first
    assert anew.int("tick") > first.int("tick")


@pytest.mark.parametrize(("low", "high", "served"), [(1, 1, True), (0, 3, True), (2, 3, False), (0, 0, False)])
def test_rule_2_the_board_speaks_version_1(low: int, high: int, served: bool) -> None:
    host = Host(session=False)

    answer = host.hello(1, version_min=low, version_max=high)

    if served:
        assert (answer.name, answer.int("version")) == ("IDENTITY", 1)
    else:
        assert refusal(answer) == (Reason.VERSION, 1)
        assert refusal(host.request("GET_PARAMETERS")) == (Reason.NO_SESSION, 0)


# Rule 3


def test_rule_3_a_repeated_command_is_answered_with_the_kept_answer() -> None:
    host = Host()
    step = frame("SET_REFERENCE", id=40, x_ref=GAINS.x_0 + 1000)

    first = host.send(step)
    host.request("SET_REFERENCE", x_ref=GAINS.x_0 + 1100)
    again = host.send(step)

    assert again == first
    assert host.states[-1].x_ref == GAINS.x_0 + 1100


def test_rule_3_a_kept_id_with_another_type_is_refused() -> None:
    host = Host()
    host.send(frame("SET_STREAM", id=60, divider=1))

    assert refusal(host.send(frame("SET_MODE", id=60, mode=2))) == (Reason.BUSY, 0)
    assert host.states[-1].flags & 3 == Mode.IDLE


def test_rule_3_the_ninth_oldest_id_is_forgotten() -> None:
    host = Host()
    first = host.send(frame("SET_STREAM", id=101, divider=1))
    for n in range(102, 109):
        host.send(frame("SET_STREAM", id=n, divider=1))
    retained = host.send(frame("SET_STREAM", id=101, divider=1))

    host.send(frame("SET_STREAM", id=109, divider=1))
    forgotten = host.send(frame("SET_STREAM", id=101, divider=1))

    assert retained == first
    assert forgotten.int("tick") > first.int("tick")


@pytest.mark.parametrize(
    ("name", "fields"),
    [("GET_PARAMETERS", {}), ("READ_CAPTURE", {"index": 0}), ("STOP", {}), ("PING", {})],
    ids=["GET_PARAMETERS", "READ_CAPTURE", "STOP", "PING"],
)
def test_rule_3_every_command_takes_one_of_the_eight_places(name: str, fields: dict[str, int]) -> None:
    host = Host()
    first = host.send(frame("SET_STREAM", id=101, divider=1))
    for n in range(102, 109):
        host.firmware.feed(frame(name, id=n, **fields))
        host.run(1, alive=False)
    retained = host.send(frame("SET_STREAM", id=101, divider=1))  # and does not take a place again

    host.firmware.feed(frame(name, id=109, **fields))
    host.run(1, alive=False)
    forgotten = host.send(frame("SET_STREAM", id=101, divider=1))

    assert retained == first
    assert forgotten.int("tick") > first.int("tick")


def test_rule_3_a_hello_takes_no_place() -> None:
    host = Host()
    first = host.send(frame("SET_STREAM", id=101, divider=1))
    for n in range(102, 120):
        host.send(frame("HELLO", id=n, session=1, version_min=1, version_max=1))

    assert host.send(frame("SET_STREAM", id=101, divider=1)) == first


def test_rule_3_a_repeated_ping_is_answered_with_the_tick_of_the_first() -> None:
    host = Host()
    pongs = []
    for _ in range(2):
        host.firmware.feed(frame("PING", id=9))
        host.firmware.tick()
        pongs += [e for e in StreamDecoder().feed(take_output(host.firmware)) if isinstance(e, Message)]

    assert pongs[0] == pongs[1]


def test_rule_3_a_stop_takes_over_the_place_of_its_id() -> None:
    host = Host()
    host.send(frame("SET_STREAM", id=5, divider=1))

    stopped = host.send(frame("STOP", id=5))

    assert stopped.name == "ACK"
    assert refusal(host.send(frame("SET_STREAM", id=5, divider=1))) == (Reason.BUSY, 0)


def test_rule_3_a_kept_id_is_looked_at_before_the_frame_and_the_session_before_the_command() -> None:
    host = Host(session=False)

    malformed = host.send(encode_frame(b"\x03\x09\x03"))  # no mode 3, and no session either
    without_session = host.send(frame("SET_REFERENCE", id=9, x_ref=4095))  # out of bounds, too
    host.hello(4)
    retained = host.send(frame("SET_REFERENCE", id=9, x_ref=4095))
    again = host.send(encode_frame(b"\x04\x09\xff\xff"))  # the same id and type, a field out of its range

    assert refusal(malformed)[0] == Reason.OUT_OF_RANGE
    assert refusal(without_session)[0] == Reason.NO_SESSION
    assert again == retained


def test_rule_3_a_frame_whose_end_was_damaged_does_not_spoil_its_repetition() -> None:
    host = Host()
    good = frame("SET_STREAM", id=70, divider=1)

    damaged = host.send(good[:-1] + b"\x01\x00")  # to COBS one more zero, which leaves the CRC right
    repeated = host.send(good)

    assert refusal(damaged) == (Reason.BAD_LENGTH, 0)
    assert repeated.name == "ACK"


def test_rule_3_an_answer_says_what_was_in_force_when_its_command_was_executed() -> None:
    host = Host()
    host.firmware.feed(frame("GET_PARAMETERS", id=90))
    host.firmware.tick()  # and the line takes nothing yet
    host.firmware.feed(frame("SET_STREAM", id=91, divider=7))
    host.firmware.tick()

    delayed, _ = [event for event in StreamDecoder().feed(take_output(host.firmware)) if isinstance(event, Message)]
    repeated = host.send(frame("GET_PARAMETERS", id=90))

    assert (delayed.name, delayed.int("divider")) == ("PARAMETERS", 1)
    assert repeated == delayed


def test_rule_3_a_stop_with_a_kept_id_is_the_newest_of_the_eight() -> None:
    host = Host()
    for n in range(101, 109):
        host.send(frame("SET_STREAM", id=n, divider=1))

    host.send(frame("STOP", id=101))
    for n in range(109, 116):  # seven more: all but the STOP are given up
        host.send(frame("SET_STREAM", id=n, divider=1))

    assert refusal(host.send(frame("SET_STREAM", id=101, divider=1))) == (Reason.BUSY, 0)
    assert host.send(frame("SET_STREAM", id=108, divider=1)).name == "ACK"


def test_a_pong_counts_the_bad_frames_that_came_before_its_ping_was_executed() -> None:
    host = Host()
    bad = b"\x00\x01\x02\x00"

    host.firmware.feed(bad + frame("PING", id=70))
    host.firmware.feed(bad + frame("STOP", id=71) + bad)
    received = StreamDecoder().feed(take_output(host.firmware))

    pong = next(event for event in received if isinstance(event, Message) and event.name == "PONG")
    assert pong.int("bad_frames") == 1  # it was executed as soon as it was complete
    assert host.firmware.bad_frames == 3
