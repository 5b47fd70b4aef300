"""An emulated rig of somebody's own: its file, and a board that flies it."""

from __future__ import annotations

from pathlib import Path

import pytest

from gateway.emulator.firmware_model.board import Firmware
from gateway.emulator.firmware_model.flash import GAINS, K_LQI, POSITION
from gateway.emulator.native.board import NativeFirmware
from gateway.emulator.own_rig import gains_of, load_rig, profile_of
from gateway.emulator.plant.constants import CE152
from gateway.emulator.serve import rig_of
from protocol.errors import Board51Error
from tests.harness.gateway.board_host import Host, skip_without_compiler
from tests.harness.gateway.heavy_rig import HEAVY_RIG

LIGHT = "[plant]\nmass_kg = 3e-3\ntravel_m = 3e-3\nx_max_m = 5e-3\n"


def file(folder: Path, text: str) -> Path:
    path = folder / "rig.toml"
    path.write_text(text)
    return path


def test_the_gains_of_a_ce_152_are_its_own() -> None:
    assert gains_of(CE152) == pytest.approx(K_LQI)
    profile = profile_of(CE152)
    assert profile.position == POSITION
    assert profile.gains.mantissas == GAINS.mantissas


@pytest.mark.parametrize("text", [HEAVY_RIG, LIGHT], ids=["heavy", "light"])
@pytest.mark.parametrize("make", [Firmware, NativeFirmware])
def test_another_ball_is_lifted_and_follows_references(
    make: type[Firmware] | type[NativeFirmware], text: str, tmp_path: Path
) -> None:
    if make is NativeFirmware:
        skip_without_compiler()
    plant_of, profile = rig_of(str(file(tmp_path, text)))
    plant = plant_of(seed=1)
    host = Host(plant, board=make(plant, profile=profile))
    travel_m = plant.rig.travel_m

    host.request("SET_MODE", mode=2)
    for share in (0.5, 0.75, 0.5, 0.2):
        assert host.request("SET_REFERENCE", x_ref=profile.position.to_count(share * travel_m)).name == "ACK"
        host.run(400)
        heights = [(host.run(1), plant.x_m)[1] for _ in range(100)]

        assert abs(sum(heights) / 100 - share * travel_m) < 2e-3 * travel_m


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("mass_kg = 20e-3", "mass_kg = 20"), "plant.mass_kg: 20 kg is outside .* You may mean 20 g"),
        (("x_max_m = 16e-3", ""), "plant.x_max_m = 0.012 is no more than 0.1 mm above the travel"),
        (("5e-5", "5e-6"), "the coil cannot lift the ball: that needs 3.33 A, it has 1.48 A. Give a lighter ball"),
        (("force_constant", "force_konstant"), "emulated.force_konstant_n_m2_a2 = 5e-05 is not a key. Did you mean"),
        (("[emulated]", "[emulate]"), "emulate = .* is not a key. Did you mean emulated"),
        (("5e-5", "-5e-5"), "Rig: force_constant_n_m2_a2 = -5e-05 is impossible"),
    ],
)
def test_a_rig_that_cannot_be_is_refused(change: tuple[str, str], message: str, tmp_path: Path) -> None:
    with pytest.raises(Board51Error, match=message):
        load_rig(file(tmp_path, HEAVY_RIG.replace(*change)))


def test_a_rig_that_is_neither_known_nor_a_file_is_refused() -> None:
    with pytest.raises(Board51Error, match="ce153 cannot be read"):
        rig_of("ce153")
