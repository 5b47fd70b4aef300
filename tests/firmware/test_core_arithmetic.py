"""The arithmetic of the page, in C: against its formulas in Python's unlimited integers."""

from __future__ import annotations

import math

import numpy as np
from hypothesis import example, given, settings
from hypothesis import strategies as st

from gateway.emulator.firmware_model.arithmetic import divide_rounded, saturate, scaled_product, sine_q15
from gateway.emulator.firmware_model.excitation import Excitation, Signal
from protocol.wire.messages import Shape
from tests.harness.firmware.core import Core

INT32 = st.integers(-(1 << 31), (1 << 31) - 1)
INT32_MIN, INT32_MAX = -(1 << 31), (1 << 31) - 1


@given(value=INT32, bits=st.integers(0, 31))
def test_a_shift_rounds_down(core: Core, value: int, bits: int) -> None:
    assert core.c.b51_shift_down(value, bits) == value >> bits


@given(a=INT32, b=INT32)
@example(INT32_MAX, 1)
@example(INT32_MIN, -1)
@example(INT32_MIN, INT32_MIN)
@example(0, INT32_MIN)
def test_sums_saturate(core: Core, a: int, b: int) -> None:
    assert core.c.b51_saturated_sum(a, b) == saturate(a + b, 32)
    assert core.c.b51_saturated_difference(a, b) == saturate(a - b, 32)


@settings(max_examples=300)
@given(mantissa=st.integers(-32767, 32767), shift=st.integers(0, 30), operand=st.integers(-(1 << 23), (1 << 23) - 1))
@example(32767, 0, -(1 << 23))
@example(-32767, 0, (1 << 23) - 1)
@example(-1, 30, 1)
def test_a_product_of_40_bits_is_shifted_and_saturated(core: Core, mantissa: int, shift: int, operand: int) -> None:
    assert core.c.b51_scaled_product(mantissa, shift, operand) == scaled_product(mantissa, shift, operand)


@given(numerator=st.integers(-(1 << 29), 1 << 29), denominator=st.integers(1, 300_000))
def test_a_quotient_is_rounded_halves_upwards(core: Core, numerator: int, denominator: int) -> None:
    assert core.c.b51_divide_rounded(numerator, denominator) == divide_rounded(numerator, denominator)


@given(phase=st.integers(0, (1 << 32) - 1))
def test_the_sine_is_that_of_the_page(core: Core, phase: int) -> None:
    assert core.c.b51_sine_q15(phase) == sine_q15(phase)


def test_the_tables_are_what_the_page_says(core: Core) -> None:
    terms = np.array([[sine_q15(h * n * 2**22 - h * (h - 1) * 2**28) for n in range(1024)] for h in range(1, 9)])
    signs = np.array([[-1 if h > 1 and k >> h - 2 & 1 else 1 for h in range(1, 9)] for k in range(128)])

    assert list(core.sines) == [round(32767 * math.sin(math.tau * n / 256)) for n in range(257)]
    assert list(core.peaks) == np.abs(signs @ terms).max(axis=1).tolist()


signals = st.builds(
    Signal,
    shape=st.sampled_from(Shape),
    target=st.integers(0, 1),
    amplitude=st.integers(-2047, 2047),
    offset=st.just(2048),
    period=st.integers(1, 65535) | st.integers(1, 40),
    period_end=st.integers(1, 65535) | st.integers(1, 40),
    seed=st.integers(1, 65535),
    duration=st.integers(1, 400) | st.integers(1, (1 << 32) - 1),
)


@settings(max_examples=100)
@given(signal=signals)
def test_a_signal_is_that_of_python(core: Core, signal: Signal) -> None:
    excitation = Excitation(signal)
    expected = [excitation.next() for _ in range(300)]

    assert core.play(signal, 300) == expected
    assert core.c.b51_excitation_done() == excitation.has_ended


def test_a_long_chirp_downwards_keeps_its_phase(core: Core) -> None:
    """Its sweep is a quotient below 0, rounded down: rounding it up shows after some 90 000 ticks."""
    ticks = 150_000
    signal = Signal(
        shape=Shape.CHIRP, target=0, amplitude=2047, offset=2048, period=3, period_end=65535, seed=1, duration=ticks
    )
    excitation = Excitation(signal)

    assert core.play(signal, ticks) == [excitation.next() for _ in range(ticks)]
