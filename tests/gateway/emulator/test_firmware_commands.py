"""'Behaviour of the board' in protocol/README.md, rules 4 to 9: ticks, line, modes, references, signals, gains.

The arithmetic of rule 8 is in test_firmware_excitation.py, the law of rule 9 in test_firmware_law.py.
"""

from __future__ import annotations

import pytest

from gateway.emulator.firmware_model.flash import GAINS, LIMITS
from protocol.wire.decoder import State, StreamDecoder
from protocol.wire.messages import EventCode, Flag, Mode, Reason
from tests.harness.gateway.board_host import QUIET, SECOND, Bench, Host, frame, open_loop, refusal
from tests.harness.protocol.port import take_output

pytestmark = pytest.mark.usefixtures("each_firmware")


# Rule 4


def test_rule_4_the_ack_carries_the_first_tick_that_the_command_shapes() -> None:
    host = Host()

    answer = host.request("SET_REFERENCE", x_ref=GAINS.x_0 + 7)
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
    host.request("SET_MODE", mode=2)
    host.request("SET_HOST_LOSS", policy=1, timeout=50)

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
    host.request("CAPTURE", u_from=0, u_to=0, pre=0, count=1)
    host.run(12)

    host.firmware.feed(frame("READ_CAPTURE", id=230, index=0))
    host.firmware.feed(frame("SET_MODE", id=231, mode=1))
    host.firmware.tick()
    names = []
    while encoded := host.firmware.take_frame():
        (event,) = StreamDecoder().feed(encoded)
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
    host.request("SET_MODE", mode=0)
    idle = host.run(1)[0]

    host.request("SET_MODE", mode=1)
    reopened = host.run(1)[0]

    assert (idle.u_c, idle.flags) == (0, Mode.IDLE)
    assert (reopened.u_c, reopened.flags) == (0, Mode.OPEN_LOOP)


def test_rule_6_entering_closed_loop_resets_the_integral_and_the_mode_in_force_is_left_alone() -> None:
    host = Host()
    host.request("SET_REFERENCE", x_ref=GAINS.x_0 + 100)
    entered = host.request("SET_MODE", mode=2)
    host.run(20)
    wound_up = host.states[-1].u_c

    same = host.request("SET_MODE", mode=2)
    after_same = host.states[-1].u_c
    host.request("SET_MODE", mode=0)
    host.request("SET_MODE", mode=2)

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

    excite = host.request("EXCITE", shape=0, target=0, offset=10, **QUIET)
    capture = host.request("CAPTURE", u_from=0, u_to=0, pre=0, count=1)
    reference = host.request("SET_REFERENCE", x_ref=GAINS.x_0)
    host.request("SET_MODE", mode=1)

    assert refusal(excite) == refusal(capture) == (Reason.FAULT_ACTIVE, 0)
    assert reference.name == "ACK"
    assert host.states[-1].flags == Mode.OPEN_LOOP


# Rule 7


@pytest.mark.parametrize(
    ("x_ref", "bound"), [(LIMITS.x_ref_min - 1, LIMITS.x_ref_min), (LIMITS.x_ref_max + 1, LIMITS.x_ref_max)]
)
def test_rule_7_a_reference_out_of_bounds_is_refused(x_ref: int, bound: int) -> None:
    assert refusal(Host().request("SET_REFERENCE", x_ref=x_ref)) == (Reason.OUT_OF_RANGE, bound)


