"""One-step prediction: an extended Kalman filter driven by the measured u_c, corrected by the measured i_c and x.

Rule 1: u_c of sample k is in force from tick k to k+1, so sample k+1 is predicted from the estimate at k and u_c(k).
        A delay of the model, of input and sensors together, is one of the input.
Rule 2: contact is not modelled here.  Near a stop, over a gap and until it has settled, the innovation is not valid.
Rule 3: sensitivities are finite differences of the very kernel that predicts: there is no second set of equations.
Rule 4: in the covariance are i_c, x, x' and what the causes of the model give a life of its own.

Memory z: the state of `extended.py` (0..5), ticks predicted in a row away from the stops (TICKS), the inputs so far,
newest first (from INPUTS on; NaN: nothing to predict from).
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from twin.compiled import Packed, kernel
from twin.estimation.ekf.correct import position_slopes
from twin.estimation.ekf.predict import carry
from twin.estimation.innovations import SPEED_STD_M_S
from twin.model.causes import amplifier_gain_drift, current_sensor_gain, eddy_current_lag, position_sensor_lag
from twin.model.extended import (
    FIELD,
    I_C,
    SENSOR,
    STATES,
    WARMTH,
    Base,
    V,
    X,
    current_of_reading,
    current_reading,
    position_of_reading,
    position_reading,
)
from twin.model.parameters import Noise
from twin.model.simulate import PlantNumbers, over

SETTLE_S = 0.1  # the estimate forgets its start within about 1 / (unstable pole) = 12 ms; eight of them
CONTACT_SHARE = 0.01  # of the travel: nearer to a stop than this counts as contact
WARMTH_STD = 0.3  # A^2, of a coil whose past nobody has seen
TICKS = STATES
INPUTS = STATES + 1
# By state: forward differences, relative error 1e-8 m / gap and smaller.
_DELTA = np.array([1e-6, 1e-8, 1e-6, 1e-6, 1e-8, 1e-4])


@kernel
def predict(plant: Packed, y: NDArray[np.float64], z: NDArray[np.float64]) -> None:
    """State y one tick on, in place, under the inputs remembered in z; free of the stops."""
    p = PlantNumbers(*plant)
    newest = INPUTS + p.in_whole
    if p.in_part_s > 0.0:
        over(plant, y, z[newest + 1], p.in_part_s, False)
    over(plant, y, z[newest], p.sample_time_s - p.in_part_s, False)


@kernel
def ekf_step(
    plant: Packed,
    numbers: Packed,
    active: NDArray[np.int64],
    z: NDArray[np.float64],
    P: NDArray[np.float64],
    work: NDArray[np.float64],
    y_i: float,
    y_x: float,
) -> tuple[float, float, float]:
    """Predict over one tick, correct with (y_i, y_x); z and P, shape (m, m), are updated in place.

    numbers, active, work: as in `observe`.
    Returns (innovation of i_c, innovation of x, NIS): NIS = nu' inv(S) nu is chi-square with 2 degrees under a right
    model.
    """
    p = PlantNumbers(*plant)
    c = p.c
    base = Base(*p.base)
    m = len(active)
    eddies, lags = c[eddy_current_lag.TAU] > 0.0, c[position_sensor_lag.TAU] > 0.0
    F, G, h_x, by_i, by_x = work[m : 2 * m], work[2 * m : 3 * m], work[3 * m], work[3 * m + 1], work[3 * m + 2]
    for column in range(m):
        moved = work[column]
        for k in range(STATES):
            moved[k] = z[k]
        place = active[column]
        moved[place] += _DELTA[place]
        if place == I_C and not eddies:
            moved[FIELD] = moved[I_C]
        predict(plant, moved, z)
    predict(plant, z, z)
    for column in range(m):
        for row in range(m):
            F[row, column] = (work[column, active[row]] - z[active[row]]) / _DELTA[active[column]]
    carry(F, P, G, m)
    for a in range(3):
        P[a, a] += numbers[a]

    gain = c[current_sensor_gain.GAIN]
    sensor = -1
    if lags:
        sensor = 4 if eddies else 3
    shown = position_slopes(p.base, c, z, sensor, h_x)
    n_i, n_x = y_i - current_reading(c, z[I_C]), y_x - shown
    s00, s01, s11 = numbers[3], 0.0, numbers[4]
    for a in range(m):
        by_i[a] = gain * P[a, 0]
        total = 0.0
        for b in range(m):
            total += P[a, b] * h_x[b]
        by_x[a] = total
    s00 += gain * by_i[0]
    s01 += gain * by_x[0]
    for a in range(m):
        s11 += h_x[a] * by_x[a]
    determinant = s00 * s11 - s01 * s01
    w_i = (s11 * n_i - s01 * n_x) / determinant
    w_x = (s00 * n_x - s01 * n_i) / determinant
    for a in range(m):
        z[active[a]] += by_i[a] * w_i + by_x[a] * w_x
        K_i = (by_i[a] * s11 - by_x[a] * s01) / determinant
        K_x = (by_x[a] * s00 - by_i[a] * s01) / determinant
        for b in range(a, m):
            P[a, b] -= K_i * by_i[b] + K_x * by_x[b]
            P[b, a] = P[a, b]
    if not eddies:
        z[FIELD] = z[I_C]
    if not lags:
        z[SENSOR] = position_reading(base, c, z[X], z[I_C])
    return n_i, n_x, n_i * w_i + n_x * w_x


@kernel
def begin(
    plant: Packed,
    numbers: Packed,
    active: NDArray[np.int64],
    z: NDArray[np.float64],
    P: NDArray[np.float64],
    i: float,
    x: float,
    reading: float,
    first: bool,
) -> None:
    """Take the measurement for the estimate, the speed unknown.

    Args:
        plant: PlantNumbers.
        numbers: as in `observe`.
        active: as there.
        z: the estimate.
        P: its covariance.
        i: current behind the reading, A.
        x: position behind the reading, m.
        reading: of the position, m.
        first: nothing is known of the warmth either.
    """
    p = PlantNumbers(*plant)
    tau = p.c[position_sensor_lag.TAU]
    m = len(active)
    warm = 0.0 if first or active[m - 1] != WARMTH else P[m - 1, m - 1]
    P[:] = 0.0
    z[I_C], z[X], z[V], z[FIELD], z[SENSOR], z[TICKS] = i, x, 0.0, i, reading, 0.0
    P[0, 0], P[1, 1], P[2, 2] = numbers[3], numbers[4], SPEED_STD_M_S**2
    for a in range(3, m):
        if active[a] == FIELD:
            P[a, a], P[0, a], P[a, 0] = P[0, 0], P[0, 0], P[0, 0]
        elif active[a] == SENSOR:
            # It lags a ball of unknown speed: where x is depends on it.
            P[1, 1] += (tau * SPEED_STD_M_S) ** 2
            P[1, 2] = tau * SPEED_STD_M_S**2
            P[2, 1], P[a, a] = P[1, 2], numbers[4]
        else:
            P[a, a] = warm if warm > 0.0 else WARMTH_STD**2
    if first:
        z[WARMTH] = i * i
    else:
        z[WARMTH] += p.sample_time_s * amplifier_gain_drift.warmth_rate(p.c, i, z[WARMTH])


@kernel
def observe(
    plant: Packed,
    numbers: Packed,
    active: NDArray[np.int64],
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
    lowest and highest x away from the stops (5, 6), ticks to settle (7).  active, shape (m,): the states that P, shape
    (m, m), is of.  z: the memory.  work, shape (3 m + 3, 6): scratch.

    Returns (innovation of i_c in A, innovation of x in m, NIS, valid); NaN where nothing was predicted.
    """
    if not (follows and usable):
        z[INPUTS] = math.nan
    if not usable:
        return math.nan, math.nan, math.nan, False
    p = PlantNumbers(*plant)
    base = Base(*p.base)
    current = current_of_reading(p.c, i)
    place = position_of_reading(base, p.c, x, current)
    first = math.isnan(z[INPUTS])
    n_i = n_x = nis = math.nan
    valid = False
    if first or not numbers[5] <= place <= numbers[6]:
        begin(plant, numbers, active, z, P, current, place, x, first)
    else:
        n_i, n_x, nis = ekf_step(plant, numbers, active, z, P, work, i, x)
        z[TICKS] += 1.0
        if not (math.isfinite(nis) and numbers[5] <= z[X] <= numbers[6]):  # the filter, not the ball, is at a stop
            begin(plant, numbers, active, z, P, current, place, x, first)
        valid = z[TICKS] > numbers[7]
    for k in range(len(z) - 1, INPUTS, -1):
        z[k] = u if first else z[k - 1]
    z[INPUTS] = u
    return n_i, n_x, nis, valid


