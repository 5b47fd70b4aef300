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
from twin.simulate import PlantNumbers, ticks

SETTLE_S = 0.1  # the estimate forgets its start within about 1 / (unstable pole) = 12 ms; eight of them
CONTACT_SHARE = 0.01  # of the travel: nearer to a stop than this counts as contact
SPEED_STD_M_S = 0.5  # of a ball whose speed nobody has seen yet
_DELTA = (1e-6, 1e-8, 1e-6)  # A, m, m/s: forward differences, relative error 1e-8 m / gap and smaller


@kernel
def ekf_step(
    plant: Packed,
    numbers: Packed,
    z: NDArray[np.float64],
    P: NDArray[np.float64],
    work: NDArray[np.float64],
    y_i: float,
    y_x: float,
) -> tuple[float, float, float]:
    """Predict over one tick under u_c = z[3], correct with (y_i, y_x); z and P, shape (3, 3), are updated in place.

    numbers: as in `observe`; work, shape (3, 3, 4): scratch.
    Returns (innovation of i_c, innovation of x, NIS): NIS = nu' inv(S) nu is chi-square with 2 degrees under a right
    model.
    """
    states, other, K = work[0], work[1], work[2]
    for row in range(3):
        for column in range(4):
            states[row, column] = z[row]
    for k in range(3):
        states[k, k + 1] += _DELTA[k]
    ticks(PlantNumbers(*plant), states, z[3])
    for row in range(3):
        z[row] = states[row, 0]
        for k in range(3):
            states[row, k + 1] = (states[row, k + 1] - states[row, 0]) / _DELTA[k]
    F = states[:, 1:]

    for a in range(3):
        for b in range(3):
            other[a, b] = F[a, 0] * P[0, b] + F[a, 1] * P[1, b] + F[a, 2] * P[2, b]
    for a in range(3):
        for b in range(3):
            P[a, b] = other[a, 0] * F[b, 0] + other[a, 1] * F[b, 1] + other[a, 2] * F[b, 2]
        P[a, a] += numbers[a]

    # i_c and x are the first two states: H = [I 0], S is the upper left block of P plus r.
    s00, s01, s11 = P[0, 0] + numbers[3], P[0, 1], P[1, 1] + numbers[4]
    determinant = s00 * s11 - s01 * s01
    n_i, n_x = y_i - z[0], y_x - z[1]
    w_i = (s11 * n_i - s01 * n_x) / determinant
    w_x = (s00 * n_x - s01 * n_i) / determinant
    for a in range(3):
        K[a, 0] = (P[a, 0] * s11 - P[a, 1] * s01) / determinant
        K[a, 1] = (P[a, 1] * s00 - P[a, 0] * s01) / determinant
        z[a] += P[a, 0] * w_i + P[a, 1] * w_x
    for a in range(2):
        for b in range(3):
            other[a, b] = P[a, b]
    for a in range(3):
        for b in range(a, 3):
            corrected = P[a, b] - K[a, 0] * other[0, b] - K[a, 1] * other[1, b]
            P[a, b] = corrected
            P[b, a] = corrected
    return n_i, n_x, n_i * w_i + n_x * w_x


@kernel
def begin(numbers: Packed, z: NDArray[np.float64], P: NDArray[np.float64], i: float, x: float, u: float) -> None:
    """Take the measurement for the estimate, the speed unknown."""
    z[0], z[1], z[2], z[3], z[4] = i, x, 0.0, u, 0.0
    P[:] = 0.0
    P[0, 0], P[1, 1], P[2, 2] = numbers[3], numbers[4], SPEED_STD_M_S**2


@kernel
def observe(
    plant: Packed,
    numbers: Packed,
    z: NDArray[np.float64],
    P: NDArray[np.float64],
    work: NDArray[np.float64],
    follows: bool,
    usable: bool,
    i: float,
    x: float,
    u: float,
) -> tuple[float, float, float, bool]:
    """Take one sample; `follows`: one tick after the one before, `usable`: finite and within the sensors' ranges.

    numbers: variances of the process noise per tick of i_c, x, x' (0..2) and of the measurements of i_c, x (3, 4),
    lowest and highest x away from the stops (5, 6), ticks to settle (7).  z, shape (5,): the estimate (0..2), u_c of
    the previous sample (3; NaN: nothing to predict from), ticks predicted in a row away from the stops (4).

    Returns (innovation of i_c in A, innovation of x in m, NIS, valid); NaN where nothing was predicted.
    """
    if not (follows and usable):
        z[3], z[4] = math.nan, 0.0
    if not usable:
        return math.nan, math.nan, math.nan, False
    if math.isnan(z[3]) or not numbers[5] <= x <= numbers[6]:
        begin(numbers, z, P, i, x, u)
        return math.nan, math.nan, math.nan, False
    n_i, n_x, nis = ekf_step(plant, numbers, z, P, work, i, x)
    z[3] = u
    z[4] += 1.0
    if not (math.isfinite(nis) and numbers[5] <= z[1] <= numbers[6]):  # the filter, not the ball, is at a stop
        begin(numbers, z, P, i, x, u)
    return n_i, n_x, nis, bool(z[4] > numbers[7])


class Observer:
    """The filter's numbers and its memory, as `observe` takes them.

    Args:
        plant: the model, frozen for one T_s.
        noise: of the model file.
        i_lsb_a: one count of the current converter, A; 0 where unknown.
        x_lsb_m: one count of the position converter, m; 0 where unknown.
    """

    def __init__(self, plant: PlantNumbers, noise: Noise, *, i_lsb_a: float = 0.0, x_lsb_m: float = 0.0) -> None:
        margin_m = max(CONTACT_SHARE * plant.travel_m, 10.0 * noise.sigma_x_m)
        q = np.array([noise.process_i_c_a, 0.0, noise.process_a_m_s2 * plant.sample_time_s]) ** 2
        r = np.array([noise.sigma_i_c_a**2 + i_lsb_a**2 / 12.0, noise.sigma_x_m**2 + x_lsb_m**2 / 12.0])
        settle_ticks = float(max(1, round(SETTLE_S / plant.sample_time_s)))
        self.numbers: Packed = (*q.tolist(), *r.tolist(), margin_m, plant.travel_m - margin_m, settle_ticks)
        self.z = np.array([0.0, 0.0, 0.0, math.nan, 0.0])
        self.P = np.zeros((3, 3))
        self.work = np.zeros((3, 3, 4))
