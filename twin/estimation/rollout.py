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

from twin.compiled import kernel
from twin.estimation.contact import NEAR_SHARE
from twin.estimation.ekf.filter import filtered
from twin.estimation.innovations import FLIES, FOLLOWS, LOST, USE_X
from twin.estimation.propagate import propagate
from twin.estimation.structures import Samples, Stops, System
from twin.model.extended import SENSOR, STATES, Base, position_reading

_FOUND = 3  # samples behind a lost one whose readings tell its input
SETTLE_S = 0.1  # an estimate forgets its start within 1 / (unstable pole) = 12 ms; eight of them


def predict_ahead(system: System, samples: Samples, ahead: int, *, settle_s: float = SETTLE_S) -> NDArray[np.float64]:
    """The filter over a series, and from each of its estimates `ahead` samples onwards.

    Args:
        system: the model and its noise.
        samples: of the series.
        ahead: samples, 1 or more.
        settle_s: of a flight, before the first estimate that is used, s.

    Returns:
        x_hat, shape (n,): the reading predicted for each sample `ahead` samples earlier, m; NaN where there is none.
    """
    return roll_out(system, samples, filtered(system, samples, state=True).state, ahead, settle_s=settle_s)


def roll_out(
    system: System,
    samples: Samples,
    state: NDArray[np.float64],
    ahead: int,
    *,
    settle_s: float = SETTLE_S,
) -> NDArray[np.float64]:
    """`predict_ahead` from corrected states that are known, shape (n, 6)."""
    settle = max(round(settle_s / system.noise.tick_s), 2)
    x_hat = np.empty(len(samples.u))
    _roll(system, samples, state, ahead, settle, x_hat)
    return x_hat


def within_reach(x_hat: NDArray[np.float64], base: Base, c: NDArray[np.float64], stops: Stops) -> NDArray[np.float64]:
    """The predictions, shape (n,), none farther behind a stop than a stop may seem displaced: the ball ends there.

    Near the coil's plane a wrong model throws it ten travels in 20 ms, and such a number tells nobody anything.
    The other arguments are those of `predict_ahead`.
    """
    margin = NEAR_SHARE * base.travel_m
    low, high = (float(position_reading(base, c, place, 0.0)) for place in (stops.low_m, base.travel_m + stops.high_m))
    return np.clip(x_hat, low - margin, high + margin)


@kernel
def _roll(
    system: System,
    samples: Samples,
    state: NDArray[np.float64],
    ahead: int,
    settle: int,
    x_hat: NDArray[np.float64],
) -> None:
    base, c, _, _ = system
    t, step, u, _, _, flags = samples
    y = np.empty(STATES)
    first = 0  # sample of this chain
    unbroken = 0  # samples of this flight before the present one
    known = 0  # of them, how many since one was lost
    for n in range(len(u)):
        x_hat[n] = np.nan
        follows = flags[n] & FOLLOWS != 0
        if not follows:
            first = n
        flies = flags[n] & FLIES != 0
        unbroken = unbroken + 1 if flies and follows and n > 0 and flags[n - 1] & FLIES != 0 else 0
        known = known + 1 if unbroken > 0 and flags[n] & LOST == 0 else 0
        begin = n - ahead
        if known < ahead + _FOUND or unbroken < ahead + settle or flags[n] & USE_X == 0 or np.isnan(state[begin, 0]):
            continue
        for k in range(STATES):
            y[k] = state[begin, k]
        for k in range(begin + 1, n + 1):
            propagate(base, c, y, u, k, first, t[k - 1], step[k], False)
        if np.isfinite(y[SENSOR]):
            x_hat[n] = y[SENSOR]
