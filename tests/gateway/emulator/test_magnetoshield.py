"""The emulated MagnetoShield: a magnet below a coil, a Hall sensor that sees the field, tables to linear counts."""

from __future__ import annotations

import statistics
from collections.abc import Mapping
from dataclasses import replace

import pytest

from firmware.sim.mcs51.board import Mcs51Board
from gateway.emulator.firmware_model.board import Firmware
from gateway.emulator.firmware_model.magnetoshield import magnetoshield
from gateway.emulator.native.board import NativeFirmware
from gateway.emulator.plant.magnetoshield import MAGNETOSHIELD, EmulatedMagnetoShield
from protocol.errors import UsageError
from protocol.wire.codec import encode_body
from protocol.wire.framing import encode_frame
from protocol.wire.messages import HostLoss, Mode, Value
from tests.harness.gateway.board_host import skip_without_compiler
from tests.harness.protocol.port import take_output

PROFILE = magnetoshield()
QUIET = replace(MAGNETOSHIELD, current_noise_a=0.0)


class Flight:
    """A board and its magnet, from the ground."""

    def __init__(self, board: Firmware | NativeFirmware, plant: EmulatedMagnetoShield) -> None:
        self.board, self.plant = board, plant
        self._id = 0
        self.send("HELLO", session=1, version_min=1, version_max=1)
        self.send("SET_HOST_LOSS", policy=int(HostLoss.KEEP), timeout=1000)
        self.send("SET_MODE", mode=int(Mode.CLOSED_LOOP))

    def send(self, name: str, **fields: Value) -> None:
        self._id += 1
        self.board.feed(encode_frame(encode_body(name, id=self._id, **fields)))

    def settle_at(self, x_m: float) -> float:
        """Mean of the true position, m, in the last half of a second."""
        self.send("SET_REFERENCE", x_ref=PROFILE.position.to_count(x_m))
        positions_m = []
        for _ in range(750):
            self.board.tick()
            take_output(self.board)
            positions_m.append(self.plant.x_m)
        return statistics.mean(positions_m[-250:])


@pytest.mark.parametrize("firmware", ["python", "c"])
def test_it_lifts_the_magnet_and_follows_references(firmware: str) -> None:
    if firmware == "c":
        skip_without_compiler()
    plant = EmulatedMagnetoShield(seed=1)
    make = Firmware if firmware == "python" else NativeFirmware
    flight = Flight(make(plant, profile=PROFILE), plant)

    for x_m in (2.5e-3, 4e-3, 1.5e-3):
        # What the board reads is x, but for the coil's field: 0.4 mm/A in mid-travel, less below and more above.
        assert flight.settle_at(x_m) == pytest.approx(x_m, abs=2e-5)
    assert flight.board.mode == Mode.CLOSED_LOOP


def test_the_coil_carries_the_magnet_as_published() -> None:
    # K i / gap^4 = m g with the numbers of the authors' identification.
    at_14_mm = 7.34483e-4 * 9.81 * 14e-3**4 / 1.50849e-8

    assert MAGNETOSHIELD.equilibrium_current_a(3e-3) == pytest.approx(at_14_mm, rel=1e-6)
    plant = EmulatedMagnetoShield(QUIET)
    for factor, is_lifted in ((0.98, False), (1.02, True)):
        plant.set_state(3e-3)
        volts = factor * MAGNETOSHIELD.equilibrium_input_v(3e-3)
        plant.set_state(3e-3, i_c_a=volts * MAGNETOSHIELD.amplifier_gain_a_v)
        plant.advance(PROFILE.input_pin(PROFILE.input.to_count(volts)), 0.02)
        assert (plant.v_m_s > 0.0) == is_lifted


def test_counts_of_u_are_linear_in_the_voltage_of_the_coil() -> None:
    for count in (1, 40, 400, 1686, 3000, 4095):
        plant = EmulatedMagnetoShield(QUIET)
        plant.advance(PROFILE.input_pin(count), 0.02)
        volts = plant.i_c_a / MAGNETOSHIELD.amplifier_gain_a_v
        # A code of the converter is 2 to 3 mV; the driver is off below 30 mV, so the table's first line is steeper.
        assert volts == pytest.approx(PROFILE.input.to_si(count), abs=0.004 if count > 64 else 0.035)
    plant.advance(PROFILE.input_pin(0), 0.1)
    assert plant.i_c_a < 1e-9


def test_counts_of_x_are_linear_within_a_code_of_the_converter() -> None:
    plant = EmulatedMagnetoShield(QUIET)
    for tenths in range(51):
        x_m = tenths * 1e-4
        plant.set_state(x_m)
        read = [PROFILE.position.to_si(PROFILE.position_count(plant.sense()[1])) for _ in range(60)]
        # A code is 5 um on the ground and 17 um at the top; 1 gauss of noise is a third of it.
        assert statistics.mean(read) == pytest.approx(x_m, abs=1.5e-5)


def test_the_coil_shows_in_the_position_and_a_magnet_upside_down_at_the_top() -> None:
    plant = EmulatedMagnetoShield(QUIET)
    plant.set_state(2.5e-3)
    without = statistics.mean(plant.sense()[1] for _ in range(400))
    plant.set_state(2.5e-3, i_c_a=0.05)
    gauss = 800.0 * (without - statistics.mean(plant.sense()[1] for _ in range(400)))

    assert gauss == pytest.approx(0.05 * 108.0, abs=0.4)
    assert PROFILE.position_count(3.3) == 4095
    assert PROFILE.position_count(0.0) == 0


@pytest.mark.parametrize("effects", [{"position-sensor-offset": 2e-4}, {"position-sensor-gain": 0.9}])
def test_an_effect_on_the_position_shows_in_the_counts(effects: Mapping[str, float]) -> None:
    plain, changed = EmulatedMagnetoShield(QUIET), EmulatedMagnetoShield(QUIET, effects)
    for plant in (plain, changed):
        plant.set_state(2.5e-3)
    x, y = (
        statistics.mean(PROFILE.position.to_si(PROFILE.position_count(plant.sense()[1])) for _ in range(200))
        for plant in (plain, changed)
    )

    expected = 2e-4 if "position-sensor-offset" in effects else -0.1 * 2.5e-3
    assert y - x == pytest.approx(expected, abs=1.5e-5)


def test_there_is_no_8051_for_it() -> None:
    with pytest.raises(UsageError, match="8051 has no firmware"):
        Mcs51Board(EmulatedMagnetoShield(), profile=PROFILE)
