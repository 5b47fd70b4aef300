"""The noise floor: the log-likelihood of a model whose innovations are sensor noise alone.

The excess of a model is the log-likelihood that it lacks compared with white innovations.  Their covariance is that of
the same model under sensor noise alone: (S 4), (S 5) of docs/theory/statistics.md.  The noise is measured on the ball
at rest and in settled captures, where no model is involved.

A model that needs a misplaced stop is not adequate either, although a stop costs little likelihood among so many
readings.  Two other causes and a stop that is half a millimetre off can imitate two causes.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from twin.estimation.innovations import USE_X, whitened
from twin.estimation.record import FloatArray
from twin.evidence.sensor_noise import noise_errors, sensor_noise
from twin.inference.initial_guess import coloured
from twin.inference.likelihood import Criterion
from twin.inference.theta import FLOORS, Theta
from twin.settings import diagnosis as settings


@dataclass(frozen=True, slots=True, kw_only=True)
class Floor:
    """The sensor noise and the log-likelihood that it allows."""

    sigma_i_c_a: float
    sigma_x_m: float
    measured: bool  # at rest; otherwise the smallest of any fit
    logliks: tuple[float, float] = (0.0, 0.0)  # of a right model: of i_c, and of x given i_c
    colours: tuple[tuple[str, float], ...] = ()  # of the noise at rest, as `NoiseLevels` has them
    counts: tuple[int, int] = (0, 0)  # readings of i_c and x
    errors: tuple[float, float] = (0.0, 0.0)  # standard errors of ln sigma of i_c and x
    misplaced_m: float = 0.0  # larger distance of the two stops in the model from their positions

    @property
    def loglik(self) -> float:
        """Return the log-likelihood of a right model."""
        return sum(self.logliks)

    @property
    def readings(self) -> int:
        """Return the number of readings."""
        return sum(self.counts)

    @property
    def tolerance(self) -> float:
        """Return the log-likelihood by which both noise levels together may be off: (S 6)."""
        # Weighed by the readings: a channel with most of them makes most of the error, the better known helps little.
        together = float(np.hypot(*(np.array(self.errors) * self.counts)))
        return max(settings.NOISE_TOLERANCE * self.readings, settings.NOISE_ERRORS * together)

    @property
    def tolerances(self) -> FloatArray:
        """The log-likelihoods by which the noise levels of i_c and x may be off, shape (2,)."""
        return np.array(self.counts) * np.maximum(
            settings.NOISE_TOLERANCE, settings.NOISE_ERRORS * np.array(self.errors)
        )

    def excess(self, loglik: float) -> float:
        """Return the log-likelihood that a model lacks compared with the floor."""
        return self.loglik - loglik

    def quiet(self, theta: Theta) -> Theta:
        """The model with sensor noise and no process noise."""
        # Without process noise: it absorbs errors of the model, which a floor must not include.
        return replace(
            theta.all_of(self.colours),
            sigma_i_c_a=self.sigma_i_c_a,
            sigma_x_m=self.sigma_x_m,
            process_i_c_a=FLOORS["process_i_c_a"],
            process_a_m_s2=FLOORS["process_a_m_s2"],
        )

    def under(self, criterion: Criterion, theta: Theta) -> Floor:
        """The floor of another model: the spread of the innovations depends on its slope of the force."""
        # Computed for each model, not once: the floor of a first, wrong fit was off by nearly the whole limit.
        # Two of four diagnoses with only right names then ended as unknown.
        logliks, counts = expected(criterion.outputs(self.quiet(theta)))
        misplaced_m = max(abs(theta.stop_low_m), abs(theta.stop_high_m))
        return replace(self, logliks=logliks, counts=counts, misplaced_m=misplaced_m)

    def material(self, loglik: float) -> bool:
        """Tell whether the excess is more than the uncertainty of the noise level, or a stop is misplaced."""
        return self.misplaced_m > settings.MISPLACED_STOP_M or self.above_noise(loglik)

    def above_noise(self, loglik: float) -> bool:
        """Tell whether the excess is more than the uncertainty of the noise level."""
        return self.excess(loglik) > self.tolerance

    def lacking(self, logliks: FloatArray, points: int) -> FloatArray:
        """The excess of each part of `part_logliks`, shape (3,); inf where it is within the uncertainty of the noise.

        Args:
            logliks: of the parts, under the model of this floor.
            points: number of lift-off points and equilibria.
        """
        # Each part apart, not in sum: a noisy current would hide that a law of the force explains nearly all that its
        # own part lacks.
        excess = self.part_excess(logliks, points)
        return np.where(excess > [*self.tolerances, settings.MIN_GAIN], excess, np.inf)

    def part_excess(self, logliks: FloatArray, points: int) -> FloatArray:
        """The excess of each part of `part_logliks`, shape (3,); arguments as `lacking`."""
        return np.array([*self.logliks, -0.5 * points]) - logliks


def floor_of(criterion: Criterion, theta: Theta) -> Floor:
    """The floor with the covariances that the filter has at `theta`."""
    sigma_i, sigma_x = sensor_noise(criterion.evidence)
    # A campaign without x must not count as unmeasured: its only noise is that of i_c.
    asks_x = bool((criterion.evidence.series.flags & USE_X).any())
    measured = sigma_i is not None and (sigma_x is not None or not asks_x)
    floor = Floor(
        sigma_i_c_a=sigma_i or theta.sigma_i_c_a,
        sigma_x_m=sigma_x or theta.sigma_x_m,
        measured=measured,
        colours=coloured(noise) if (noise := criterion.evidence.noise) is not None else (),
        errors=noise_errors(criterion.evidence) if measured else (0.0, 0.0),
    )
    return floor.under(criterion, theta)


def expected(out: FloatArray) -> tuple[tuple[float, float], tuple[int, int]]:
    """Return (log-likelihood of innovations as large as the filter says, number of readings), each of i_c and x."""
    # (S 4): nu' inv(S) nu is replaced by its mean, the number of readings.
    logs = _log_variances(out)
    counts = np.isfinite(logs).sum(axis=0)
    i_c, x = (-0.5 * (np.nansum(logs, axis=0) + counts)).tolist()
    return (i_c, x), (int(counts[0]), int(counts[1]))


def part_logliks(criterion: Criterion, *thetas: Theta) -> list[FloatArray]:
    """Return the log-likelihood of i_c, of x given i_c, and of the points at rest, shape (3,), for each model."""
    return [
        np.append(
            -0.5 * (np.nansum(_log_variances(out), axis=0) + np.nansum(whitened(out) ** 2, axis=0)),
            criterion.outside.points(theta),
        )
        for theta, out in zip(thetas, criterion.several(thetas), strict=True)
    ]


def _log_variances(out: FloatArray) -> FloatArray:
    """Return the log variance of each innovation of i_c, and of x given i_c, shape (n, 2); NaN without one."""
    both = np.isfinite(out[:, 2])
    # x given i_c, not x alone: only the conditional variances multiply to the determinant of S, so that the parts add
    # up.
    conditional = out[:, 4] - np.where(both, out[:, 3] ** 2 / out[:, 2], 0.0)
    with np.errstate(invalid="ignore"):
        return np.log(np.column_stack([out[:, 2], conditional]))