def test_rule_7_jumps_use_up_an_allowance_that_refills() -> None:
    host = Host()
    host.request("SET_REFERENCE", x_ref=LIMITS.x_ref_max)
    used = LIMITS.x_ref_max - GAINS.x_0

    refused = host.request("SET_REFERENCE", x_ref=GAINS.x_0)
    reason, allowance = refusal(refused)
    ticks = -(-(used - allowance) * SECOND // LIMITS.x_ref_slew)
    host.run(ticks)
    accepted = host.request("SET_REFERENCE", x_ref=GAINS.x_0)

    assert reason == Reason.SLEW
    # One tick has passed between the two commands.
    assert allowance == (LIMITS.x_ref_step * SECOND - used * SECOND + LIMITS.x_ref_slew) // SECOND
    assert accepted.name == "ACK"


def test_rule_7_the_allowance_never_exceeds_one_step() -> None:
    host = Host()
    host.request("SET_REFERENCE", x_ref=GAINS.x_0 - 1000)
    host.run(SECOND)
    host.request("SET_REFERENCE", x_ref=LIMITS.x_ref_min)
    host.run(SECOND)

    answer = host.request("SET_REFERENCE", x_ref=LIMITS.x_ref_min + LIMITS.x_ref_step + 1)

    assert refusal(answer) == (Reason.SLEW, LIMITS.x_ref_step)


def test_rule_7_the_allowance_refills_exactly_once_per_tick() -> None:
    host = Host()
    host.request("SET_REFERENCE", x_ref=GAINS.x_0 - 1000)
    left = (LIMITS.x_ref_step - 1000) * 1_000_000

    for ticks in (1, 2, 3, 10):
        host.run(ticks - 1)
        left += ticks * LIMITS.x_ref_slew * 2000
        answer = host.request("SET_REFERENCE", x_ref=LIMITS.x_ref_max)
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
            assert host.request("SET_REFERENCE", x_ref=x_ref).name == "ACK"
            left -= jump * SECOND
        else:
            host.run(1)
        left += LIMITS.x_ref_slew
        assert left < LIMITS.x_ref_step * SECOND

    far = LIMITS.x_ref_max if x_ref < GAINS.x_0 else LIMITS.x_ref_min
    assert refusal(host.request("SET_REFERENCE", x_ref=far)) == (Reason.SLEW, left // SECOND)


def test_rule_7_a_jump_counts_from_what_an_excitation_shows() -> None:
    host = Host()
    host.request("SET_MODE", mode=2)
    host.request("EXCITE", shape=0, target=1, offset=LIMITS.x_ref_min, **QUIET)

    answer = host.request("SET_REFERENCE", x_ref=LIMITS.x_ref_min + LIMITS.x_ref_step)

    assert answer.name == "ACK"


# Rule 8 (shapes: test_firmware_excitation.py)


@pytest.mark.parametrize(("mode", "target"), [(0, 0), (2, 0), (0, 1), (1, 1)])
def test_rule_8_a_target_needs_its_mode(mode: int, target: int) -> None:
    host = Host()
    if mode:
        host.request("SET_MODE", mode=mode)

    assert refusal(host.request("EXCITE", shape=0, target=target, offset=2000, **QUIET)) == (Reason.WRONG_MODE, mode)


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
    host.request("SET_MODE", mode=mode)

    answer = host.request(
        "EXCITE", shape=2, target=mode - 1, offset=offset, **(QUIET | {"amplitude": amplitude, "period": 10})
    )

    assert refusal(answer) == (Reason.OUT_OF_RANGE, bound)


def test_rule_8_a_chirp_without_a_duration_is_refused() -> None:
    host = Host()
    host.request("SET_MODE", mode=1)

    assert refusal(host.request("EXCITE", shape=6, target=0, offset=100, **QUIET))[0] == Reason.OUT_OF_RANGE


def test_rule_8_a_signal_starts_at_the_tick_in_the_ack_and_ends_at_its_offset() -> None:
    host = Host()
    host.request("SET_MODE", mode=1)
    answer = host.request(
        "EXCITE", shape=2, target=0, offset=1000, **(QUIET | {"amplitude": 200, "period": 4, "duration": 6})
    )

    host.run(10)

    start = answer.int("tick")
    played = [state.u_c for state in host.states if state.sequence >= start]
    assert played[:9] == [1200, 1200, 800, 800, 1200, 1200, 1000, 1000, 1000]
    end_events = [event for event in host.events if event.int("code") == EventCode.EXCITATION_DONE]
    assert [(event.int("tick"), event.int("detail")) for event in end_events] == [(start + 6, 0)]


def test_rule_8_set_reference_ends_an_excitation_of_the_reference() -> None:
    host = Host()
    host.request("SET_MODE", mode=2)
    host.request("EXCITE", shape=2, target=1, offset=2000, **(QUIET | {"amplitude": 50, "period": 4}))
    host.run(5)

    host.request("SET_REFERENCE", x_ref=2100)

    assert {state.x_ref for state in host.states[-6:-1]} == {1950, 2050}
    assert {state.x_ref for state in host.run(10)} == {2100}


def test_rule_8_what_ends_an_excitation_leaves_the_reference_at_its_offset() -> None:
    host = Host()
    host.request("SET_MODE", mode=2)
    host.request("EXCITE", shape=2, target=1, offset=2000, **(QUIET | {"amplitude": 50, "period": 4}))
    host.run(5)

    host.request("STOP")

    assert {state.x_ref for state in host.run(5)} == {2000}
    assert EventCode.EXCITATION_DONE not in host.codes()


# Rule 9 (law: test_firmware_law.py)


def test_rule_9_set_gains_takes_effect_at_one_tick_and_keeps_the_sum() -> None:
    host = Host()
    host.request("SET_MODE", mode=2)
    host.request("SET_REFERENCE", x_ref=GAINS.x_0 + 50)
    host.run(40)
    gains = {f"k{n}_{part}": 0 for n in range(1, 5) for part in ("mantissa", "shift")}

    answer = host.request("SET_GAINS", law=0, **gains, i_0=1, x_0=2, u_0=3)
    parameters = host.request("GET_PARAMETERS")
    without_sum = host.states[-1].u_c
    host.request("SET_GAINS", law=0, **(gains | {"k4_mantissa": -1, "k4_shift": 2}), i_0=1, x_0=2, u_0=3)
    host.run(1)

    assert without_sum == 3
    assert host.states[-1].u_c > 3 + 30 * 50 // 4  # the sum of the 40 ticks before, and not only of those since
    assert parameters.int("tick") == answer.int("tick")
    assert [parameters.int(name) for name in ("i_0", "x_0", "u_0")] == [1, 2, 3]
