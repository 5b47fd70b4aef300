"""The starting values of the fit: estimates from levels, steps, lift-offs and regressions, without the likelihood."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from protocol.campaign import Plant
from twin.estimation.record import Record
from twin.evidence.starting.levels import Levels, Shape, find_levels, find_shape
from twin.evidence.starting.liftoff import ForceConstant, equilibria, force_constant, lift_offs
from twin.evidence.starting.regression import AmplifierStart, BallStart, amplifier_start, ball_start
from twin.inference.initial_guess import first_theta
from twin.inference.theta import Theta


@dataclass(frozen=True, slots=True, kw_only=True)
class Starts:
    """The estimates; None where no recording gives one."""

    levels: Levels | None  # line through the steady levels of i_c
    shape: Shape | None  # of the step response
    force: ForceConstant | None  # by (8), from lift-offs or equilibria
    amplifier: AmplifierStart | None
    ball: BallStart | None

    def text(self, mass_kg: float) -> str:
        """Return the values in a line."""
        parts = []
        if self.amplifier:
            parts.append(f"K_A = {self.amplifier.K_A:.4g} A/V, T_A = {self.amplifier.T_A:.3g} s")
        if self.ball:
            parts.append(f"K_c = {self.ball.k * mass_kg:.4g}, b = {self.ball.d * mass_kg:.3g} (regression)")
        if self.force:
            parts.append(f"K_c = {self.force.K_c:.4g} (8)")
        return "; ".join(parts) or "none"

    def theta(self, amplifier: AmplifierStart, mass_kg: float) -> Theta:
        """Return the model at which the fit begins; what is not known has a typical value."""
        ball, force = self.ball, self.force
        k = ball.k if ball is not None and ball.k > 0 else force.K_c / mass_kg if force is not None else 1e-3
        d = min(max(ball.d, 0.0), 50.0) if ball is not None else 2.0
        return nominal(amplifier, k * mass_kg, d * mass_kg)


def nominal(amplifier: AmplifierStart, K_c: float, b: float) -> Theta:
    """The paper's model as this room fits it."""
    # b may become negative: bounded at 0, its interval would be wrong where the data do not show the drag.
    return replace(first_theta(amplifier, K_c, b), min_b=-math.inf, closed_form=True)


def find_starts(records: list[Record], plant: Plant) -> Starts:
    """Estimate what single recordings show."""
    amplifier = amplifier_start(records)
    return Starts(
        levels=find_levels(records),
        shape=find_shape(records),
        force=force_constant(lift_offs(records, plant), plant) or force_constant(equilibria(records, plant), plant),
        amplifier=amplifier,
        ball=ball_start(records, plant, amplifier),
    )
