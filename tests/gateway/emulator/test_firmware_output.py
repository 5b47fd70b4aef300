"""An output that fails, and absurd stored settings: rules 1 and 11 of protocol/README.md, on both firmwares."""

from __future__ import annotations

import random
from dataclasses import replace
from functools import partial

import pytest

from gateway.emulator.firmware_model.flash import BOOT_TICKS, CE152_BOARD, CURRENT, GAINS, INPUT, LIMITS, Settings
from gateway.emulator.firmware_model.output import OutputFault
from protocol.wire.messages import COUNTS_MAX, ROW_OF_NAME, EventCode, Flag, Mode, Reason
from tests.harness.firmware.random_host import random_settings
from tests.harness.gateway.board_host import QUIET, Bench, Host, refusal
from tests.harness.gateway.board_host import open_loop as open_loop_at

pytestmark = pytest.mark.usefixtures("each_firmware")

CODE = 1759
UNCONFIRMED_TICKS = 5
UNCOMMANDED_TICKS = 100
TEST_CURRENT_A = 1.0
open_loop = partial(open_loop_at, CODE)


def settings(**changes: int) -> Settings:
    """The board's settings with other limits."""
    return Settings(gains=GAINS, limits=replace(LIMITS, **changes))


# An output that is not confirmed


def test_a_stop_that_a_deaf_converter_does_not_take_is_a_fault_and_u_c_says_what_it_still_gives() -> None:
    bench = Bench()
    host = open_loop(bench)
    host.firmware.fail_output(OutputFault.DEAF)

    answer = host.request("STOP")
    host.run(UNCONFIRMED_TICKS)

    assert answer.name == "ACK"
    assert {state.u_c for state in host.states[-UNCONFIRMED_TICKS:]} == {CODE}
    assert bench.inputs[-1][0] == INPUT.to_si(CODE)
    assert host.states[-1].flags & (Flag.FAULT | 3) == Flag.FAULT | Mode.IDLE
    assert host.details(EventCode.OUTPUT_FAULT) == [CODE]


def test_0_is_written_until_the_converter_takes_it() -> None:
    host = open_loop()
    host.firmware.fail_output(OutputFault.DEAF)
    host.run(50)
    deaf = host.firmware.u

    host.firmware.fail_output(OutputFault.NONE)
    host.run(1)

    assert (deaf, host.firmware.u, host.states[-1].u_c) == (CODE, 0, 0)
    assert host.states[-1].flags & Flag.FAULT  # until SET_MODE


def test_four_writes_in_a_row_that_are_not_confirmed_are_no_fault() -> None:
    host = open_loop()
    for _ in range(5):
        host.firmware.fail_output(OutputFault.DEAF)
        host.run(UNCONFIRMED_TICKS - 1)
        host.firmware.fail_output(OutputFault.NONE)
        host.run(1)

    assert EventCode.OUTPUT_FAULT not in host.codes()
    assert host.states[-1].u_c == CODE


def test_after_a_reset_with_a_deaf_converter_u_c_is_all_that_it_may_give() -> None:
    host = open_loop()
    host.firmware.fail_output(OutputFault.DEAF)

    host.request("RESET")
    host.run(BOOT_TICKS + 1 + UNCONFIRMED_TICKS, alive=False)

    assert host.firmware.u == CODE
    assert host.states[-1].u_c == COUNTS_MAX
    assert host.states[-1].flags & Flag.FAULT
    assert host.codes()[-2:] == [EventCode.RESET_COMMANDED, EventCode.OUTPUT_FAULT]


def test_set_mode_clears_the_fault_only_where_the_converter_answers() -> None:
    host = open_loop()
    host.firmware.fail_output(OutputFault.DEAF)
    host.run(10)

    host.request("SET_MODE", mode=2)
    again, flags = host.details(EventCode.OUTPUT_FAULT), host.states[-1].flags
    host.firmware.fail_output(OutputFault.NONE)
    host.request("SET_MODE", mode=1)

    assert again == [CODE, CODE]
    assert flags & (Flag.FAULT | 3) == Flag.FAULT | Mode.IDLE
    assert int(host.states[-1].flags) & (Flag.FAULT | 3) == int(Mode.OPEN_LOOP)


def test_a_step_of_a_capture_that_is_not_confirmed_ends_it() -> None:
    host = Host()
    host.request("CAPTURE", u_from=300, u_to=1700, pre=90, count=2000)
    host.run(9)
    host.firmware.fail_output(OutputFault.DEAF)
    host.run(3)
    before = host.states[-1].u_c  # 22 ms: the step is at 23.6
    host.run(20)
    refused = host.request("READ_CAPTURE", index=0)

    assert before == 300
    assert {state.u_c for state in host.states[-20:]} == {300}
    assert host.details(EventCode.OUTPUT_FAULT) == [300]
    assert refusal(refused)[0] == Reason.NOT_AVAILABLE


# A current that nobody ordered


def test_a_current_while_u_c_is_0_is_a_fault() -> None:
    bench = Bench(i_a=TEST_CURRENT_A)
    host = Host(bench)
    host.run(UNCOMMANDED_TICKS - 1)
    before = host.codes()

    host.run(1)

    assert EventCode.UNCOMMANDED_CURRENT not in before
    assert host.details(EventCode.UNCOMMANDED_CURRENT) == [2048]
    assert host.states[-1].flags & Flag.FAULT


