"""N samples ahead: from the filter's estimate at a sample, with the measured u_c, to the reading of x N samples on.

Rule 1: the prediction of sample k knows the readings up to k - N and the inputs up to k, nothing else.
Rule 2: what is predicted is what the position sensor will show (offset, scale, lag and all), so that it is compared
        with what it did show.
Rule 3: what is told to people is `within_reach`: a ball does not go through a stop.
Rule 4: no prediction where the ball met a stop, a sample was lost or x is no reading between k - N and k, nor before
        the filter has had `settle_s` of the flight to find the speed.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from twin.compiled import Packed, kernel
from twin.estimation.contact import NEAR_SHARE
from twin.estimation.ekf import LOST, OUT_COLUMNS, drive_over, run_extended
from twin.estimation.innovations import FLIES, FOLLOWS, USE_X
from twin.model.extended import SENSOR, STATES, Base, position_reading

_FOUND = 3  # samples behind a lost one whose readings tell its input
SETTLE_S = 0.1  # an estimate forgets its start within 1 / (unstable pole) = 12 ms; eight of them


def predict_ahead(
    base: Packed,
    c: NDArray[np.float64],
    noise: tuple[float, float, float, float, float],
    stops_m: tuple[float, float],
    t: NDArray[np.float64],
    step: NDArray[np.float64],
    u: NDArray[np.float64],
    y_i: NDArray[np.float64],
    y_x: NDArray[np.float64],
    flags: NDArray[np.uint8],
    tick_s: float,
    ahead: int,
    *,
    settle_s: float = SETTLE_S,
) -> NDArray[np.float64]:
    """The filter over a series, and from each of its estimates `ahead` samples onwards.

    Args:
        base: tuple(Base).
        c: the causes' parameters, shape (PLACES,).
        noise: as `run_extended` takes it.
        stops_m: as there.
        t: s, shape (n,).
        step: time to the sample before, s, shape (n,).
        u: u_c from each sample on, V, shape (n,).
        y_i: measured i_c, A, shape (n,).
        y_x: measured x, m, shape (n,).
        flags: of each sample, shape (n,).
        tick_s: the sampling interval, s.
        ahead: samples, 1 or more.
        settle_s: of a flight, before the first estimate that is used, s.

    Returns:
        x_hat, shape (n,): the reading predicted for each sample `ahead` samples earlier, m; NaN where there is none.
    """
    state = np.empty((len(u), STATES))
    run_extended(base, c, noise, stops_m, t, step, u, y_i, y_x, flags, np.empty((len(u), OUT_COLUMNS)), state)
    x_hat = np.empty(len(u))
    everywhere = np.ones(len(u), np.bool_)
    roll(base, c, t, step, u, flags, state, ahead, max(round(settle_s / tick_s), 2), everywhere, x_hat)
    return x_hat


def within_reach(
    x_hat: NDArray[np.float64], base: Base, c: NDArray[np.float64], stops_m: tuple[float, float]
) -> NDArray[np.float64]:
    """The predictions, shape (n,), none farther behind a stop than a stop may seem displaced: the ball ends there.

    Near the coil's plane a wrong model throws it ten travels in 20 ms, and such a number tells nobody anything.
    The other arguments are those of `predict_ahead`.
    """
    margin = NEAR_SHARE * base.travel_m
    low, high = (float(position_reading(base, c, place, 0.0)) for place in (stops_m[0], base.travel_m + stops_m[1]))
    return np.clip(x_hat, low - margin, high + margin)


@kernel
def roll(
    base: Packed,
    c: NDArray[np.float64],
    t: NDArray[np.float64],
    step: NDArray[np.float64],
    u: NDArray[np.float64],
    flags: NDArray[np.uint8],
    state: NDArray[np.float64],
    ahead: int,
    settle: int,
    wanted: NDArray[np.bool_],
    x_hat: NDArray[np.float64],
) -> None:
    """Fill x_hat, shape (n,), where it is wanted, from the corrected states, shape (n, 6).

    The other arguments are those of `predict_ahead`.
    """
    y = np.empty(STATES)
    first = 0  # sample of this chain
    unbroken = 0  # samples of this flight before the present one
    known = 0  # of them, how many since one was lost
    for n in range(len(u)):
        if wanted[n]:
            x_hat[n] = np.nan
        follows = flags[n] & FOLLOWS != 0
        if not follows:
            first = n
        flies = flags[n] & FLIES != 0
        unbroken = unbroken + 1 if flies and follows and n > 0 and flags[n - 1] & FLIES != 0 else 0
        known = known + 1 if unbroken > 0 and flags[n] & LOST == 0 else 0
        begin = n - ahead
        if (
            not wanted[n]
            or known < ahead + _FOUND
            or unbroken < ahead + settle
            or flags[n] & USE_X == 0
            or np.isnan(state[begin, 0])
        ):
            continue
        for k in range(STATES):
            y[k] = state[begin, k]
        for k in range(begin + 1, n + 1):
            drive_over(base, c, y, u, k, first, t[k - 1], step[k], False)
        if np.isfinite(y[SENSOR]):
            x_hat[n] = y[SENSOR]
