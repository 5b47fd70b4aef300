"""'Behaviour of the board' in protocol/README.md, rule by rule (the law, rule 9, is in test_firmware_law.py).

The arithmetic of rule 8 is in test_firmware_excitation.py, more of rule 3 in test_firmware_once.py.
"""

from __future__ import annotations

from itertools import pairwise

import pytest

from gateway.emulator.firmware_model.flash import BOOT_TICKS, CURRENT, GAINS, INPUT, LIMITS, POSITION, WATCHDOG_TICKS
from gateway.emulator.plant.levitation import EmulatedPlant
from protocol.wire.codec import unpack_pair
from protocol.wire.decoder import State, StreamDecoder
from protocol.wire.framing import encode_frame
from protocol.wire.messages import EventCode, Flag, HostLoss, Message, Mode, Reason
from tests.harness.gateway.board_host import Bench, Host, frame, refusal
from tests.harness.protocol.port import take_output

pytestmark = pytest.mark.usefixtures("each_firmware")

SECOND = 500  # ticks
QUIET = {"amplitude": 0, "period": 1, "period_end": 1, "seed": 1, "duration": 0}


def open_loop(u: int, bench: Bench | None = None) -> Host:
    """A host with the board in open loop at a constant input."""
    host = Host(bench)
    host.ask("SET_MODE", mode=1)
    host.ask("EXCITE", shape=0, target=0, offset=u, **QUIET)
    return host


# Rule 1


def test_rule_1_a_board_boots_idle_with_defaults_from_flash() -> None:
    host = Host(session=False)

    first, *_ = host.run(3)
    host.hello(5)
    parameters = host.ask("GET_PARAMETERS")

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
    host.ask("SET_STREAM", divider=2)

    answer = host.ask("RESET")
    host.run(BOOT_TICKS + 3, alive=False)

    assert answer.name == "ACK"
    assert host.events[-1].int("code") == EventCode.RESET_COMMANDED
    assert host.events[-1].int("detail") == 1
    assert [state.sequence for state in host.states[-2:]] == [0, 1]
    assert host.states[-1].u_c == 0
    assert refusal(host.ask("SET_STREAM", divider=1)) == (Reason.NO_SESSION, 0)


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

    answer = host.ask("SET_STREAM", divider=7)
    host.run(40)
    back = host.ask("SET_STREAM", divider=1)

    since = [state.sequence for state in host.states if state.sequence >= answer.int("tick")]
    assert answer.int("tick") % 7
    assert since == [tick for tick in range(answer.int("tick"), back.int("tick")) if tick % 7 == 0] + [back.int("tick")]


def test_rule_1_the_phase_of_the_stream_counts_from_0_again_where_the_tick_wraps() -> None:
    host = Host()
    host.ask("SET_STREAM", divider=10)
    host.firmware.next_tick = 2**32 - 20

    states = host.run(40)

    assert [state.sequence for state in states] == [65520, 65530, 0, 10]


def test_rule_1_the_allowance_is_full_after_a_reset() -> None:
    host = Host()
    host.ask("SET_REFERENCE", x_ref=LIMITS.x_ref_max)
    host.ask("RESET")
    host.run(BOOT_TICKS + 1, alive=False)
    host.hello(2)

    beyond = host.ask("SET_REFERENCE", x_ref=GAINS.x_0 - LIMITS.x_ref_step - 1)
    whole = host.ask("SET_REFERENCE", x_ref=GAINS.x_0 - LIMITS.x_ref_step)

    assert refusal(beyond) == (Reason.SLEW, LIMITS.x_ref_step)
    assert whole.name == "ACK"


# Rule 2


def test_rule_2_without_a_session_only_hello_ping_and_stop_are_heard() -> None:
    host = Host(session=False)

    refused = [
        host.ask("SET_MODE", mode=2),
        host.ask("SET_REFERENCE", x_ref=GAINS.x_0),
        host.ask("GET_PARAMETERS"),
        host.ask("RESET"),
        host.ask("READ_CAPTURE", index=0),
    ]
    stopped = host.ask("STOP")
    host.firmware.feed(frame("PING", id=77))
    host.firmware.tick()
    pong = StreamDecoder().feed(take_output(host.firmware))[1]

    assert {refusal(answer) for answer in refused} == {(Reason.NO_SESSION, 0)}
    assert stopped.name == "ACK"
    assert isinstance(pong, Message)
    assert (pong.name, pong.int("id"), pong.int("tick")) == ("PONG", 77, host.firmware.next_tick - 1)


