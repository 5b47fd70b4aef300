"""The models that ship with the product, and the equations of their K_c."""

from __future__ import annotations

from collections.abc import Sequence
from statistics import linear_regression

from twin.model.parameters import Model


def nominal(name: str = "ce152") -> Model:
    """Load a shipped model: `ce152`, or `inteco` (the rig of the public recordings).  Raises DataError."""
    return Model.load(name)


def lift_off_current(gap_m: Sequence[float], i_c_a: Sequence[float], at_gap_m: float) -> float:
    """Current that just carries the ball at `at_gap_m`, A, by linear regression through measured equilibria.

    By (6) at rest i = sqrt(m g / K_c) * gap, so equilibria lie on a line for any origin of the gap.

    Args:
        gap_m: gaps of the equilibria, m, shape (n,).
        i_c_a: their coil currents, A, shape (n,).
        at_gap_m: gap of the ball at its lower stop, m.
    """
    slope, intercept = linear_regression(gap_m, i_c_a)
    return slope * at_gap_m + intercept


def force_constant(*, mass_kg: float, gravity_m_s2: float, gap_m: float, lift_off_a: float) -> float:
    """K_c of (8): m g gap^2 / i^2 at the instant of lift-off, N m^2/A^2."""
    return mass_kg * gravity_m_s2 * gap_m**2 / lift_off_a**2
