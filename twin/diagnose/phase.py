"""Predictions under a periodic force whose phase nobody told: the model knows its size and frequency, not its clock.

Rule 1: a filter runs for each of PHASES phases; the prediction of sample k is that of the filter which has explained
        the readings up to k - N best.  Nothing later is looked at.
Rule 2: what lies longer back than MEMORY_S counts less: the frequency of the model is not exactly that of the table.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from twin.compiled import Packed, kernel
from twin.diagnose.filter import OUT_COLUMNS, run_extended
from twin.diagnose.horizon import SETTLE_S, roll
from twin.identify.innovations import whiten
from twin.model.causes import periodic_disturbance
from twin.model.extended import STATES

PHASES = 48  # the nearest is at most 4 degrees away: 7 % of the force is left, 3 % on average
MEMORY_S = 2.0


def has_phase(c: NDArray[np.float64]) -> bool:
    """Whether the causes c depend on a phase."""
    return bool(c[periodic_disturbance.AMPLITUDE] != 0.0)


def predict_in_phase(
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
    """`horizon.predict_ahead` for causes with a phase; the arguments and x_hat are the same."""
    n = len(u)
    best, x_hat = np.full(n, -np.inf), np.full(n, np.nan)
    forget = math.exp(-tick_s / MEMORY_S)
    state, out = np.empty((n, STATES)), np.empty((n, OUT_COLUMNS))
    for phase in range(PHASES):
        shifted = t + phase / PHASES / c[periodic_disturbance.FREQUENCY]
        run_extended(base, c, noise, stops_m, shifted, step, u, y_i, y_x, flags, out, state)
        loglik = np.zeros(n)
        whiten(out, loglik, np.empty((n, 2)))
        better = explains_better(loglik, forget, ahead, best)
        roll(base, c, shifted, step, u, flags, state, ahead, max(round(settle_s / tick_s), 2), better, x_hat)
    return x_hat


@kernel
def explains_better(
    loglik: NDArray[np.float64], forget: float, ahead: int, best: NDArray[np.float64]
) -> NDArray[np.bool_]:
    """Where this phase has explained the readings `ahead` samples earlier better than `best`, which is updated."""
    remembered = np.empty(len(loglik))
    better = np.zeros(len(loglik), np.bool_)
    total = 0.0
    for n in range(len(loglik)):
        total = forget * total + loglik[n]
        remembered[n] = total
        if n >= ahead and remembered[n - ahead] > best[n]:
            best[n], better[n] = remembered[n - ahead], True
    return better
