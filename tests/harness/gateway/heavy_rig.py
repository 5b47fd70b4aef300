"""A rig with another ball than the CE 152's: its file, what a campaign must find, and its plant card."""

from __future__ import annotations

from protocol.bus import board51_pb2 as pb

TRUTH = {"K_A": 0.297, "T_A": 3e-4, "K_c": 5e-5, "b": 0.05}
# Its drag is that of the CE 152; `DRAGGED_RIG` has another.
HEAVY_RIG = """
[plant]
name = "heavy"
mass_kg = 20e-3
travel_m = 12e-3
x_max_m = 16e-3
[emulated]
force_constant_n_m2_a2 = 5e-5
"""
DRAGGED_RIG = f"{HEAVY_RIG}drag_n_s_m = 0.05\n"
HEAVY = pb.Plant(name="heavy", mass_kg=20e-3, travel_m=12e-3, x_max_m=16e-3, gravity_m_s2=9.81)
