"""The numbers of a healthy rig, against which a board is judged; SI units.

Sources: the CE 152's are those of docs/glossary.md and its model (`ce152`); the MagnetoShield's are in
firmware/magnetoshield.md.  The bounds leave room for the tolerance of parts, not for a wrong one.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass


@dataclass(frozen=True, slots=True, kw_only=True)
class RigNumbers:
    """The expectations of one rig.

    Pairs are the bounds of a good and of a possible value, both counted from the nominal one.
    """

    title: str
    K_A: float
    T_A_max_s: tuple[float, float]
    travel_m: float
    rest_input_v: float  # highest u_c at which the ball certainly stays at the bottom: 85 % of lift-off
    lift_input_v: float  # lifts the ball with a fifth of its weight or more to spare
    top_input_v: float  # highest input that is tried
    current_offset_a: tuple[float, float]
    current_noise_a: tuple[float, float]
    position_noise_m: tuple[float, float]
    dead_zone_v: tuple[float, float]
    magnet: bool  # lifted by a permanent magnet: the coil has a polarity
    flash_board: str = ""  # of `board51 flash`; "": it flashes none

    @property
    def no_current_a(self) -> float:
        """The highest reading of i_c, A, at which no current flows."""
        return self.current_offset_a[1] + 6 * self.current_noise_a[1]


RIGS: Mapping[str, RigNumbers] = {
    "ce152": RigNumbers(
        title="CE 152", K_A=0.297, T_A_max_s=(1e-3, 2e-3), travel_m=5.7e-3, magnet=False,
        rest_input_v=2.8, lift_input_v=4.0, top_input_v=5.0, dead_zone_v=(0.1, 0.25),
        current_offset_a=(15e-3, 40e-3), current_noise_a=(6e-3, 15e-3), position_noise_m=(15e-6, 50e-6),
    ),
    "magnetoshield": RigNumbers(
        title="MagnetoShield", K_A=5.131e-3, T_A_max_s=(1e-3, 2e-3), travel_m=5e-3, magnet=True,
        rest_input_v=6.6, lift_input_v=9.9, top_input_v=9.9, dead_zone_v=(0.15, 0.4),
        current_offset_a=(1e-3, 2.2e-3), current_noise_a=(0.3e-3, 1e-3), position_noise_m=(15e-6, 50e-6),
        flash_board="magnetoshield",
    ),
}  # fmt: skip
