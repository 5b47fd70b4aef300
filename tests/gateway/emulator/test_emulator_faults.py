"""Link faults: each one visible, none of them more than it says; and the syntax of --fault."""

from __future__ import annotations

import contextlib
import random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gateway.emulator.faults import CLOCK, CODES, EVENTS, HELP, OUTPUTS, RATES, SPANS, WIRING, Fault, FaultyLine, parse
from protocol.errors import UsageError

NAMES = RATES | SPANS | OUTPUTS | WIRING | CODES | CLOCK | EVENTS
DATA = random.Random(5).randbytes(20_000)


def conveyed(text: str, *, time_s: float = 0.0, data: bytes = DATA, direction: str = "tx", seed: int = 1) -> bytes:
    return FaultyLine(direction, seed).convey(data, time_s, [parse(text)])


@pytest.mark.parametrize(
    ("text", "fault"),
    [
        ("flip=1e-4", Fault(name="flip", value=1e-4)),
        ("lost=0.01@5+2", Fault(name="lost", value=0.01, start_s=5, length_s=2)),
        ("stall=0.5@10/30", Fault(name="stall", value=0.5, start_s=10, every_s=30)),
        ("disconnect=2@20:renamed", Fault(name="disconnect", value=2, start_s=20, option="renamed")),
        ("reset@60", Fault(name="reset", start_s=60)),
        ("x-inverted@1+2", Fault(name="x-inverted", start_s=1, length_s=2)),
        ("i-bit=5", Fault(name="i-bit", value=5)),
        (" insert=1e-3:tx ", Fault(name="insert", value=1e-3, option="tx")),
        ("flip=1e-3@1e1+1e-1/2:rx", Fault(name="flip", value=1e-3, start_s=10, length_s=0.1, every_s=2, option="rx")),
    ],
)
def test_the_syntax(text: str, fault: Fault) -> None:
    assert parse(text) == fault


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("", "form"),
        ("flip", "needs a value"),
        ("flip=", "form"),
        ("flip=x", "is not a number"),
        ("flip=-1", "not negative"),
        ("flip=nan", "finite"),
        ("flip=1.5", "at most 1"),
        ("flood=1", "no fault is called flood"),
        ("reset=1@5", "takes no value"),
        ("stall=1@5+3", "LENGTH"),
        ("stall=2@5/1", "EVERY"),
        ("reset@5:tx", "no option tx"),
        ("flip=1:up", "no option up"),
        ("x-inverted=1", "takes no value"),
        ("x-inverted:tx", "no option tx"),
        ("x-bit", "needs a value"),
        ("x-bit=1.5", "whole number"),
        ("crystal=3", "0.5 to 2"),
        ("deaf=1@2+3", "LENGTH"),
        ("flip=1e-4@5@6", "is not a number"),
    ],
)
def test_a_bad_fault_says_what_is_wrong_with_it(text: str, why: str) -> None:
    with pytest.raises(UsageError, match=why) as caught:
        parse(text)

    assert "--help" in caught.value.remedy


def test_every_fault_is_in_the_help() -> None:
    assert all(name in HELP for name in NAMES)


@given(text=st.text(alphabet="flipost=@+/:0123456789.-eE ", max_size=20))
def test_no_text_makes_the_parser_fail(text: str) -> None:
    with contextlib.suppress(UsageError):
        assert parse(text).name in NAMES


@pytest.mark.parametrize("direction", ["tx", "rx"])
def test_flip_inverts_one_bit_of_that_many_bytes(direction: str) -> None:
    out = conveyed("flip=0.02", direction=direction)

    changed = [a ^ b for a, b in zip(DATA, out, strict=True) if a != b]
    assert all(bits.bit_count() == 1 for bits in changed)
    assert abs(len(changed) - 400) < 4 * (400 * 0.98) ** 0.5  # binomial, four sigma


@pytest.mark.parametrize(("name", "sign"), [("lost", -1), ("duplicate", 1), ("insert", 1)])
def test_bytes_are_lost_doubled_and_inserted_at_their_rate(name: str, sign: int) -> None:
    out = conveyed(f"{name}=0.02")

    assert abs((len(out) - len(DATA)) * sign - 400) < 4 * (400 * 0.98) ** 0.5
    if sign > 0:
        remaining = iter(out)
        assert all(byte in remaining for byte in DATA)  # a subsequence: nothing else was touched
    else:
        remaining = iter(DATA)
        assert all(byte in remaining for byte in out)


def test_all_bytes_are_doubled_at_probability_1() -> None:
    assert conveyed("duplicate=1", data=b"abc") == b"aabbcc"


def test_a_wrong_baud_rate_makes_garbage() -> None:
    out = conveyed("baud=1")

    assert 0.5 * len(DATA) < len(out) < 0.9 * len(DATA)
    assert abs(sum(out) / len(out) - 127.5) < 4 * 74 / len(out) ** 0.5  # uniform: standard deviation 74


def test_a_stall_holds_bytes_back_and_lets_them_through_in_a_burst() -> None:
    line, faults = FaultyLine("tx", 1), [parse("stall=0.5@1")]

    out = [line.convey(bytes((n,)), n * 0.1, faults) for n in range(20)]

    assert out[:10] == [bytes((n,)) for n in range(10)]
    assert out[10:15] == [b""] * 5
    assert out[15] == bytes(range(10, 16))
    assert b"".join(out) == bytes(range(20))
    assert line.damaged == 0


def test_a_disconnected_line_loses_what_is_sent() -> None:
    line, faults = FaultyLine("tx", 1), [parse("disconnect=0.5@1")]

    out = b"".join(line.convey(bytes((n,)), n * 0.1, faults) for n in range(20))

    assert out == bytes([*range(10), *range(15, 20)])
    assert line.damaged == 5


@pytest.mark.parametrize(("option", "touched"), [(":tx", "tx"), (":rx", "rx")])
def test_an_option_limits_a_fault_to_one_direction(option: str, touched: str) -> None:
    for direction in ("tx", "rx"):
        out = conveyed(f"lost=1{option}", direction=direction)
        assert (out == b"") == (direction == touched)


@pytest.mark.parametrize(
    ("text", "active"),
    [
        ("lost=1@2", {2, 3, 4, 5, 6, 7, 8, 9}),
        ("lost=1@2+3", {2, 3, 4}),
        ("lost=1@2+2/4", {2, 3, 6, 7}),
        ("stall=1@2/3", {2, 5, 8}),
    ],
)
def test_when_a_fault_is_active(text: str, active: set[int]) -> None:
    fault = parse(text)

    assert {s for s in range(10) if fault.active(s + 0.5)} == active


def test_an_event_happens_in_exactly_one_tick_each_time() -> None:
    fault = parse("reset@0.1/0.25")

    ticks = [n for n in range(1000) if fault.happens((n - 0.5) * 0.002, (n + 0.5) * 0.002)]

    assert ticks == [50, 175, 300, 425, 550, 675, 800, 925]


def test_the_same_seed_makes_the_same_damage_and_another_seed_does_not() -> None:
    assert conveyed("flip=0.1", seed=3) == conveyed("flip=0.1", seed=3)
    assert conveyed("flip=0.1", seed=3) != conveyed("flip=0.1", seed=4)
    assert conveyed("flip=0.1", direction="tx") != conveyed("flip=0.1", direction="rx")