class Observer:
    """The filter's numbers and its memory, as `observe` takes them.

    Args:
        plant: the model, frozen for one T_s.
        noise: of the model file.
        i_lsb_a: one count of the current converter, A; 0 where unknown.
        x_lsb_m: one count of the position converter, m; 0 where unknown.
    """

    def __init__(self, plant: PlantNumbers, noise: Noise, *, i_lsb_a: float = 0.0, x_lsb_m: float = 0.0) -> None:
        travel_m = Base(*plant.base).travel_m
        margin_m = max(CONTACT_SHARE * travel_m, 10.0 * noise.sigma_x_m)
        q = np.array([noise.process_i_c_a, 0.0, noise.process_a_m_s2 * plant.sample_time_s]) ** 2
        r = np.array([noise.sigma_i_c_a**2 + i_lsb_a**2 / 12.0, noise.sigma_x_m**2 + x_lsb_m**2 / 12.0])
        settle_ticks = float(max(1, round(SETTLE_S / plant.sample_time_s)))
        self.numbers: Packed = (*q.tolist(), *r.tolist(), margin_m, travel_m - margin_m, settle_ticks)
        c = plant.c
        own = (
            (FIELD, c[eddy_current_lag.TAU] > 0.0),
            (SENSOR, c[position_sensor_lag.TAU] > 0.0),
            (WARMTH, c[amplifier_gain_drift.LOSS] != 0.0),
        )
        self.active = np.array([I_C, X, V, *(state for state, lives in own if lives)])
        m = len(self.active)
        self.z = np.zeros(INPUTS + plant.in_whole + 2)
        self.z[INPUTS] = math.nan
        self.P = np.zeros((m, m))
        self.work = np.zeros((3 * m + 3, STATES))
