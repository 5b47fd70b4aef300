"""One-step prediction: an extended Kalman filter driven by the measured u_c, corrected by the measured i_c and x.

Rule 1: u_c of sample k is in force from tick k to k+1, so sample k+1 is predicted from the estimate at k and u_c(k).
Rule 2: contact is not modelled here.  Near a stop, over a gap and until it has settled, the innovation is not valid.
Rule 3: sensitivities are finite differences of the very kernel that predicts: there is no second set of equations.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from twin.compiled import Packed, kernel
from twin.model.parameters import Noise
from twin.simulate import PlantNumbers, tick

SETTLE_S = 0.1  # the estimate forgets its start within about 1 / (unstable pole) = 12 ms; eight of them
CONTACT_SHARE = 0.01  # of the travel: nearer to a stop than this counts as contact
SPEED_STD_M_S = 0.5  # of a ball whose speed nobody has seen yet
_DELTA = (1e-6, 1e-8, 1e-6)  # A, m, m/s: forward differences, relative error 1e-8 m / gap and smaller


@kernel
def ekf_step(
    plant: Packed,
    z: NDArray[np.float64],
    P: NDArray[np.float64],
    q: NDArray[np.float64],
    r: NDArray[np.float64],
    u: float,
    y_i: float,
    y_x: float,
) -> tuple[float, float, float, float]:
    """Predict over one tick under u, correct with (y_i, y_x); z, shape (3,), and P, shape (3, 3), are updated in place.

    q, shape (3,): variances of the process noise per tick; r, shape (2,): of the measurements.
    Returns (innovation of i_c, innovation of x, NIS, corrected x): NIS = nu' inv(S) nu is chi-square with 2 degrees
    under a right model.
    """
    p = PlantNumbers(*plant)
    i, x, v = z[0], z[1], z[2]
    ahead = tick(p, i, x, v, u)
    F = np.empty((3, 3))
    for column in range(3):
        d = _DELTA[column]
        di = d if column == 0 else 0.0
        dx = d if column == 1 else 0.0
        dv = d if column == 2 else 0.0
        moved = tick(p, i + di, x + dx, v + dv, u)
        for row in range(3):
            F[row, column] = (moved[row] - ahead[row]) / d
    z[0], z[1], z[2] = ahead

    propagated = np.zeros((3, 3))
    for a in range(3):
        for b in range(3):
            for c in range(3):
                propagated[a, b] += F[a, c] * P[c, b]
    for a in range(3):
        for b in range(3):
            total = 0.0
            for c in range(3):
                total += propagated[a, c] * F[b, c]
            P[a, b] = total
        P[a, a] += q[a]

    # i_c and x are the first two states: H = [I 0], S is the upper left block of P plus r.
    s00, s01, s11 = P[0, 0] + r[0], P[0, 1], P[1, 1] + r[1]
    determinant = s00 * s11 - s01 * s01
    n_i, n_x = y_i - z[0], y_x - z[1]
    w_i = (s11 * n_i - s01 * n_x) / determinant
    w_x = (s00 * n_x - s01 * n_i) / determinant
    K = np.empty((3, 2))
    for a in range(3):
        K[a, 0] = (P[a, 0] * s11 - P[a, 1] * s01) / determinant
        K[a, 1] = (P[a, 1] * s00 - P[a, 0] * s01) / determinant
    for a in range(3):
        z[a] += P[a, 0] * w_i + P[a, 1] * w_x
    before = P.copy()
    for a in range(3):
        for b in range(a, 3):
            corrected = before[a, b] - K[a, 0] * before[0, b] - K[a, 1] * before[1, b]
            P[a, b] = corrected
            P[b, a] = corrected
    return n_i, n_x, n_i * w_i + n_x * w_x, z[1]


class Observer:
    """The filter and its validity.

    Args:
        plant: the model, frozen for one T_s.
        noise: of the model file.
        i_lsb_a: one count of the current converter, A; 0 where unknown.
        x_lsb_m: one count of the position converter, m; 0 where unknown.
    """

    def __init__(self, plant: PlantNumbers, noise: Noise, *, i_lsb_a: float = 0.0, x_lsb_m: float = 0.0) -> None:
        self._plant = tuple(plant)
        self._q = np.array([noise.process_i_c_a, 0.0, noise.process_a_m_s2 * plant.sample_time_s]) ** 2
        self._r = np.array([noise.sigma_i_c_a**2 + i_lsb_a**2 / 12.0, noise.sigma_x_m**2 + x_lsb_m**2 / 12.0])
        self._margin_m = max(CONTACT_SHARE * plant.travel_m, 10.0 * noise.sigma_x_m)
        self._upper_m = plant.travel_m - self._margin_m
        self._settle_ticks = max(1, round(SETTLE_S / plant.sample_time_s))
        self._z = np.zeros(3)
        self._P = np.zeros((3, 3))
        self._u: float | None = None  # of the previous sample; None: nothing to predict from
        self._free_ticks = 0  # predicted in a row, away from the stops

    @property
    def estimate(self) -> tuple[float, float, float]:
        """(i_c, x, x') at the last sample: A, m, m/s."""
        return float(self._z[0]), float(self._z[1]), float(self._z[2])

    def forget(self) -> None:
        """Start anew with the next sample: after a gap, or a sample that cannot be used."""
        self._u = None
        self._free_ticks = 0

    def observe(self, i: float, x: float, u: float) -> tuple[float, float, float, bool]:
        """Take a finite sample that follows the previous one by one tick.

        Returns (innovation of i_c in A, innovation of x in m, NIS, valid); NaN where nothing was predicted.
        """
        if self._u is None or self._contact(x):
            self._begin(i, x, u)
            return math.nan, math.nan, math.nan, False
        n_i, n_x, nis, estimated = ekf_step(self._plant, self._z, self._P, self._q, self._r, self._u, i, x)
        self._u = u
        self._free_ticks += 1
        if not math.isfinite(nis) or self._contact(estimated):  # the filter, not the ball, is at a stop: begin again
            self._begin(i, x, u)
        return n_i, n_x, nis, self._free_ticks > self._settle_ticks

    def _contact(self, x: float) -> bool:
        return not self._margin_m <= x <= self._upper_m

    def _begin(self, i: float, x: float, u: float) -> None:
        self._z[:] = i, x, 0.0
        self._P[:] = np.diag([self._r[0], self._r[1], SPEED_STD_M_S**2])
        self._u = u
        self._free_ticks = 0
