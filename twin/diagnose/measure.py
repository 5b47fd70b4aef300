"""What the extended model gains, on recordings that were never used for fitting or choosing.

Rule 1: the same samples for both models: a prediction counts where both have one.
Rule 2: the noise floor is what a right model would show at that horizon under the sensor noise alone: the stationary
        filter of the extended model, its covariance carried on over the horizon, at the positions that were flown.
Rule 3: intervals by block bootstrap: errors 20 ms ahead overlap, blocks of half a second hardly do.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
from scipy.linalg import LinAlgError, solve_discrete_are

from protocol.campaign import Plant
from twin.diagnose.evidence import Evidence
from twin.diagnose.floor import Floor
from twin.diagnose.horizon import predict_ahead, within_reach
from twin.diagnose.phase import has_phase, predict_in_phase
from twin.diagnose.theta import FLOORS, Theta
from twin.identify.innovations import FLIES
from twin.identify.record import FloatArray
from twin.model.extended import STATES, X, advance, magnetic_force, position_of_reading

HORIZONS_S = (0.002, 0.010, 0.020, 0.040)
BLOCK_S = 0.5
DRAWS = 1000
_QUANTILES = (0.1, 0.3, 0.5, 0.7, 0.9)


@dataclass(frozen=True, slots=True, kw_only=True)
class Gain:
    """Errors of the position `samples` ahead, before and after."""

    samples: int
    horizon_s: float
    baseline_rmse_m: float
    extended_rmse_m: float
    floor_m: float
    ci95_ratio: tuple[float, float]  # of extended over baseline
    count: int
    # x_hat - x of every sample, baseline and extended, shape (2, n); NaN where one of them predicts nothing
    errors_m: FloatArray = field(default_factory=lambda: np.empty((2, 0)), repr=False, compare=False)

    @property
    def removed(self) -> float:
        """Share of the mean square error above the floor that is gone; NaN where there was none."""
        excess = self.baseline_rmse_m**2 - self.floor_m**2
        return (self.baseline_rmse_m**2 - self.extended_rmse_m**2) / excess if excess > 0.0 else math.nan


def predictions(evidence: Evidence, theta: Theta, plant: Plant, tick_s: float, samples: int) -> FloatArray:
    """x_hat, shape (n,), of every sample `samples` ahead; NaN where there is none."""
    s = evidence.series
    noise = (theta.sigma_i_c_a, theta.sigma_x_m, theta.process_i_c_a, theta.process_a_m_s2, tick_s)
    c = theta.vector()
    ahead = predict_in_phase if has_phase(c) else predict_ahead
    stops, p = (theta.stop_low_m, theta.stop_high_m), theta.base(plant)
    x_hat = ahead(tuple(p), c, noise, stops, evidence.t, s.step, s.u, s.i, s.x, s.flags, tick_s, samples)
    return within_reach(x_hat, p, c, stops)


def gain(
    evidence: Evidence, before: Theta, after: Theta, floor: Floor, plant: Plant, tick_s: float, samples: int, seed: int
) -> Gain | None:
    """The gain on this evidence; None where nothing can be predicted."""
    x = evidence.series.x
    errors = [predictions(evidence, theta, plant, tick_s, samples) - x for theta in (before, after)]
    both = np.isfinite(errors[0]) & np.isfinite(errors[1])
    if both.sum() < 50:
        return None
    first, second = errors[0][both] ** 2, errors[1][both] ** 2
    return Gain(
        samples=samples,
        horizon_s=samples * tick_s,
        baseline_rmse_m=math.sqrt(float(first.mean())),
        extended_rmse_m=math.sqrt(float(second.mean())),
        floor_m=floor_rmse(evidence, after, floor, plant, tick_s, samples),
        ci95_ratio=bootstrap(first, second, max(round(BLOCK_S / tick_s), 1), seed),
        count=int(both.sum()),
        errors_m=np.where(both, errors, np.nan),
    )


def bootstrap(first: FloatArray, second: FloatArray, block: int, seed: int) -> tuple[float, float]:
    """95 % interval of the ratio of root mean squares, second over first, by blocks."""
    count = max(len(first) // block, 1)
    edges = np.linspace(0, len(first), count + 1).astype(int)
    sums = np.array([[first[a:b].sum(), second[a:b].sum()] for a, b in pairwise(edges)])
    drawn = np.random.default_rng(seed).integers(0, count, size=(DRAWS, count))
    totals = sums[drawn].sum(axis=1)
    ratios = np.sqrt(totals[:, 1] / np.maximum(totals[:, 0], 1e-300))
    low, high = np.quantile(ratios, (0.025, 0.975))
    return float(low), float(high)


def floor_rmse(evidence: Evidence, theta: Theta, floor: Floor, plant: Plant, tick_s: float, samples: int) -> float:
    """Root mean square error of a right model so many samples ahead, m."""
    flown = evidence.series.x[evidence.series.flags & FLIES != 0]
    if not len(flown):
        return math.nan
    squares = []
    for x in np.quantile(flown, _QUANTILES):
        square = _floor_at(float(x), theta, floor, plant, tick_s, samples)
        if math.isfinite(square):
            squares.append(square)
    return math.sqrt(float(np.mean(squares))) if squares else math.nan


def _floor_at(reading: float, theta: Theta, floor: Floor, plant: Plant, tick_s: float, samples: int) -> float:
    p, c = theta.base(plant), theta.vector()
    x = position_of_reading(p, c, reading, 0.5)
    i = _holding_current(theta, plant, x)
    u = i / theta.K_A
    F = np.empty((3, 3))
    scales = (1e-5, 1e-8, 1e-5)
    start = np.array([i, x, 0.0, i, x, i * i])
    middle = start.copy()
    advance(tuple(p), c, middle, u, 0.0, tick_s, False)
    for column, delta in enumerate(scales):
        moved = start.copy()
        moved[column] += delta
        if column == 0:
            moved[3] += delta
        advance(tuple(p), c, moved, u, 0.0, tick_s, False)
        F[:, column] = (moved[:3] - middle[:3]) / delta
    assert len(start) == STATES
    H = np.eye(2, 3)
    a2 = FLOORS["process_a_m_s2"] ** 2
    Q = np.diag([FLOORS["process_i_c_a"] ** 2, 0.0, a2 * tick_s**2])
    R = np.diag([floor.sigma_i_c_a**2, floor.sigma_x_m**2])
    try:
        P = solve_discrete_are(F.T, H.T, Q + 1e-16 * np.eye(3), R)
    except (LinAlgError, ValueError):
        return math.nan
    S = H @ P @ H.T + R
    P = P - P @ H.T @ np.linalg.solve(S, H @ P)
    for _ in range(samples):
        P = F @ P @ F.T + Q
    return float(P[X, X] + floor.sigma_x_m**2)


def _holding_current(theta: Theta, plant: Plant, x: float) -> float:
    p, c = theta.base(plant), theta.vector()
    weight = plant.mass_kg * plant.gravity_m_s2
    low, high = 0.0, 100.0
    for _ in range(60):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if magnetic_force(p, c, middle, x) < weight else (low, middle)
    return high