def test_rule_2_hello_changes_neither_mode_nor_reference() -> None:
    host = Host()
    host.ask("SET_MODE", mode=2)
    host.ask("SET_REFERENCE", x_ref=GAINS.x_0 + 100)

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
        assert refusal(host.ask("GET_PARAMETERS")) == (Reason.NO_SESSION, 0)


# Rule 3


def test_rule_3_a_repeated_command_is_answered_with_the_kept_answer() -> None:
    host = Host()
    step = frame("SET_REFERENCE", id=40, x_ref=GAINS.x_0 + 1000)

    first = host.send(step)
    host.ask("SET_REFERENCE", x_ref=GAINS.x_0 + 1100)
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

    late, _ = [event for event in StreamDecoder().feed(take_output(host.firmware)) if isinstance(event, Message)]
    repeated = host.send(frame("GET_PARAMETERS", id=90))

    assert (late.name, late.int("divider")) == ("PARAMETERS", 1)
    assert repeated == late


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


# Rule 4


def test_rule_4_the_ack_carries_the_first_tick_that_the_command_shapes() -> None:
    host = Host()

    answer = host.ask("SET_REFERENCE", x_ref=GAINS.x_0 + 7)
    shaped = [state.sequence for state in host.states if state.x_ref == GAINS.x_0 + 7]

    assert shaped == [answer.int("tick")]


def test_rule_4_commands_are_executed_in_the_order_of_arrival_one_in_each_tick() -> None:
    host = Host()

    for n, x_ref in enumerate((10, 30, 20)):
        host.firmware.feed(frame("SET_REFERENCE", id=200 + n, x_ref=GAINS.x_0 + x_ref))
    states = host.run(3)

    assert [(answer.int("id"), answer.int("tick")) for answer in host.answers[-3:]] == [
        (200 + n, state.sequence) for n, state in enumerate(states)
    ]
    assert [state.x_ref - GAINS.x_0 for state in states] == [10, 30, 20]


def test_rule_4_the_policy_of_host_loss_shapes_the_tick_at_which_it_acts() -> None:
    host = Host()
    host.ask("SET_MODE", mode=2)
    host.ask("SET_HOST_LOSS", policy=1, timeout=50)

    host.run(30, alive=False)

    lost, changed = host.events[-2:]
    assert [event.int("code") for event in (lost, changed)] == [EventCode.HOST_LOST, EventCode.MODE_CHANGED]
    tick = lost.int("tick")
    flags = {state.sequence: state.flags for state in host.states}
    assert not flags[tick - 1] & Flag.HOST_LOST
    assert flags[tick] == Flag.HOST_LOST | Mode.IDLE


# Rule 5


def test_rule_5_state_goes_first_then_answers_events_and_capture_blocks() -> None:
    host = Host()
    host.ask("CAPTURE", u_from=0, u_to=0, pre=0, count=1)
    host.run(12)

    host.firmware.feed(frame("READ_CAPTURE", id=230, index=0))
    host.firmware.feed(frame("SET_MODE", id=231, mode=1))
    host.firmware.tick()
    names = []
    while taken := host.firmware.take_frame():
        (event,) = StreamDecoder().feed(taken)
        names.append("STATE" if isinstance(event, State) else getattr(event, "name", "bad"))

    assert names == ["STATE", "ACK", "EVENT", "CAPTURE_BLOCK"]


def test_rule_5_a_line_that_is_not_served_loses_the_oldest_states_and_counts() -> None:
    firmware = Host.make(Bench())

    for _ in range(30):
        firmware.tick()
    left = [event for event in StreamDecoder().feed(take_output(firmware)) if isinstance(event, State)]

    assert [state.sequence for state in left] == list(range(22, 30))
    assert firmware.dropped == 22


# Rule 6


def test_rule_6_idle_and_open_loop_start_at_count_0() -> None:
    host = open_loop(1500)
    host.ask("SET_MODE", mode=0)
    idle = host.run(1)[0]

    host.ask("SET_MODE", mode=1)
    reopened = host.run(1)[0]

    assert (idle.u_c, idle.flags) == (0, Mode.IDLE)
    assert (reopened.u_c, reopened.flags) == (0, Mode.OPEN_LOOP)


