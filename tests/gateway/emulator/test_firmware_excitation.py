"""Rule 8: the shapes, compared with their definitions in floating point."""

from __future__ import annotations

import cmath
import math
from itertools import pairwise

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gateway.emulator.firmware_model.excitation import Excitation, Signal
from protocol.wire.messages import Shape

OFFSET = 1700


def played(shape: Shape, ticks: int, **fields: int) -> list[int]:
    """The shape alone, offset taken off."""
    values = {"target": 0, "amplitude": 300, "offset": OFFSET, "period": 40, "period_end": 1, "seed": 1, "duration": 0}
    excitation = Excitation(Signal(shape=shape, **(values | fields)))
    return [excitation.next() - OFFSET for _ in range(ticks)]


def test_none_is_its_offset() -> None:
    assert played(Shape.NONE, 50) == [0] * 50


@pytest.mark.parametrize("amplitude", [300, -300])
def test_step_comes_after_one_period(amplitude: int) -> None:
    assert played(Shape.STEP, 100, amplitude=amplitude) == [0] * 40 + [amplitude] * 60


@pytest.mark.parametrize(("period", "high"), [(40, 20), (5, 3), (1, 1)])
def test_rectangle_is_high_while_s_mod_p_is_below_half(period: int, high: int) -> None:
    expected = ([300] * high + [-300] * (period - high)) * 3

    assert played(Shape.RECTANGLE, 3 * period, period=period) == expected


@pytest.mark.parametrize("amplitude", [300, -300])
def test_sawtooth_rises_linearly_from_minus_to_plus_amplitude(amplitude: int) -> None:
    wave = played(Shape.SAWTOOTH, 240, period=80, amplitude=amplitude)

    for s, value in enumerate(wave):
        assert abs(value - amplitude * (2 * (s % 80) / 80 - 1)) <= 0.5 + 1e-9


def test_prbs_is_the_15_bit_register_of_the_page() -> None:
    seed, chips, period = 12345, 400, 3
    register, expected = seed % 32767 + 1, []
    for _ in range(chips):
        expected += [300 if register & 0x4000 else -300] * period
        register = (register << 1 | (register >> 14 ^ register >> 13) & 1) & 0x7FFF

    assert played(Shape.PRBS, chips * period, period=period, seed=seed) == expected


def test_prbs_runs_through_all_32767_states() -> None:
    wave = played(Shape.PRBS, 2 * 32767, period=1, amplitude=1)

    assert wave[:32767] == wave[32767:]
    assert sum(wave[:32767]) == 1  # a maximal sequence has one 1 more than 0


@pytest.mark.parametrize("seed", [1, 77, 500, 65535])
def test_multisine_has_eight_equal_harmonics_and_the_peak_asked_for(seed: int) -> None:
    period = 512
    wave = played(Shape.MULTISINE, 2 * period, period=period, amplitude=1000, seed=seed)

    spectrum = [
        abs(sum(wave[n] * cmath.exp(-2j * math.pi * h * n / period) for n in range(period))) * 2 / period
        for h in range(12)
    ]
    assert wave[:period] == wave[period:]
    # The peak lies between two samples: at harmonic 8, half a sample costs (pi 8 / 512)^2 / 2 of 1000 at most.
    assert 1000 - 1000 * (math.pi * 8 / period) ** 2 / 2 - 1 <= max(map(abs, wave)) <= 1000
    # Rounding to counts: 1/sqrt(12) per sample, in a mean over 512 samples 0.02; eight sigma.
    assert max(spectrum[1:9]) - min(spectrum[1:9]) < 0.2
    assert max(spectrum[9:]) < 0.2
    assert spectrum[1] > 1000 / 8  # no worse than eight peaks on top of each other


def test_multisines_of_different_seeds_differ() -> None:
    waves = {tuple(played(Shape.MULTISINE, 64, period=64, seed=seed)) for seed in range(1, 200)}

    assert len(waves) == 199


def test_chirp_sweeps_linearly_in_frequency() -> None:
    period, period_end, duration = 200, 10, 3000
    wave = played(
        Shape.CHIRP, duration, period=period, period_end=period_end, duration=duration, amplitude=1000, offset=OFFSET
    )

    f_0, f_1 = 1 / period, 1 / period_end
    for s, value in enumerate(wave):
        # s (s - 1) / 2: the frequency grows once per tick.  Table and rounding: 1000 * 1.5e-4 + 0.5, and 1000 * 2 pi *
        # duration * 2^-32 of phase from the increments' own rounding.
        phase = f_0 * s + (f_1 - f_0) * s * (s - 1) / 2 / duration
        assert abs(value - 1000 * math.sin(math.tau * phase)) < 0.75
    crossings = [n for n, (a, b) in enumerate(pairwise(wave)) if a < 0 <= b]
    assert crossings[-1] - crossings[-2] == pytest.approx(period_end, abs=1)


@settings(max_examples=150, deadline=None)
@given(
    shape=st.sampled_from(Shape),
    amplitude=st.integers(-2000, 2000),
    period=st.integers(1, 65535),
    period_end=st.integers(1, 65535),
    seed=st.integers(1, 65535),
    duration=st.integers(1, 150),
)
def test_no_signal_leaves_its_amplitude_and_all_end_at_the_offset(
    shape: Shape, amplitude: int, period: int, period_end: int, seed: int, duration: int
) -> None:
    wave = played(shape, 160, amplitude=amplitude, period=period, period_end=period_end, seed=seed, duration=duration)

    assert max(map(abs, wave)) <= abs(amplitude)
    assert wave[duration:] == [0] * (160 - duration)