def test_a_driver_that_is_shorted_is_told_although_another_fault_came_first() -> None:
    bench = Bench()
    host = open_loop(bench)
    bench.i_a = 5.0
    host.run(50 + UNCOMMANDED_TICKS + 2)

    faults = [code for code in host.codes() if code != EventCode.MODE_CHANGED]

    assert faults[-2:] == [EventCode.OVER_CURRENT, EventCode.UNCOMMANDED_CURRENT]


@pytest.mark.parametrize(("i_a", "u"), [(0.24, 0), (TEST_CURRENT_A, CODE)])
def test_neither_a_small_current_nor_one_that_was_ordered_is(i_a: float, u: int) -> None:
    host = open_loop(Bench(i_a=i_a)) if u else Host(Bench(i_a=i_a))

    host.run(3 * UNCOMMANDED_TICKS)

    assert EventCode.UNCOMMANDED_CURRENT not in host.codes()


# Stored settings


@pytest.mark.parametrize(
    ("stored", "field"),
    [
        (Settings(gains=replace(GAINS, law=7), limits=LIMITS), 1),
        (Settings(gains=replace(GAINS, mantissas=(1, -32768, 1, 1)), limits=LIMITS), 4),
        (Settings(gains=replace(GAINS, shifts=(1, 1, 1, 200)), limits=LIMITS), 9),
        (Settings(gains=replace(GAINS, u_0=4096), limits=LIMITS), 12),
        (settings(x_ref_min=3000, x_ref_max=2999), 14),
        (settings(x_ref_slew=0), 16),
        (settings(u_max=60000), 17),
    ],
)
def test_a_stored_setting_out_of_its_range_gives_way_to_those_of_the_program(stored: Settings, field: int) -> None:
    host = rebooted(stored)

    parameters = host.request("GET_PARAMETERS")

    assert host.details(EventCode.SETTINGS_REJECTED) == [field]
    assert host.codes()[-2:] == [EventCode.RESET_COMMANDED, EventCode.SETTINGS_REJECTED]
    assert parameters.int("k2_mantissa") == CE152_BOARD.gains.mantissas[1]
    assert parameters.int("u_max") == CE152_BOARD.limits.u_max


def test_stored_settings_within_their_ranges_are_in_force() -> None:
    host = rebooted(settings(u_max=3000))

    assert host.request("GET_PARAMETERS").int("u_max") == 3000
    assert EventCode.SETTINGS_REJECTED not in host.codes()


@pytest.mark.parametrize("seed", range(40))
def test_whatever_a_memory_holds_parameters_is_a_frame_that_every_host_accepts(seed: int) -> None:
    stored = random_settings(random.Random(seed))
    host = rebooted(stored)  # any frame that the decoder refuses fails in there

    parameters = host.request("GET_PARAMETERS").values

    ranges = {field.name: (field.low, field.high) for field in ROW_OF_NAME["PARAMETERS"].fields}
    for name, value in parameters.items():
        low, high = ranges[name]
        assert isinstance(value, int)
        assert low is not None
        assert high is not None
        assert low <= value <= high, name
    assert int(parameters["x_ref_min"]) <= int(parameters["x_ref_max"])
    is_restored = (parameters["x_ref_min"], parameters["k1_shift"]) == (stored.limits.x_ref_min, stored.gains.shifts[0])
    assert is_restored != (EventCode.SETTINGS_REJECTED in host.codes())


def rebooted(stored: Settings) -> Host:
    """A host whose board has these settings in its memory and was reset, with a session."""
    host = Host()
    host.firmware.store(stored)
    host.request("RESET")
    host.run(BOOT_TICKS + 1, alive=False)
    host.hello(2)
    return host


def test_idle_in_idle_after_a_capture_leaves_what_a_deaf_converter_confirmed() -> None:
    host = Host()
    host.request("CAPTURE", u_from=0, u_to=900, pre=1, count=20)
    host.run(20)
    assert host.states[-1].u_c == 0
    host.firmware.fail_output(OutputFault.DEAF)

    host.request("SET_MODE", mode=0)

    assert host.states[-1].u_c == 0


def test_a_reference_in_open_loop_does_not_end_the_signal_of_the_input() -> None:
    host = open_loop()
    host.request("EXCITE", shape=2, target=0, offset=CODE, **(QUIET | {"amplitude": 50, "period": 10}))
    host.run(10)

    assert host.request("SET_REFERENCE", x_ref=2034).name == "ACK"

    assert {state.u_c for state in host.run(20)} == {CODE - 50, CODE + 50}


@pytest.mark.parametrize(("count", "details"), [(511, []), (512, [512])])
def test_a_current_is_uncommanded_from_an_eighth_of_its_range_on(count: int, details: list[int]) -> None:
    host = Host(Bench(i_a=CURRENT.to_si(count)))

    host.run(UNCOMMANDED_TICKS + 2)

    assert host.details(EventCode.UNCOMMANDED_CURRENT) == details