def test_rule_6_entering_closed_loop_resets_the_integral_and_the_mode_in_force_is_left_alone() -> None:
    host = Host()
    host.ask("SET_REFERENCE", x_ref=GAINS.x_0 + 100)
    entered = host.ask("SET_MODE", mode=2)
    host.run(20)
    wound_up = host.states[-1].u_c

    same = host.ask("SET_MODE", mode=2)
    after_same = host.states[-1].u_c
    host.ask("SET_MODE", mode=0)
    host.ask("SET_MODE", mode=2)

    first = next(state for state in host.states if state.sequence == entered.int("tick"))
    assert same.name == "ACK"
    assert wound_up > first.u_c
    assert after_same >= wound_up
    assert host.states[-1].u_c == first.u_c
    assert host.details(EventCode.MODE_CHANGED) == [2, 0, 2]


def test_rule_6_set_mode_clears_a_fault_and_everything_else_waits_for_it() -> None:
    bench = Bench(i_a=5.0)
    host = Host(bench)
    host.run(60)
    bench.i_a = 0.0
    assert host.states[-1].flags & Flag.FAULT

    excite = host.ask("EXCITE", shape=0, target=0, offset=10, **QUIET)
    capture = host.ask("CAPTURE", u_from=0, u_to=0, pre=0, count=1)
    reference = host.ask("SET_REFERENCE", x_ref=GAINS.x_0)
    host.ask("SET_MODE", mode=1)

    assert refusal(excite) == refusal(capture) == (Reason.FAULT_ACTIVE, 0)
    assert reference.name == "ACK"
    assert host.states[-1].flags == Mode.OPEN_LOOP


# Rule 7


@pytest.mark.parametrize(
    ("x_ref", "bound"), [(LIMITS.x_ref_min - 1, LIMITS.x_ref_min), (LIMITS.x_ref_max + 1, LIMITS.x_ref_max)]
)
def test_rule_7_a_reference_out_of_bounds_is_refused(x_ref: int, bound: int) -> None:
    assert refusal(Host().ask("SET_REFERENCE", x_ref=x_ref)) == (Reason.OUT_OF_RANGE, bound)


