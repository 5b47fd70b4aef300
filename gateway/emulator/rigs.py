"""The rigs that can be emulated: a plant, and the profile of the board that controls it.

rig = RIGS["magnetoshield"]
board = Firmware(rig.plant(seed=1), profile=rig.profile)
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from gateway.emulator.firmware_model.flash import CE152_BOARD, BoardProfile
from gateway.emulator.firmware_model.magnetoshield import magnetoshield
from gateway.emulator.plant.levitation import EmulatedPlant
from gateway.emulator.plant.magnetoshield import EmulatedMagnetoShield


@dataclass(frozen=True, slots=True, kw_only=True)
class EmulatedRig:
    """A plant and its board."""

    plant: type[EmulatedPlant]
    profile: BoardProfile


RIGS: Mapping[str, EmulatedRig] = {
    "ce152": EmulatedRig(plant=EmulatedPlant, profile=CE152_BOARD),
    "magnetoshield": EmulatedRig(plant=EmulatedMagnetoShield, profile=magnetoshield()),
}
