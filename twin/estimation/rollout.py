"""Prediction of x N samples ahead, from the filter's estimate with the measured u_c.

Rule 1: the prediction of sample k uses the readings up to k - N and the inputs up to k, nothing else.
Rule 2: the predicted quantity is the reading of the position sensor, with offset, scale and lag.  So it can be compared
        with the recorded reading.
Rule 3: with `stops` the predicted ball stays between the stops, as on the rig.  The search compares models without
        stops, because a stop hides the error of a model; reports then print the predictions of `within_reach`.
Rule 4: a contact with a stop or a lost sample between k - N and k leaves sample k without a prediction.  So does a
        missing x(k), or a filter that had less than `settle_s` of the flight to estimate the speed.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from twin.compiled import kernel
from twin.estimation.contact import STOP_SHARE
from twin.estimation.ekf.filter import filtered
from twin.estimation.ekf.lines import lines_of_position
from twin.estimation.ekf.memory import Memory, memory_for
from twin.estimation.ekf.predict import advance
from twin.estimation.innovations import FLIES, FOLLOWS, LOST, USE_X
from twin.estimation.propagate import copy, input_over
from twin.estimation.structures import Samples, Stops, System
from twin.model.extended import SENSOR, X_COLOUR, Base, position_reading
from twin.model.integration import STOPS

_INPUT_SAMPLES = 3  # samples after a lost one whose readings determine its input
SETTLE_S = 0.1  # eight times 1 / (unstable pole) = 12 ms, within which an estimate forgets its start


def predict_ahead(system: System, samples: Samples, ahead: int, *, settle_s: float = SETTLE_S) -> NDArray[np.float64]:
    """Run the filter over a series and predict x from each estimate.

    Args:
        system: the model and its noise.
        samples: of the series.
        ahead: horizon N in samples, 1 or more.
        settle_s: time in flight before the first estimate that is used, s.

    Returns:
        x_hat, shape (n,): the reading of each sample, predicted `ahead` samples earlier, m; NaN without a prediction.
    """
    return roll_out(system, samples, filtered(system, samples, state=True).state, ahead, settle_s=settle_s)


def roll_out(
    system: System,
    samples: Samples,
    state: NDArray[np.float64],
    ahead: int,
    *,
    settle_s: float = SETTLE_S,
    stops: bool = False,
) -> NDArray[np.float64]:
    """Run `predict_ahead` from given corrected states, shape (n, STATES); `stops`: whether the stops limit x."""
    settle = max(round(settle_s / system.noise.tick_s), 2)
    x_hat = np.empty(len(samples.u))
    _roll(memory_for(system), samples, state, ahead, settle, stops, x_hat)
    return x_hat


def window(
    system: System, samples: Samples, state: NDArray[np.float64], begin: int, length: int
) -> NDArray[np.float64]:
    """Return the readings of x predicted from one estimate with u_c alone, with stops.

    Args:
        system: the model and its noise.
        samples: of the series.
        state: corrected states, shape (n, STATES).
        begin: the sample of the estimate.
        length: samples, including `begin`.

    Returns:
        x_hat, shape (length,), m.
    """
    starts = np.flatnonzero(samples.flags[: begin + 1] & FOLLOWS == 0)
    x_hat = np.empty(length)
    _roll_once(memory_for(system), samples, state, begin, int(starts[-1]) if len(starts) else 0, x_hat)
    return x_hat


def within_reach(x_hat: NDArray[np.float64], base: Base, c: NDArray[np.float64], stops: Stops) -> NDArray[np.float64]:
    """The predictions, limited to the stops and a margin for their apparent displacement (NEAR_SHARE), shape (n,).

    Near the coil's plane the error of a wrong model grows to ten travels in 20 ms, which is not a useful number.

    Args:
        x_hat: predictions, m, shape (n,).
        base: the paper's parameters and the plant.
        c: the causes' parameters, shape (PLACES,).
        stops: positions of the ball at the stops.
    """
    margin = STOP_SHARE * base.travel_m
    low, high = (float(position_reading(base, c, x_m, 0.0)) for x_m in (stops.low_m, base.travel_m + stops.high_m))
    return np.clip(x_hat, low - margin, high + margin)


@kernel
def _roll(
    f: Memory,
    samples: Samples,
    state: NDArray[np.float64],
    ahead: int,
    settle: int,
    stops: bool,
    x_hat: NDArray[np.float64],
) -> None:
    t, step, u, _, _, flags, noise_ratio = samples
    y = f.y[:]
    unbroken = 0  # samples of this flight before the present one
    known = 0  # samples of this flight since the last lost one
    for n in range(len(u)):
        x_hat[n] = np.nan
        follows = flags[n] & FOLLOWS != 0
        if not follows:
            f.first = n
        flies = flags[n] & FLIES != 0
        unbroken = unbroken + 1 if flies and follows and n > 0 and flags[n - 1] & FLIES != 0 else 0
        known = known + 1 if unbroken > 0 and flags[n] & LOST == 0 else 0
        begin = n - ahead
        if (
            known < ahead + _INPUT_SAMPLES
            or unbroken < ahead + settle
            or flags[n] & USE_X == 0
            or np.isnan(state[begin, 0])
        ):
            continue
        # From each estimate anew, not in one free run: the ball is unstable, and an error grows by e every 13 ms.
        copy(y, state[begin])
        for k in range(begin + 1, n + 1):
            advance(f, y, input_over(f.c[:], u, k, f.first, step[k]), t[k - 1], step[k], stops)
        if np.isfinite(y[SENSOR]):
            x_hat[n] = y[SENSOR]
            if f.x_colour >= 0:
                x_hat[n] += y[X_COLOUR] * (math.sqrt(noise_ratio[n, 1]) if noise_ratio.shape[0] > 0 else 1.0)
            x_hat[n] += lines_of_position(f, y, f.h_x[:])


@kernel
def _roll_once(
    f: Memory, samples: Samples, state: NDArray[np.float64], begin: int, first: int, x_hat: NDArray[np.float64]
) -> None:
    y, f.first = f.y[:], first
    copy(y, state[begin])
    x_hat[0] = y[SENSOR] + lines_of_position(f, y, f.h_x[:])
    for k in range(1, len(x_hat)):
        n = begin + k
        T_s = samples.step[n]
        advance(f, y, input_over(f.c[:], samples.u, n, first, T_s), samples.t[n - 1], T_s, STOPS)
        x_hat[k] = y[SENSOR] + lines_of_position(f, y, f.h_x[:])