def test_rule_7_jumps_use_up_an_allowance_that_refills() -> None:
    host = Host()
    host.ask("SET_REFERENCE", x_ref=LIMITS.x_ref_max)
    used = LIMITS.x_ref_max - GAINS.x_0

    refused = host.ask("SET_REFERENCE", x_ref=GAINS.x_0)
    reason, allowance = refusal(refused)
    ticks = -(-(used - allowance) * SECOND // LIMITS.x_ref_slew)
    host.run(ticks)
    accepted = host.ask("SET_REFERENCE", x_ref=GAINS.x_0)

    assert reason == Reason.SLEW
    # One tick has passed between the two commands.
    assert allowance == (LIMITS.x_ref_step * SECOND - used * SECOND + LIMITS.x_ref_slew) // SECOND
    assert accepted.name == "ACK"


def test_rule_7_the_allowance_never_exceeds_one_step() -> None:
    host = Host()
    host.ask("SET_REFERENCE", x_ref=GAINS.x_0 - 1000)
    host.run(SECOND)
    host.ask("SET_REFERENCE", x_ref=LIMITS.x_ref_min)
    host.run(SECOND)

    answer = host.ask("SET_REFERENCE", x_ref=LIMITS.x_ref_min + LIMITS.x_ref_step + 1)

    assert refusal(answer) == (Reason.SLEW, LIMITS.x_ref_step)


def test_rule_7_the_allowance_refills_exactly_once_per_tick() -> None:
    host = Host()
    host.ask("SET_REFERENCE", x_ref=GAINS.x_0 - 1000)
    left = (LIMITS.x_ref_step - 1000) * 1_000_000

    for ticks in (1, 2, 3, 10):
        host.run(ticks - 1)
        left += ticks * LIMITS.x_ref_slew * 2000
        answer = host.ask("SET_REFERENCE", x_ref=LIMITS.x_ref_max)
        assert refusal(answer) == (Reason.SLEW, left // 1_000_000)


def test_rule_7_the_allowance_is_kept_exactly_over_many_jumps() -> None:
    host = Host()
    ticks = 125
    assert LIMITS.x_ref_slew * ticks % SECOND == 0  # so that a millionth of a count less would show
    x_ref, left = GAINS.x_0, LIMITS.x_ref_step * SECOND
    for n in range(ticks):
        if n % 25 == 0:
            jump = 700 if n else 1000
            x_ref += jump if x_ref < GAINS.x_0 else -jump
            assert host.ask("SET_REFERENCE", x_ref=x_ref).name == "ACK"
            left -= jump * SECOND
        else:
            host.run(1)
        left += LIMITS.x_ref_slew
        assert left < LIMITS.x_ref_step * SECOND

    far = LIMITS.x_ref_max if x_ref < GAINS.x_0 else LIMITS.x_ref_min
    assert refusal(host.ask("SET_REFERENCE", x_ref=far)) == (Reason.SLEW, left // SECOND)


def test_rule_7_a_jump_counts_from_what_an_excitation_shows() -> None:
    host = Host()
    host.ask("SET_MODE", mode=2)
    host.ask("EXCITE", shape=0, target=1, offset=LIMITS.x_ref_min, **QUIET)

    answer = host.ask("SET_REFERENCE", x_ref=LIMITS.x_ref_min + LIMITS.x_ref_step)

    assert answer.name == "ACK"


# Rule 8 (shapes: test_firmware_excitation.py)


@pytest.mark.parametrize(("mode", "target"), [(0, 0), (2, 0), (0, 1), (1, 1)])
def test_rule_8_a_target_needs_its_mode(mode: int, target: int) -> None:
    host = Host()
    if mode:
        host.ask("SET_MODE", mode=mode)

    assert refusal(host.ask("EXCITE", shape=0, target=target, offset=2000, **QUIET)) == (Reason.WRONG_MODE, mode)


@pytest.mark.parametrize(
    ("mode", "amplitude", "offset", "bound"),
    [
        (1, 100, 99, 0),
        (1, -100, 4000, LIMITS.u_max),
        (2, 100, LIMITS.x_ref_min + 99, LIMITS.x_ref_min),
        (2, -100, LIMITS.x_ref_max - 99, LIMITS.x_ref_max),
    ],
)
def test_rule_8_a_signal_that_would_leave_its_range_is_refused(
    mode: int, amplitude: int, offset: int, bound: int
) -> None:
    host = Host()
    host.ask("SET_MODE", mode=mode)

    answer = host.ask(
        "EXCITE", shape=2, target=mode - 1, offset=offset, **(QUIET | {"amplitude": amplitude, "period": 10})
    )

    assert refusal(answer) == (Reason.OUT_OF_RANGE, bound)


def test_rule_8_a_chirp_without_a_duration_is_refused() -> None:
    host = Host()
    host.ask("SET_MODE", mode=1)

    assert refusal(host.ask("EXCITE", shape=6, target=0, offset=100, **QUIET))[0] == Reason.OUT_OF_RANGE


def test_rule_8_a_signal_starts_at_the_tick_in_the_ack_and_ends_at_its_offset() -> None:
    host = Host()
    host.ask("SET_MODE", mode=1)
    answer = host.ask(
        "EXCITE", shape=2, target=0, offset=1000, **(QUIET | {"amplitude": 200, "period": 4, "duration": 6})
    )

    host.run(10)

    start = answer.int("tick")
    played = [state.u_c for state in host.states if state.sequence >= start]
    assert played[:9] == [1200, 1200, 800, 800, 1200, 1200, 1000, 1000, 1000]
    done = [event for event in host.events if event.int("code") == EventCode.EXCITATION_DONE]
    assert [(event.int("tick"), event.int("detail")) for event in done] == [(start + 6, 0)]


def test_rule_8_set_reference_ends_an_excitation_of_the_reference() -> None:
    host = Host()
    host.ask("SET_MODE", mode=2)
    host.ask("EXCITE", shape=2, target=1, offset=2000, **(QUIET | {"amplitude": 50, "period": 4}))
    host.run(5)

    host.ask("SET_REFERENCE", x_ref=2100)

    assert {state.x_ref for state in host.states[-6:-1]} == {1950, 2050}
    assert {state.x_ref for state in host.run(10)} == {2100}


def test_rule_8_what_ends_an_excitation_leaves_the_reference_at_its_offset() -> None:
    host = Host()
    host.ask("SET_MODE", mode=2)
    host.ask("EXCITE", shape=2, target=1, offset=2000, **(QUIET | {"amplitude": 50, "period": 4}))
    host.run(5)

    host.ask("STOP")

    assert {state.x_ref for state in host.run(5)} == {2000}
    assert EventCode.EXCITATION_DONE not in host.codes()


# Rule 9 (law: test_firmware_law.py)


def test_rule_9_set_gains_takes_effect_at_one_tick_and_keeps_the_sum() -> None:
    host = Host()
    host.ask("SET_MODE", mode=2)
    host.ask("SET_REFERENCE", x_ref=GAINS.x_0 + 50)
    host.run(40)
    gains = {f"k{n}_{part}": 0 for n in range(1, 5) for part in ("mantissa", "shift")}

    answer = host.ask("SET_GAINS", law=0, **gains, i_0=1, x_0=2, u_0=3)
    parameters = host.ask("GET_PARAMETERS")
    without_sum = host.states[-1].u_c
    host.ask("SET_GAINS", law=0, **(gains | {"k4_mantissa": -1, "k4_shift": 2}), i_0=1, x_0=2, u_0=3)
    host.run(1)

    assert without_sum == 3
    assert host.states[-1].u_c > 3 + 30 * 50 // 4  # the sum of the 40 ticks before, and not only of those since
    assert parameters.int("tick") == answer.int("tick")
    assert [parameters.int(name) for name in ("i_0", "x_0", "u_0")] == [1, 2, 3]


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
    host.ask("SET_MODE", mode=mode)
    host.ask("EXCITE", shape=2, target=mode - 1, offset=1000, **(QUIET | {"amplitude": 50, "period": 4}))
    host.ask("SET_HOST_LOSS", policy=policy, timeout=100)

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
    host.ask("SET_HOST_LOSS", policy=1, timeout=50)

    for _ in range(40):
        host.firmware.feed(b"\x00garbage\x00" + frame("PING", id=3)[:-2] + b"\x00")
        host.run(1, alive=False)

    assert EventCode.HOST_LOST in host.codes()


def test_rule_10_the_timer_runs_without_a_host_and_any_frame_with_an_id_restarts_it() -> None:
    alone = Host(session=False)
    alone.run(249, alive=False)
    before = alone.codes()
    alone.run(1, alive=False)
    talked_to = Host()
    for _ in range(600):
        talked_to.firmware.feed(encode_frame(b"\x3f\x09"))  # a type that nobody knows
        talked_to.run(1, alive=False)

    assert EventCode.HOST_LOST not in before
    assert EventCode.HOST_LOST in alone.codes()
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

    host.ask("SET_MODE", mode=2)
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

    host.ask("SET_MODE", mode=1)

    assert host.codes().count(EventCode.OVER_CURRENT) == 2
    assert host.states[-1].flags & (Flag.FAULT | 3) == Flag.FAULT


def test_rule_11_a_closed_loop_that_was_left_and_entered_between_two_ticks_counts_anew() -> None:
    bench = Bench(x_m=-1.0)
    host = Host(bench)
    host.ask("SET_MODE", mode=2)
    host.run(498)

    host.firmware.feed(frame("SET_MODE", id=201, mode=0))
    host.firmware.feed(frame("SET_MODE", id=202, mode=2))
    host.run(500)
    before = EventCode.SENSOR_FAULT in host.codes()
    host.run(1)

    assert not before
    assert host.codes()[-2:] == [EventCode.SENSOR_FAULT, EventCode.MODE_CHANGED]


# Rule 12


def test_rule_12_a_capture_records_the_step_at_25_khz() -> None:
    plant = EmulatedPlant()
    host = Host(plant)
    u_from, u_to, pre, count = 400, 1600, 30, 200

    answer = host.ask("CAPTURE", u_from=u_from, u_to=u_to, pre=pre, count=count)
    host.run(20)
    samples: list[int] = []
    blocks = []
    for index in range(0, count, 32):
        block = host.ask("READ_CAPTURE", index=index)
        blocks.append(block)
        packed = block.bytes("samples")
        for n in range(0, 48, 3):
            samples += unpack_pair(packed[n : n + 3])

    assert {block.int("total") for block in blocks} == {count}
    assert {block.int("tick") for block in blocks} == {answer.int("tick") + 10}
    assert samples[count:] == [0] * (len(samples) - count)
    # The rig's own first order: K_A 0.297 A/V and T_A, at 40 us; noise 2 mA, five sigma.
    level = [0.297 * INPUT.to_si(u) for u in (u_from, u_to)]
    decay = 2.718281828 ** (-40e-6 / plant.rig.amplifier_time_constant_s)
    for n, sample in enumerate(samples[:count]):
        expected = level[0] if n <= pre else level[1] + (level[0] - level[1]) * decay ** (n - pre)
        assert abs(CURRENT.to_si(sample) - expected) < 5 * plant.rig.current_noise_a + CURRENT.lsb
    assert host.details(EventCode.CAPTURE_DONE) == [0]


def test_rule_12_u_from_comes_20_ms_before_the_first_sample_and_the_mode_takes_over_after() -> None:
    bench = Bench()
    host = open_loop(700, bench)
    bench.inputs.clear()

    host.ask("CAPTURE", u_from=400, u_to=1600, pre=10, count=75)
    host.run(16)

    runs: list[tuple[float, int]] = []
    for u_v, us in bench.inputs:
        count = INPUT.to_count(u_v)
        if runs and runs[-1][0] == count:
            runs[-1] = (count, runs[-1][1] + us)
        else:
            runs.append((count, us))
    assert runs[1:3] == [(400, 20_000 + 10 * 40), (1600, 65 * 40)]
    assert [count for count, _ in runs] == [700, 400, 1600, 700]


def test_rule_12_the_loop_goes_on_during_a_capture() -> None:
    host = Host()

    host.ask("CAPTURE", u_from=100, u_to=200, pre=50, count=100)
    states = host.run(20)

    assert [state.u_c for state in states] == [100] * 10 + [200] + [0] * 9
    assert [b.sequence - a.sequence for a, b in pairwise(states)] == [1] * 19


def test_rule_12_what_would_disturb_a_capture_is_refused() -> None:
    host = Host()
    host.ask("SET_MODE", mode=1)
    host.ask("CAPTURE", u_from=100, u_to=200, pre=50, count=2000)

    for name, fields in (
        ("EXCITE", {"shape": 0, "target": 0, "offset": 1, **QUIET}),
        ("SET_MODE", {"mode": 2}),
        ("CAPTURE", {"u_from": 0, "u_to": 0, "pre": 0, "count": 1}),
        ("READ_CAPTURE", {"index": 0}),
    ):
        assert refusal(host.ask(name, **fields)) == (Reason.BUSY, 0)
    host.ask("SET_MODE", mode=0)

    assert host.states[-1].u_c == 0
    assert refusal(host.ask("READ_CAPTURE", index=0)) == (Reason.NOT_AVAILABLE, 0)


def test_rule_12_a_capture_needs_idle_or_open_loop_and_has_an_end() -> None:
    host = Host()
    never = host.ask("READ_CAPTURE", index=0)
    host.ask("CAPTURE", u_from=0, u_to=0, pre=0, count=33)
    host.run(15)
    beyond = host.ask("READ_CAPTURE", index=33)
    last = host.ask("READ_CAPTURE", index=32)
    host.ask("SET_MODE", mode=2)

    closed = host.ask("CAPTURE", u_from=0, u_to=0, pre=0, count=1)

    assert refusal(never) == refusal(beyond) == (Reason.NOT_AVAILABLE, 0)
    assert last.name == "CAPTURE_BLOCK"
    assert refusal(closed) == (Reason.WRONG_MODE, Mode.CLOSED_LOOP)


def test_rule_12_a_capture_that_ended_before_a_stop_can_be_read() -> None:
    host = Host()
    host.ask("CAPTURE", u_from=0, u_to=100, pre=0, count=1)
    host.run(10)

    host.firmware.feed(frame("STOP", id=99), into_tick_us=700)  # the sample's 40 us are over
    host.run(1, alive=False)

    assert host.codes()[-1] == EventCode.CAPTURE_DONE
    assert host.ask("READ_CAPTURE", index=0).name == "CAPTURE_BLOCK"


def test_rule_12_a_capture_that_hangs_holds_its_input_until_the_watchdog_resets_the_board() -> None:
    bench = Bench()
    host = Host(bench)
    host.ask("CAPTURE", u_from=100, u_to=200, pre=0, count=20)
    host.run(5)

    host.firmware.hang()
    bench.inputs.clear()
    host.run(WATCHDOG_TICKS, alive=False)
    held = {u for u, _ in bench.inputs}
    host.run(BOOT_TICKS + 1, alive=False)

    assert held == {INPUT.to_si(100)}
    assert EventCode.CAPTURE_DONE not in host.codes()
    assert bench.inputs[-1][0] == 0.0


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
    host.ask("SET_STREAM", divider=3)
    host.ask("CAPTURE", u_from=100, u_to=200, pre=50, count=2000)

    host.ask("STOP")
    states = host.run(9)

    assert len(states) == 3
    assert {state.u_c for state in states} == {0}
    assert EventCode.CAPTURE_DONE not in host.codes()


def test_rule_13_the_ack_of_a_stop_carries_the_tick_that_comes_next() -> None:
    host = Host()
    host.ask("SET_MODE", mode=1)
    shown = host.run(3)[-1].sequence

    host.firmware.feed(frame("STOP", id=77), into_tick_us=700)
    answered = StreamDecoder().feed(take_output(host.firmware))
    off = host.firmware.u
    state = host.run(1)[0]

    (ack, changed) = [event for event in answered if isinstance(event, Message)]
    assert (ack.name, ack.int("tick"), changed.int("tick")) == ("ACK", shown + 1, shown + 1)
    assert off == 0
    assert (state.sequence, state.flags) == (shown + 1, Mode.IDLE)


def test_rule_13_a_stop_leaves_a_fault() -> None:
    bench = Bench(i_a=5.0)
    host = Host(bench)
    host.run(60)
    bench.i_a = 0.0

    host.ask("STOP")

    assert host.states[-1].flags == Flag.FAULT | Mode.IDLE


def test_rule_13_a_stop_is_executed_whatever_its_id() -> None:
    host = Host()
    host.send(frame("STOP", id=5))
    host.ask("SET_MODE", mode=1)

    again = host.send(frame("STOP", id=5))

    assert again.name == "ACK"
    assert host.states[-1].flags == Mode.IDLE


# Rule 14


def test_rule_14_identity_tells_what_a_count_is_worth() -> None:
    host = Host(session=False)

    identity = host.hello(3)

    assert identity.int("sample_time") == 2000
    assert (identity.int("adc_bits"), identity.int("dac_bits")) == (12, 12)
    assert (identity.int("capture_time"), identity.int("capture_size")) == (40, 2000)
    # Single precision: 24 bits of mantissa.
    assert identity.float("u_lsb") == pytest.approx(5 / 4096, rel=2**-24)
    assert identity.float("i_lsb") == pytest.approx(2 / 4096, rel=2**-24)
    assert identity.float("x_lsb") == pytest.approx(5 / 4096 / 855, rel=2**-24)
    assert identity.float("x_offset") == pytest.approx(-(4.92 - 855 * 5.7e-3) / 855, rel=2**-24)


def test_rule_14_readings_are_within_half_a_count() -> None:
    bench = Bench()
    host = Host(bench)

    for n in range(50):
        bench.i_a, bench.x_m = 0.03 * n, 1.1e-4 * n
        state = host.run(1)[0]
        assert abs(CURRENT.to_si(state.i_c) - bench.i_a) <= CURRENT.lsb / 2 * (1 + 1e-9)
        assert abs(POSITION.to_si(state.x) - bench.x_m) <= POSITION.lsb / 2 * (1 + 1e-9)


# Rule 15 (bounds and modes: above)


@pytest.mark.parametrize(
    ("body", "reason", "detail"),
    [
        (b"\x3f\x09", Reason.UNKNOWN_TYPE, 0),
        (b"\x03\x09", Reason.BAD_LENGTH, 0),
        (b"\x03\x09\x01\x00", Reason.BAD_LENGTH, 0),
        (b"\x03\x09\x03", Reason.OUT_OF_RANGE, 2),
        (b"\x0b\x09\x01\x31\x00", Reason.OUT_OF_RANGE, 50),
        (b"\x0b\x09\x01\x61\xea", Reason.OUT_OF_RANGE, 60000),
        (b"\x04\x09\x00\x10", Reason.OUT_OF_RANGE, 4095),
        (b"\x06\x09\x00\x00\x00\xf0\x00\x00\x01\x00\x01\x00\x01\x00\x00\x00\x00\x00", Reason.OUT_OF_RANGE, 4095),
    ],
)
def test_rule_15_a_malformed_command_is_told_why(body: bytes, reason: Reason, detail: int) -> None:
    host = Host()

    answer = host.send(encode_frame(body))

    assert (answer.int("id"), answer.int("command")) == (9, body[0])
    assert refusal(answer) == (reason, detail)


@pytest.mark.parametrize(
    "junk",
    [
        b"\x00\x01\x02\x00",
        encode_frame(b"\x02\x00"),  # id 0
        encode_frame(b"\x02"),  # no id
        encode_frame(b"\x40\x01" + bytes(8)),  # a STATE: an echoing line must not start a conversation
        b"\x00" + b"\x55" * 90 + b"\x00",
    ],
)
def test_what_is_no_command_is_counted_and_not_answered(junk: bytes) -> None:
    host = Host()
    host.firmware.feed(junk)
    host.run(2, alive=False)
    host.firmware.feed(frame("PING", id=7))
    host.firmware.tick()

    pongs = [event for event in StreamDecoder().feed(take_output(host.firmware)) if isinstance(event, Message)]

    assert [(pong.name, pong.int("bad_frames")) for pong in pongs] == [("PONG", 1)]
    assert len(host.answers) == 1  # HELLO


def test_the_longest_frame_is_answered_and_what_follows_it_makes_it_too_long() -> None:
    host = Host()
    longest = encode_frame(bytes((0x3F, 9)) + b"\x55" * 62)

    answer = host.send(longest)
    host.firmware.feed(longest[:-1] + b"\x55\x00")
    host.run(1, alive=False)

    assert len(longest) == 69
    assert refusal(answer) == (Reason.UNKNOWN_TYPE, 0)
    assert host.firmware.bad_frames == 1
    assert host.answers[-1] is answer


@pytest.mark.parametrize(
    "refused",
    [
        encode_frame(b"\x3f\x09"),  # UNKNOWN_TYPE
        encode_frame(b"\x03\x09"),  # BAD_LENGTH
        encode_frame(b"\x03\x09\x03"),  # OUT_OF_RANGE
        frame("EXCITE", id=9, shape=0, target=0, offset=1, **QUIET),  # WRONG_MODE
    ],
    ids=["UNKNOWN_TYPE", "BAD_LENGTH", "OUT_OF_RANGE", "WRONG_MODE"],
)
def test_what_is_answered_is_no_bad_frame(refused: bytes) -> None:
    host = Host()

    answer = host.send(refused)

    assert answer.name == "NACK"
    assert host.firmware.bad_frames == 0


# Rule 16


def test_rule_16_limit_hit_comes_at_most_once_a_second() -> None:
    bench = Bench()
    host = Host(bench)
    host.ask("SET_MODE", mode=2)

    for n in range(1200):
        bench.x_m = 0.0 if n // 10 % 2 else 2.85e-3
        host.run(1, alive=False)
        host.firmware.feed(frame("PING", id=host.next_id()))

    ticks = [event.int("tick") for event in host.events if event.int("code") == EventCode.LIMIT_HIT]
    assert set(host.details(EventCode.LIMIT_HIT)) == {0}
    assert len(ticks) == 3
    assert all(b - a >= SECOND for a, b in pairwise(ticks))
    assert any(state.flags & Flag.INPUT_SATURATED for state in host.states)
    assert all(state.u_c in (0, 4095) for state in host.states if state.flags & Flag.INPUT_SATURATED)


@pytest.mark.parametrize(("gap", "count"), [(SECOND - 1, 1), (SECOND, 2)])
def test_rule_16_a_second_has_passed_after_as_many_ticks_as_last_one(gap: int, count: int) -> None:
    bench = Bench()
    host = Host(bench)
    host.ask("SET_MODE", mode=2)
    host.run(10)

    for _ in range(2):
        bench.x_m = 0.0
        host.run(1)
        bench.x_m = 2.85e-3
        host.run(gap - 1)

    assert host.codes().count(EventCode.LIMIT_HIT) == count


def test_rule_16_events_are_numbered_without_gaps() -> None:
    host = Host()
    for n in range(300):
        host.ask("SET_MODE", mode=1 - n % 2)

    numbers = [event.int("number") for event in host.events]

    assert numbers == [n % 256 for n in range(len(numbers))]
    assert len(numbers) > 256


def test_the_tick_wraps_after_32_bits_and_the_sequence_after_16() -> None:
    host = Host()
    host.firmware.next_tick = 2**32 - 2

    states = host.run(3)
    answer = host.ask("SET_STREAM", divider=1)

    assert [state.sequence for state in states] == [65534, 65535, 0]
    assert answer.int("tick") == 1


def test_an_overrun_shows_in_the_flag_the_count_and_an_event() -> None:
    host = Host()

    host.firmware.overrun()
    states = host.run(2)

    assert [bool(state.flags & Flag.OVERRUN) for state in states] == [True, False]
    assert host.details(EventCode.OVERRUN) == [0]


def test_a_sample_lost_on_the_board_is_a_gap_in_the_sequence() -> None:
    bench = Bench()
    host = Host(bench)
    before = host.run(1)[0].sequence
    bench.lossy = True
    lost = host.run(1)
    bench.lossy = False

    after = host.run(1)[0].sequence

    assert lost == []
    assert after - before == 2
