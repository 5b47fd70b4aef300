"""'Behaviour of the board' in protocol/README.md, rule 12: the capture of a step at 25 kHz."""

from __future__ import annotations

from itertools import pairwise

import pytest

from gateway.emulator.firmware_model.flash import BOOT_TICKS, CURRENT, INPUT, WATCHDOG_TICKS
from gateway.emulator.plant.levitation import EmulatedPlant
from protocol.wire.codec import unpack_pair
from protocol.wire.messages import EventCode, Mode, Reason
from tests.harness.gateway.board_host import QUIET, Bench, Host, frame, open_loop, refusal

pytestmark = pytest.mark.usefixtures("each_firmware")


# Rule 12


def test_rule_12_a_capture_records_the_step_at_25_khz() -> None:
    plant = EmulatedPlant()
    host = Host(plant)
    u_from, u_to, pre, count = 400, 1600, 30, 200

    answer = host.request("CAPTURE", u_from=u_from, u_to=u_to, pre=pre, count=count)
    host.run(20)
    samples: list[int] = []
    blocks = []
    for index in range(0, count, 32):
        block = host.request("READ_CAPTURE", index=index)
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

    host.request("CAPTURE", u_from=400, u_to=1600, pre=10, count=75)
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

    host.request("CAPTURE", u_from=100, u_to=200, pre=50, count=100)
    states = host.run(20)

    assert [state.u_c for state in states] == [100] * 10 + [200] + [0] * 9
    assert [b.sequence - a.sequence for a, b in pairwise(states)] == [1] * 19


def test_rule_12_what_would_disturb_a_capture_is_refused() -> None:
    host = Host()
    host.request("SET_MODE", mode=1)
    host.request("CAPTURE", u_from=100, u_to=200, pre=50, count=2000)

    for name, fields in (
        ("EXCITE", {"shape": 0, "target": 0, "offset": 1, **QUIET}),
        ("SET_MODE", {"mode": 2}),
        ("CAPTURE", {"u_from": 0, "u_to": 0, "pre": 0, "count": 1}),
        ("READ_CAPTURE", {"index": 0}),
    ):
        assert refusal(host.request(name, **fields)) == (Reason.BUSY, 0)
    host.request("SET_MODE", mode=0)

    assert host.states[-1].u_c == 0
    assert refusal(host.request("READ_CAPTURE", index=0)) == (Reason.NOT_AVAILABLE, 0)


def test_rule_12_a_capture_needs_idle_or_open_loop_and_has_an_end() -> None:
    host = Host()
    never = host.request("READ_CAPTURE", index=0)
    host.request("CAPTURE", u_from=0, u_to=0, pre=0, count=33)
    host.run(15)
    past_end = host.request("READ_CAPTURE", index=33)
    last = host.request("READ_CAPTURE", index=32)
    host.request("SET_MODE", mode=2)

    closed = host.request("CAPTURE", u_from=0, u_to=0, pre=0, count=1)

    assert refusal(never) == refusal(past_end) == (Reason.NOT_AVAILABLE, 0)
    assert last.name == "CAPTURE_BLOCK"
    assert refusal(closed) == (Reason.WRONG_MODE, Mode.CLOSED_LOOP)


def test_rule_12_a_capture_that_ended_before_a_stop_can_be_read() -> None:
    host = Host()
    host.request("CAPTURE", u_from=0, u_to=100, pre=0, count=1)
    host.run(10)

    host.firmware.feed(frame("STOP", id=99), into_tick_us=700)  # the sample's 40 us are over
    host.run(1, alive=False)

    assert host.codes()[-1] == EventCode.CAPTURE_DONE
    assert host.request("READ_CAPTURE", index=0).name == "CAPTURE_BLOCK"


def test_rule_12_a_capture_that_hangs_holds_its_input_until_the_watchdog_resets_the_board() -> None:
    bench = Bench()
    host = Host(bench)
    host.request("CAPTURE", u_from=100, u_to=200, pre=0, count=20)
    host.run(5)

    host.firmware.hang()
    bench.inputs.clear()
    host.run(WATCHDOG_TICKS, alive=False)
    held = {u for u, _ in bench.inputs}
    host.run(BOOT_TICKS + 1, alive=False)

    assert held == {INPUT.to_si(100)}
    assert EventCode.CAPTURE_DONE not in host.codes()
    assert bench.inputs[-1][0] == 0.0
