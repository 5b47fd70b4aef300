"""N samples ahead: from the filter's estimate at a sample, with the measured u_c, to the reading of x N samples on.

Rule 1: the prediction of sample k knows the readings up to k - N and the inputs up to k, nothing else.
Rule 2: what is predicted is what the position sensor will show (offset, scale, lag and all), so that it is compared
        with what it did show.
Rule 3: where a ball is held by the stops, as the rig's is, a model that pulls too hard is wrong by the travel at most,
        not by metres.  Where the search compares models it is not: a model must not gain by a stop.  Then what is told
        to people is `within_reach`.
Rule 4: no prediction where the ball met a stop, a sample was lost or x is no reading between k - N and k, nor before
        the filter has had `settle_s` of the flight to find the speed.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from twin.compiled import kernel
from twin.estimation.contact import NEAR_SHARE
from twin.estimation.ekf.filter import filtered
from twin.estimation.ekf.memory import Memory, memory_for
from twin.estimation.ekf.predict import advance
from twin.estimation.innovations import FLIES, FOLLOWS, LOST, USE_X
from twin.estimation.propagate import copy
from twin.estimation.structures import Samples, Stops, System
from twin.model.extended import SENSOR, Base, position_reading

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
    stops: bool = False,
) -> NDArray[np.float64]:
    """`predict_ahead` from corrected states that are known, shape (n, 7); `stops`: whether they hold the ball."""
    settle = max(round(settle_s / system.noise.tick_s), 2)
    x_hat = np.empty(len(samples.u))
    _roll(memory_for(system), samples, state, ahead, settle, stops, x_hat)
    return x_hat


def window(
    system: System, samples: Samples, state: NDArray[np.float64], begin: int, length: int
) -> NDArray[np.float64]:
    """Readings from one estimate on, by u_c alone, the ball held by the stops.

    Args:
        system: the model and its noise.
        samples: of the series.
        state: corrected, shape (n, 7).
        begin: the sample whose estimate it is.
        length: samples, that one included.

    Returns:
        x_hat, shape (length,), m.
    """
    starts = np.flatnonzero(samples.flags[: begin + 1] & FOLLOWS == 0)
    x_hat = np.empty(length)
    _along(memory_for(system), samples, state, begin, int(starts[-1]) if len(starts) else 0, x_hat)
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
    f: Memory,
    samples: Samples,
    state: NDArray[np.float64],
    ahead: int,
    settle: int,
    stops: bool,
    x_hat: NDArray[np.float64],
) -> None:
    t, step, u, _, _, flags, _ = samples
    y = f.y[:]
    unbroken = 0  # samples of this flight before the present one
    known = 0  # of them, how many since one was lost
    for n in range(len(u)):
        x_hat[n] = np.nan
        follows = flags[n] & FOLLOWS != 0
        if not follows:
            f.first = n
        flies = flags[n] & FLIES != 0
        unbroken = unbroken + 1 if flies and follows and n > 0 and flags[n - 1] & FLIES != 0 else 0
        known = known + 1 if unbroken > 0 and flags[n] & LOST == 0 else 0
        begin = n - ahead
        if known < ahead + _FOUND or unbroken < ahead + settle or flags[n] & USE_X == 0 or np.isnan(state[begin, 0]):
            continue
        copy(y, state[begin])
        for k in range(begin + 1, n + 1):
            advance(f, y, u, k, t[k - 1], step[k], stops)
        if np.isfinite(y[SENSOR]):
            x_hat[n] = y[SENSOR]


@kernel
def _along(
    f: Memory, samples: Samples, state: NDArray[np.float64], begin: int, first: int, x_hat: NDArray[np.float64]
) -> None:
    y, f.first = f.y[:], first
    copy(y, state[begin])
    x_hat[0] = y[SENSOR]
    for k in range(1, len(x_hat)):
        n = begin + k
        advance(f, y, samples.u, n, samples.t[n - 1], samples.step[n], True)
        x_hat[k] = y[SENSOR]
