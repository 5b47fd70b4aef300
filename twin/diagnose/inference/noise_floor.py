"""The noise floor: the log-likelihood of a model whose innovations are sensor noise alone.

The excess of a model is the log-likelihood that it lacks compared with white innovations of the covariance that
sensor noise alone gives the same model.  The noise is measured on the ball at rest, where no model is involved.

A model that needs a stop at a wrong place is not adequate either, although a stop costs little likelihood among so
many readings: two causes can be imitated by two others and a stop that is half a millimetre off.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from twin.diagnose import settings
from twin.diagnose.evidence.sensor_noise import noise_error, sensor_noise
from twin.diagnose.inference.likelihood import Criterion
from twin.diagnose.inference.theta import FLOORS, Theta
from twin.estimation.innovations import USE_X
from twin.estimation.record import FloatArray


@dataclass(frozen=True, slots=True, kw_only=True)
class Floor:
    """The sensor noise and the log-likelihood that it allows."""

    sigma_i_c_a: float
    sigma_x_m: float
    measured: bool  # at rest; else the smallest that any fit has asked for
    loglik: float  # of a right model
    readings: int
    error: float = 0.0  # standard error of `loglik` per reading: that of the noise level
    misplaced_m: float = 0.0  # how far from its place the model has that stop which is farther off

    def excess(self, loglik: float) -> float:
        """Log-likelihood that a model lacks compared with the floor."""
        return self.loglik - loglik

    def quiet(self, theta: Theta) -> Theta:
        """The model with sensor noise and no process noise."""
        return replace(
            theta,
            sigma_i_c_a=self.sigma_i_c_a,
            sigma_x_m=self.sigma_x_m,
            process_i_c_a=FLOORS["process_i_c_a"],
            process_a_m_s2=FLOORS["process_a_m_s2"],
        )

    def under(self, criterion: Criterion, theta: Theta) -> Floor:
        """The floor of another model: the spread of the innovations depends on its slope of the force."""
        loglik, readings = expected(criterion.outputs(self.quiet(theta)))
        misplaced_m = max(abs(theta.stop_low_m), abs(theta.stop_high_m))
        return replace(self, loglik=loglik, readings=readings, misplaced_m=misplaced_m)

    def material(self, loglik: float) -> bool:
        """Whether the excess is more than the uncertainty of the noise level, or a stop is misplaced."""
        return self.misplaced_m > settings.MISPLACED_STOP_M or self.above_noise(loglik)

    def above_noise(self, loglik: float) -> bool:
        """Whether the excess is more than the uncertainty of the noise level."""
        return self.excess(loglik) > max(settings.NOISE_TOLERANCE, settings.NOISE_ERRORS * self.error) * self.readings


def floor_of(criterion: Criterion, theta: Theta) -> Floor:
    """The floor with the covariances that the filter has at `theta`."""
    sigma_i, sigma_x = sensor_noise(criterion.evidence)
    asks_x = bool((criterion.evidence.series.flags & USE_X).any())
    measured = sigma_i is not None and (sigma_x is not None or not asks_x)
    floor = Floor(
        sigma_i_c_a=sigma_i or theta.sigma_i_c_a,
        sigma_x_m=sigma_x or theta.sigma_x_m,
        measured=measured,
        loglik=0.0,
        readings=0,
        error=noise_error(criterion.evidence) if measured else 0.0,
    )
    return floor.under(criterion, theta)


def expected(out: FloatArray) -> tuple[float, int]:
    """(log-likelihood of innovations that are as large as the filter says, number of readings)."""
    has_i, has_x = np.isfinite(out[:, 2]), np.isfinite(out[:, 4])
    both = has_i & has_x
    total = float(np.sum(np.log(out[both, 2] * out[both, 4] - out[both, 3] ** 2)))
    total += float(np.sum(np.log(out[has_i & ~has_x, 2]))) + float(np.sum(np.log(out[has_x & ~has_i, 4])))
    readings = int(has_i.sum() + has_x.sum())
    return -0.5 * (total + readings), readings
