"""'Behaviour of the board' in protocol/README.md, rules 14 to 16: counts, refused frames, events, numbers."""

from __future__ import annotations

from itertools import pairwise

import pytest

from gateway.emulator.firmware_model.flash import CURRENT, POSITION
from protocol.wire.decoder import StreamDecoder
from protocol.wire.framing import encode_frame
from protocol.wire.messages import EventCode, Flag, Message, Reason
from tests.harness.gateway.board_host import QUIET, SECOND, Bench, Host, frame, refusal
from tests.harness.protocol.port import take_output

pytestmark = pytest.mark.usefixtures("each_firmware")


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


# Rule 15 (bounds and modes: test_firmware_commands.py)


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
    host.request("SET_MODE", mode=2)

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
    host.request("SET_MODE", mode=2)
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
        host.request("SET_MODE", mode=1 - n % 2)

    numbers = [event.int("number") for event in host.events]

    assert numbers == [n % 256 for n in range(len(numbers))]
    assert len(numbers) > 256


def test_the_tick_wraps_after_32_bits_and_the_sequence_after_16() -> None:
    host = Host()
    host.firmware.next_tick = 2**32 - 2

    states = host.run(3)
    answer = host.request("SET_STREAM", divider=1)

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
