"""Constants of a rig: the CE 152 as measured, or another rig of the same kind.

Derivation of the constants of `CE152`:

Four steady points of a CE 152 are published (gap under the top stop, current; see `MEASURED_EQUILIBRIA`).  At rest
F_m = m g, so eq. (3) asks for i = sqrt(m g / K_c) (x_max - x).  The points do lie on a straight line, within 1.4 %
(least squares over the four currents),

    i = 120.36 A/m * (gap + 2.438 mm),    gap = travel - x,

but that line does not pass through zero at the stop.  The force acts as if its pole, the effective plane of the coil,
were 2.438 mm above the highest position of the ball.  Eq. (3) with x_max = travel forces the line through zero.  Then
the ratio of current and gap would be one number, but it doubles from the first point to the last.  With the plane as a
second number, slope and intercept give

    K_c = m g / (120.36 A/m)^2 = 5.607e-6 N m^2/A^2,    d = 2.438 mm.

A physical reading: the ball's pole is its centre, and the winding starts behind a bottom plate.  So the distance that
matters is never zero, even if ball and housing touch.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields

from protocol.errors import ConfigError

# (gap under the top stop in m, coil current in A), D. Honc, "Modelling and Identification of Magnetic Levitation Model
# CE 152 / Revised": sensor 1, 2, 3, 4 V; current = 0.297 A/V times input voltage.
MEASURED_EQUILIBRIA = ((4.5848e-3, 0.85239), (3.4152e-3, 0.69498), (2.2456e-3, 0.56133), (1.0760e-3, 0.42768))


@dataclass(frozen=True, slots=True, kw_only=True)
class PlantConstants:
    """Coil, ball, and position sensor below.  x is up from the sensor: 0 at the bottom stop, `travel_m` at the top."""

    mass_kg: float
    travel_m: float
    gravity_m_s2: float
    force_constant_n_m2_a2: float  # K_c of eq. (3)
    coil_plane_above_stop_m: float  # d: eq. (3) with x_max = travel + d
    amplifier_gain_a_v: float  # K_A of eq. (1)
    amplifier_time_constant_s: float  # T_A of eq. (1)
    drag_n_s_m: float  # b of eq. (5)
    restitution: float  # speed after a bounce / speed before, both stops
    input_max_v: float  # u_c is 0 .. this
    current_max_a: float  # i_c is 0 .. this
    position_noise_m: float  # standard deviation of one reading
    current_noise_a: float  # standard deviation of one reading
    force_exponent: float = 2.0  # of the gap; the force is that of exponent 2 at mid-travel
    # A permanent magnet instead of a ball: the current whose field has its strength.  The force is K_c i I/gap^2 then,
    # as the coil need not magnetise it; 0: a ball.
    magnet_current_a: float = 0.0

    def __post_init__(self) -> None:
        may_be_zero = {"drag_n_s_m", "restitution", "position_noise_m", "current_noise_a", "gravity_m_s2"}
        may_be_zero.add("magnet_current_a")
        for field in fields(self):
            value = getattr(self, field.name)
            low_enough = field.name != "restitution" or value < 1.0
            if not (math.isfinite(value) and (value > 0 or (value == 0 and field.name in may_be_zero)) and low_enough):
                problem = f"Rig: {field.name} = {value} is impossible"
                raise ConfigError(problem, remedy="Give a finite positive number (restitution: 0 <= e < 1)")

    def gap_m(self, x_m: float) -> float:
        """The distance from the ball's position x to the effective plane of the coil: x_max - x of eq. (3)."""
        return self.travel_m + self.coil_plane_above_stop_m - x_m

    def equilibrium_current_a(self, x_m: float) -> float:
        """The current that carries the ball at rest at x: i = gap sqrt(m g / K_c), eq. (6) with x'' = x' = 0."""
        gap = self.gap_m(x_m)
        if self.force_exponent == 2.0 and self.magnet_current_a == 0.0:
            return gap * math.sqrt(self.mass_kg * self.gravity_m_s2 / self.force_constant_n_m2_a2)
        far = (gap / self.gap_m(self.travel_m / 2.0)) ** (self.force_exponent - 2.0)
        square = far * gap**2 * self.mass_kg * self.gravity_m_s2 / self.force_constant_n_m2_a2
        return square / self.magnet_current_a if self.magnet_current_a > 0.0 else math.sqrt(square)

    def equilibrium_input_v(self, x_m: float) -> float:
        """The input that holds `equilibrium_current_a`: u = i / K_A, eq. (1)."""
        return self.equilibrium_current_a(x_m) / self.amplifier_gain_a_v


CE152 = PlantConstants(
    mass_kg=8.28e-3,  # measured
    travel_m=5.7e-3,  # measured
    gravity_m_s2=9.81,
    force_constant_n_m2_a2=5.607e-6,  # fit, above
    coil_plane_above_stop_m=2.438e-3,  # fit, above
    amplifier_gain_a_v=0.297,  # measured; sources give 0.28 .. 0.31
    amplifier_time_constant_s=3e-4,  # assumed; sources give 2e-5 .. 2e-3
    drag_n_s_m=0.02,  # two sources; others 0 .. 0.05
    restitution=0.5,  # assumed: steel ball on the sensor's plastic cover
    input_max_v=5.0,
    current_max_a=1.5,
    position_noise_m=5e-6,  # assumed: about three counts of a 12-bit converter
    current_noise_a=2e-3,  # assumed
)
