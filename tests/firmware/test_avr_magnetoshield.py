"""The image for a MagnetoShield: its tables are those of the profile, and it flies the emulated one."""

from __future__ import annotations

import statistics
from pathlib import Path

import pytest

from firmware.sim.avr.board import CYCLES_PER_TICK, AvrBoard
from firmware.sim.avr.build import compile_image
from gateway.emulator.firmware_model.magnetoshield import header, magnetoshield
from gateway.emulator.native.build import build_of_sources
from gateway.emulator.native.flags import SOURCES, flags
from gateway.emulator.plant.magnetoshield import EmulatedMagnetoShield
from protocol.wire.messages import EventCode, HostLoss, Mode
from tests.harness.firmware.avr_bench import AvrHost, skip_without_avr

PROFILE = magnetoshield()


def test_the_header_of_the_image_has_the_numbers_of_the_profile() -> None:
    assert (SOURCES / "avr" / PROFILE.program).read_text(encoding="utf-8") == header(PROFILE)


def test_it_compiles_without_a_warning(tmp_path: Path) -> None:
    skip_without_avr()

    compile_image(tmp_path / "avr.elf", profile=PROFILE.program, options=flags("WARNINGS"))


def test_the_image_alone_flies_the_magnet_within_its_ticks() -> None:
    skip_without_avr()
    plant = EmulatedMagnetoShield(seed=1)
    board = AvrBoard(plant, profile=PROFILE)
    board.store(b"\xff" * 80)  # a new chip: every number is that of the program
    board.reset(EventCode.RESET_POWER_ON)
    host = AvrHost(board)
    host.run(5)
    host.send("HELLO", session=1, version_min=1, version_max=1)
    host.send("SET_HOST_LOSS", policy=int(HostLoss.KEEP), timeout=1000)
    host.send("SET_MODE", mode=int(Mode.CLOSED_LOOP))
    for x_m in (2.5e-3, 4e-3):
        host.send("SET_REFERENCE", x_ref=PROFILE.position.to_count(x_m))
        host.run(400)
        positions_m = []
        for _ in range(200):
            host.run()
            positions_m.append(plant.x_m)
        assert abs(statistics.mean(positions_m) - x_m) < 2e-5

    identity = next(message for message in host.messages if message.name == "IDENTITY")
    assert identity.values["build"] == build_of_sources()
    assert identity.values["x_lsb"] == pytest.approx(PROFILE.position.lsb, rel=1e-6)
    assert max(host.cycles[1:]) < 0.9 * CYCLES_PER_TICK  # the first one is the start of the program
    assert board.stack_free >= 96
    assert host.bad_frames == 0
