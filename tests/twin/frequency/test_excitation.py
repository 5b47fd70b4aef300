"""The excited parts of a flight are found from the reference alone."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tests.harness.twin.linear_loops import chirp, multisine
from twin.frequency.excitation import Part, parts

LSB, TRAVEL = 1.4e-6, 5.7e-3
Array = NDArray[np.float64]


def counted(*pieces: Array) -> Array:
    return np.asarray(np.round((2.85e-3 + np.concatenate(pieces)) / LSB) * LSB)


def find_parts(x_ref: Array, usable: NDArray[np.bool_] | None = None) -> list[Part]:
    known = np.ones(len(x_ref), np.bool_) if usable is None else usable
    return parts(x_ref, known, 2e-3, TRAVEL, lsb=LSB)


def test_two_multisines_one_after_the_other_with_rests_around_them() -> None:
    rest, first, second = np.zeros(500), multisine(4000, period=500, amplitude=2e-4), np.zeros(700)
    x_ref = counted(rest, first, second, multisine(2500, period=125, amplitude=1e-4))

    slow_part, fast_part = find_parts(x_ref)

    assert (slow_part.period, fast_part.period) == (500, 125)
    assert abs(slow_part.samples.start - 500) <= 1
    assert abs(slow_part.samples.stop - 4500) <= 1
    assert abs(fast_part.samples.start - 5200) <= 1
    assert fast_part.samples.stop == len(x_ref)


def test_a_rectangle_is_periodic_and_a_chirp_is_not() -> None:
    rectangle = np.where(np.arange(3000) % 500 < 250, 2e-4, -2e-4)

    assert [part.period for part in find_parts(counted(rectangle))] == [500]
    (part,) = find_parts(counted(np.zeros(400), chirp(5000, from_hz=0.5, to_hz=10.0, amplitude=2e-4), np.zeros(400)))
    assert part.period == 0
    assert 390 <= part.samples.start <= 420
    assert 5380 <= part.samples.stop <= 5410


def test_no_part_where_the_reference_rests_swings_widely_or_flight_is_interrupted() -> None:
    assert find_parts(counted(np.zeros(4000))) == []
    assert find_parts(counted(multisine(4000, period=500, amplitude=1.5e-3))) == []
    wave = counted(multisine(4000, period=500, amplitude=2e-4))
    usable = np.ones(len(wave), np.bool_)
    usable[1000::1000] = False
    assert find_parts(wave, usable) == []
