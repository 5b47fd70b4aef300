"""The evidence outside the series: priors of the stops and of the causes' shapes, lift-off points, equilibria."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from protocol.campaign import Plant
from twin.estimation.record import FloatArray
from twin.evidence.starting.liftoff import LiftOff
from twin.inference.theta import Theta, shape_residuals
from twin.model.extended import acceleration, current_of_reading, magnetic_force, position_of_reading
from twin.settings import diagnosis as settings


@dataclass(frozen=True, slots=True, kw_only=True)
class Outside:
    """A sum of squares of residuals in standard errors."""

    statics: tuple[LiftOff, ...]  # points of force balance
    plant: Plant
    share: float  # of the samples of the campaign: this evidence counts as much

    def loglik(self, theta: Theta) -> float:
        """Return its log-likelihood."""
        residuals = self._residuals(theta)
        return -0.5 * float(residuals @ residuals)

    def slopes(self, theta: Theta, models: Sequence[Theta], steps: Sequence[float]) -> tuple[FloatArray, FloatArray]:
        """Return (score, Fisher information), from models a step away from `theta`."""
        residuals = self._residuals(theta)
        change = np.array(
            [(self._residuals(other) - residuals) / step for other, step in zip(models, steps, strict=True)]
        )
        return -change @ residuals, change @ change.T

    def points(self, theta: Theta) -> float:
        """Return the log-likelihood of the lift-off points and equilibria."""
        return -0.5 * float(np.sum(self._statics(theta) ** 2))

    def _residuals(self, theta: Theta) -> FloatArray:
        stops = [theta.stop_low_m / settings.STOP_STD_M, theta.stop_high_m / settings.STOP_STD_M]
        # A part of the samples gets the same share of this evidence. At full weight it would pull the fit of the part
        # towards itself.
        return math.sqrt(self.share) * np.concatenate([stops, self._statics(theta), shape_residuals(theta)])

    def _statics(self, theta: Theta) -> FloatArray:
        return np.array([self._static(theta, point) for point in self.statics])

    def _static(self, theta: Theta, point: LiftOff) -> float:
        p, c = theta.base(self.plant), theta.vector()
        i = current_of_reading(c, point.i_c_a)
        x = position_of_reading(p, c, self.plant.x_max_m - point.gap_m, i)
        # The error is one of K_c, which goes with the square of the current. The residual is a relative error of the
        # current: hence both halves.
        sigma = max(0.5 * point.relative_error, 0.003)
        force = magnetic_force(p, c, i, x)
        # What the magnet has to carry: the weight less every other force on a ball at rest.
        load = force - p.mass_kg * acceleration(p, c, i, x, 0.0, 0.0)
        # (8) with every force of the model.  The logarithm is linear in ln K_c, so that far from the balance a step
        # still leads to it.
        return 0.5 * math.log(max(force, 1e-12) / max(load, 1e-12)) / sigma
