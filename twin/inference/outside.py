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
from twin.model.causes.catalogue import OFFSETS
from twin.model.causes.wander import MINUTE_S
from twin.model.extended import Base, acceleration, current_of_reading, magnetic_force, position_of_reading
from twin.settings import diagnosis as settings


@dataclass(frozen=True, slots=True, kw_only=True)
class Outside:
    """A sum of squares of residuals in standard errors."""

    statics: tuple[LiftOff, ...]  # points of force balance
    plant: Plant
    share: float  # of the samples of the campaign: this evidence counts as much

    def loglik(self, theta: Theta) -> float:
        """Return its log-likelihood; with offsets that wander, less what they add to the log standard errors."""
        residuals, spread = self._residuals(theta)
        return -0.5 * float(residuals @ residuals) - spread

    def slopes(self, theta: Theta, models: Sequence[Theta], steps: Sequence[float]) -> tuple[FloatArray, FloatArray]:
        """Return (score, Fisher information), from models a step away from `theta`."""
        residuals, spread = self._residuals(theta)
        moved = [self._residuals(model) for model in models]
        change = np.array([(values - residuals) / step for (values, _), step in zip(moved, steps, strict=True)])
        wider = np.array([(value - spread) / step for (_, value), step in zip(moved, steps, strict=True)])
        # Of a wander the samples say far more than a few points: what these add to its information is left out.
        return -change @ residuals - wider, change @ change.T

    def points(self, theta: Theta) -> float:
        """Return -1/2 times the sum of squares of the lift-off points and equilibria in standard errors."""
        residuals, _ = self._statics(theta)
        return -0.5 * float(residuals @ residuals)

    def _residuals(self, theta: Theta) -> tuple[FloatArray, float]:
        stops = [theta.stop_low_m / settings.STOP_STD_M, theta.stop_high_m / settings.STOP_STD_M]
        statics, spread = self._statics(theta)
        # A part of the samples gets the same share of this evidence. At full weight it would pull the fit of the part
        # towards itself.
        residuals = math.sqrt(self.share) * np.concatenate([stops, statics, shape_residuals(theta)])
        return residuals, self.share * spread

    def _statics(self, theta: Theta) -> tuple[FloatArray, float]:
        """Return (residuals of the points in standard errors, the rise of their log standard errors by a wander)."""
        c = theta.vector()
        errors = self._errors(theta, c)
        # The error is one of K_c, which goes with the square of the current; an error is one of the current.
        sigma = np.array([max(0.5 * point.relative_error, 0.003) for point in self.statics])
        walks = [(offset, wander) for offset, wander in OFFSETS if c[wander] > 0.0]
        if not walks or not self.statics:
            return errors / sigma, 0.0
        # As in the filter: a recording begins with what a minute adds, and its points share what was added before.
        t = np.array([point.t_s for point in self.statics])
        names = np.array([point.recording for point in self.statics])
        shared = (names[:, None] == names) * (1.0 + np.minimum(t[:, None], t) / MINUTE_S)
        covariance = np.diag(sigma**2)
        for offset, wander in walks:
            moved = c.copy()
            moved[offset] += c[wander]
            effect = self._errors(theta, moved) - errors
            covariance += shared * np.outer(effect, effect)
        root = np.linalg.cholesky(covariance)
        return np.asarray(np.linalg.solve(root, errors)), float(np.sum(np.log(np.diag(root) / sigma)))

    def _errors(self, theta: Theta, c: FloatArray) -> FloatArray:
        return np.array([self._error(theta.base(self.plant), c, point) for point in self.statics])

    def _error(self, p: Base, c: FloatArray, point: LiftOff) -> float:
        """Return the relative error of a current."""
        i = current_of_reading(c, point.i_c_a)
        x = position_of_reading(p, c, self.plant.x_max_m - point.gap_m, i)
        force = magnetic_force(p, c, i, x)
        # What the magnet has to carry: the weight less every other force on a ball at rest.
        load = force - p.mass_kg * acceleration(p, c, i, x, 0.0, 0.0)
        # (8) with every force of the model.  The logarithm is linear in ln K_c, so that far from the balance a step
        # still leads to it.
        return 0.5 * math.log(max(force, 1e-12) / max(load, 1e-12))
