"""Faults between plant and pins, and a wrong clock: each is what its name says, and ends when it should."""

from __future__ import annotations

import statistics

import pytest

from gateway.emulator.faults import parse
from gateway.emulator.firmware_model.board import Firmware
from gateway.emulator.firmware_model.flash import CE152_BOARD, BoardProfile
from gateway.emulator.firmware_model.magnetoshield import magnetoshield
from gateway.emulator.line import BoardLine
from gateway.emulator.plant.levitation import EmulatedPlant
from gateway.emulator.plant.magnetoshield import EmulatedMagnetoShield
from gateway.emulator.wiring import FaultyWiring
from protocol.wire.messages import COUNTS_MAX
from tests.harness.gateway.selftest_bench import MemoryPort


def _wired(plant: EmulatedPlant, profile: BoardProfile, *faults: str) -> FaultyWiring:
    wiring = FaultyWiring(plant, profile, seed=1)
    wiring.follow([parse(text) for text in faults])
    return wiring


def _counts(*faults: str, u_v: float = 0.0, ticks: int = 200) -> tuple[list[int], list[int]]:
    """Counts of i_c and x of a CE 152 whose input is held."""
    wiring = _wired(EmulatedPlant(seed=1), CE152_BOARD, *faults)
    wiring.advance(u_v, 0.02)
    i, x = [], []
    for _ in range(ticks):
        wiring.advance(u_v, 0.002)
        i_pin, x_pin = wiring.sense()
        i.append(CE152_BOARD.current_count(i_pin))
        x.append(CE152_BOARD.position_count(x_pin))
    return i, x


def test_without_a_fault_nothing_changes() -> None:
    plant, wiring = EmulatedPlant(seed=3), _wired(EmulatedPlant(seed=3), CE152_BOARD)

    for _ in range(50):
        plant.advance(2.0, 0.002)
        wiring.advance(2.0, 0.002)

    assert [plant.sense() for _ in range(9)] == [wiring.sense() for _ in range(9)]


def test_wires_that_are_open_or_swapped() -> None:
    good_i, good_x = _counts(u_v=2.0)

    assert max(_counts("coil-open", u_v=2.0)[0]) < 20 < min(good_i)
    assert set(_counts("i-unplugged", u_v=2.0)[0]) == {0}
    assert set(_counts("x-unplugged")[1]) == {0}
    assert len(set(_counts("x-frozen")[1])) == 1
    mirrored = statistics.fmean(_counts("x-inverted", u_v=2.0)[1])
    assert mirrored + statistics.fmean(good_x) == pytest.approx(COUNTS_MAX, abs=1.5)


def test_a_bit_is_stuck_and_noise_has_its_size() -> None:
    assert all(count & 32 for count in _counts("i-bit=5", u_v=2.0)[0])
    assert statistics.stdev(_counts("x-noise=40", u_v=2.0, ticks=2000)[1]) == pytest.approx(40.0, rel=0.2)


@pytest.mark.parametrize(("faults", "lifts"), [((), True), (("coil-reversed",), False)])
def test_a_reversed_coil_pushes_a_magnet_down(faults: tuple[str, ...], lifts: bool) -> None:
    plant = EmulatedMagnetoShield(seed=1)

    _wired(plant, magnetoshield(), *faults).advance(4000.0, 0.1)

    assert (plant.x_m > 1e-3) == lifts
    assert plant.i_c_a > 0.04


def test_a_fault_that_ends_leaves_nothing_behind() -> None:
    plant = EmulatedMagnetoShield(seed=1)
    wiring = _wired(plant, magnetoshield(), "coil-reversed", "x-unplugged")

    wiring.follow([])
    wiring.advance(4000.0, 0.1)

    assert plant.x_m > 1e-3
    assert wiring.sense()[1] > 0.0


@pytest.mark.parametrize("rate", [0.97, 1.0, 1.02])
def test_a_wrong_clock_runs_more_or_fewer_ticks(rate: float) -> None:
    port = MemoryPort()
    line = BoardLine(Firmware(EmulatedPlant()), port, faults=[parse(f"crystal={rate}")])

    for _ in range(1000):
        line.step()

    assert line.time_s == pytest.approx(2.0 * rate, abs=0.003)
