"""Emulated boards, which their build tells from real ones, and the plant of an emulated CE 152.  Pure."""

from __future__ import annotations

from protocol.plant import GRAVITY_M_S2, Plant

# The published constants of a CE 152, as in the twin's nominal model, which the gateway may not import.
CE152 = Plant(name="ce152", mass_kg=8.28e-3, travel_m=5.7e-3, x_max_m=5.7e-3, gravity_m_s2=GRAVITY_M_S2)
# gateway/emulator/firmware_model/flash.py; an emulated rig of somebody's own has another build that begins so.
_BUILD = "emulated"
_BUILDS = "emul"


def is_emulated(firmware: str) -> bool:
    """Return whether a board is emulated, by its `Parameters.firmware`: nobody can clamp its ball."""
    return f" {_BUILDS}" in firmware


def emulated_plant(firmware: str) -> Plant | None:
    """Return the plant of a board by its `Parameters.firmware`; None unless it is an emulated CE 152."""
    return CE152 if firmware.endswith(f" {_BUILD}") else None
