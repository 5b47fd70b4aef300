"""Multi-step prediction error of x(k + N), predicted from the filter's estimate at k with the measured u_c.

Recordings that were not used for fitting show errors that a fit hides.  So do horizons that are long compared with the
unstable pole's time constant of 13 ms.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from protocol.campaign import Plant
from twin.estimation.ekf.filter import filtered
from twin.estimation.innovations import Series
from twin.estimation.prepare import prepare
from twin.estimation.record import FloatArray, Record
from twin.estimation.rollout import roll_out
from twin.estimation.structures import System
from twin.inference.theta import Theta

HORIZONS_S = (2e-3, 10e-3, 20e-3, 40e-3)


def horizons(tick_s: float) -> list[int]:
    """Return HORIZONS_S in samples of this sampling time, each once."""
    return sorted({max(round(horizon_s / tick_s), 1) for horizon_s in HORIZONS_S})


@dataclass(frozen=True, slots=True, kw_only=True)
class Horizon:
    """Error of the prediction of x at one horizon."""

    horizon_s: float
    rmse_m: float
    constant_m: float  # rmse of the constant prediction "constant x"
    count: int


def error_at(horizon_s: float, records: list[Record], plant: Plant, theta: Theta, tick_s: float) -> Horizon | None:
    """Return the error at a horizon over all flights of the records with u_c; None without a prediction.

    `tick_s` is the interval of the process noise.
    """
    series, _ = prepare(records, plant)
    system = theta.system(plant, tick_s)
    state = filtered(system, series.samples, state=True).state
    ahead = max(round(horizon_s / tick_s), 1)
    error, constant = errors(system, series, state, ahead)
    count = int(np.isfinite(error).sum())
    if not count:
        return None
    return Horizon(
        horizon_s=ahead * tick_s,
        rmse_m=float(np.sqrt(np.nanmean(error**2))),
        constant_m=float(np.sqrt(np.nanmean(constant**2))),
        count=count,
    )


def errors(system: System, series: Series, state: FloatArray, ahead: int) -> tuple[FloatArray, FloatArray]:
    """Return the errors of the prediction of x, and of a constant x, m, each of shape (n,); NaN without one.

    `state` are the corrected states along the series, shape (n, STATES); `ahead` is the horizon N in samples, from 1.
    """
    error = series.x - roll_out(system, series.samples, state, ahead, stops=True)
    constant = np.full(len(error), np.nan)
    # "Constant x" as the yardstick: in a loop that holds the ball it is hard to beat, and it has no number to choose.
    constant[ahead:] = series.x[ahead:] - series.x[:-ahead]
    # Both predictions are judged on the same samples.
    constant[np.isnan(error)] = np.nan
    return error, constant
