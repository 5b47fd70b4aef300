"""Multi-step prediction error: from the filter's estimate at k, with the measured u_c alone, to the x of k + N.

The figure that a fit cannot flatter: it is taken on recordings that were never used, at horizons long compared with
the unstable pole's 13 ms.

Rule 1: a predicted ball stays between the stops, as the rig's does, and stands where it reaches one: a model that pulls
        too hard is wrong by the travel at most, not by metres.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from protocol.campaign import Plant
from twin.compiled import Packed, kernel
from twin.estimation.innovations import FLIES, FOLLOWS, USE_X
from twin.estimation.prepare import prepare
from twin.estimation.record import Record
from twin.estimation.transition import Physics, moments, transit
from twin.identify.fit import Likelihood, Point, physics

HORIZONS_S = (2e-3, 10e-3, 20e-3, 40e-3)


@dataclass(frozen=True, slots=True, kw_only=True)
class Horizon:
    """Prediction of x so far ahead."""

    horizon_s: float
    rmse_m: float
    still_m: float  # the same for "x stays where it is"
    count: int


@kernel
def predict(
    numbers: Packed,
    state: NDArray[np.float64],
    step: NDArray[np.float64],
    u: NDArray[np.float64],
    x: NDArray[np.float64],
    flags: NDArray[np.uint8],
    ahead: int,
    settle: int,
    error: NDArray[np.float64],
    still: NDArray[np.float64],
) -> None:
    """Fill error and still, shape (n,), at the sample predicted; NaN where there is no prediction."""
    p = Physics(*numbers)
    m = np.empty(9)
    at = -1.0
    free = 0  # samples of this flight so far
    unbroken = 0
    for n in range(len(u)):
        error[n] = still[n] = np.nan
        flies = flags[n] & FLIES != 0
        unbroken = unbroken + 1 if flies and flags[n] & FOLLOWS != 0 else 0
        free = unbroken
        begin = n - ahead
        if free < ahead + settle or flags[n] & USE_X == 0 or not state[begin, 0] == state[begin, 0]:
            continue
        i_at, x_at, v_at = state[begin, 0], state[begin, 1], state[begin, 2]
        for k in range(begin, n):
            T_s = step[k + 1]
            if T_s != at:
                moments(T_s, p.T_A, m)
                at = T_s
            i_at, x_at, v_at = transit(p, m, T_s, i_at, x_at, v_at, u[k])
            if x_at < 0.0:
                x_at, v_at = 0.0, 0.0
            elif x_at > p.travel_m:
                x_at, v_at = p.travel_m, 0.0
        error[n] = x[n] - x_at
        still[n] = x[n] - x[begin]


def horizons(
    records: list[Record], plant: Plant, point: Point, tick_s: float, *, wanted_s: tuple[float, ...] = HORIZONS_S
) -> list[Horizon]:
    """Errors over all flights of the records, one row per horizon.

    Args:
        records: in flight, with u_c; usually those with use = "judge".
        plant: of the campaign.
        point: parameters and noise levels of the filter.
        tick_s: interval that the process noise refers to.
        wanted_s: horizons.
    """
    series, _ = prepare(records, plant)
    likelihood = Likelihood(series, plant, tick_s)
    state = likelihood.states(point)
    numbers = tuple(physics(point, plant))
    result = []
    for horizon in wanted_s:
        ahead = max(round(horizon / tick_s), 1)
        error, still = np.empty(len(series)), np.empty(len(series))
        settle = max(round(0.1 / tick_s), 2)
        predict(numbers, state, series.step, series.u, series.x, series.flags, ahead, settle, error, still)
        count = int(np.isfinite(error).sum())
        result.append(
            Horizon(
                horizon_s=ahead * tick_s,
                rmse_m=float(np.sqrt(np.nanmean(error**2))) if count else float("nan"),
                still_m=float(np.sqrt(np.nanmean(still**2))) if count else float("nan"),
                count=count,
            )
        )
    return result
