"""A line in noise: found where there is one, and nowhere else, whatever the colour of the noise."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.signal import lfilter

from twin.estimation.periodogram import Periodogram, periodogram
from twin.estimation.record import FloatArray

STEP_S = 2e-3
LOWEST_HZ, HIGHEST_HZ = 10.0, 245.0
CHANCE = math.log(1e-4)


def noise(seed: int, *, coloured: float = 0.0) -> list[FloatArray]:
    rng = np.random.default_rng(seed)
    return [lfilter([1.0], [1.0, -coloured], rng.standard_normal(n)) for n in (4250, 4250, 3000, 1500)]


def log_chance(spectrum: Periodogram) -> float:
    in_band = (spectrum.frequency_hz > LOWEST_HZ) & (spectrum.frequency_hz < HIGHEST_HZ)
    return spectrum.log_chance(int(np.argmax(np.where(in_band, spectrum.share, 0.0))))


@pytest.mark.parametrize("coloured", [0.0, 0.8])
def test_no_line_is_found_in_noise(coloured: float) -> None:
    for seed in range(20):
        spectrum = periodogram(noise(seed, coloured=coloured), STEP_S)
        assert spectrum is not None
        assert log_chance(spectrum) > CHANCE, seed


@pytest.mark.parametrize("frequency_hz", [17.3, 50.003, 100.0])
def test_a_line_has_its_frequency_and_its_size(frequency_hz: float) -> None:
    stretches = [
        part + 0.3 * np.sin(2.0 * np.pi * (frequency_hz * STEP_S * np.arange(len(part)) + 0.3 * k))
        for k, part in enumerate(noise(1))
    ]

    spectrum = periodogram(stretches, STEP_S)

    assert spectrum is not None
    at = spectrum.line(LOWEST_HZ, HIGHEST_HZ)
    assert at is not None
    assert log_chance(spectrum) < CHANCE
    assert spectrum.frequency_hz[at] == pytest.approx(frequency_hz, abs=0.01)
    # 13 000 readings of noise 1 have an error of sqrt(2 / 13000) = 0.012; the power of the noise adds 4 %
    assert spectrum.amplitude(at) == pytest.approx(0.3, abs=0.04)


def test_short_stretches_have_no_spectrum() -> None:
    assert periodogram([np.ones(100)], STEP_S) is None


def test_missing_readings_change_neither_noise_nor_line() -> None:
    rng = np.random.default_rng(5)
    stretches = noise(5)
    for part in stretches:
        part[rng.random(len(part)) < 0.2] = np.nan
        part[300:500] = np.nan
    line = [part + 0.3 * np.sin(2.0 * np.pi * 50.0 * STEP_S * np.arange(len(part))) for part in stretches]

    without, with_line = periodogram(stretches, STEP_S), periodogram(line, STEP_S)

    assert without is not None
    assert with_line is not None
    assert log_chance(without) > CHANCE
    at = with_line.line(LOWEST_HZ, HIGHEST_HZ)
    assert at is not None
    assert with_line.frequency_hz[at] == pytest.approx(50.0, abs=0.01)
    assert with_line.amplitude(at) == pytest.approx(0.3, abs=0.04)
