"""What `validate` computes with a model that has causes: filter, predictions, windows and amplifier, by `extended.py`.

Rule: states handed on are as the sensors show them, so that they are compared with readings.  The phase of a periodic
      force is not known: it is left out, and the report's notes say so (`simulate.left_out`).
"""

from __future__ import annotations

import numpy as np

from twin.estimation.ekf import OUT_COLUMNS, drive_over, run_extended
from twin.estimation.innovations import FOLLOWS, Series, whiten
from twin.estimation.record import FloatArray
from twin.estimation.rollout import roll
from twin.identify.fit import Point
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
    position_reading,
)
from twin.model.extension import base
from twin.model.parameters import Model
from twin.model.simulate import plant_numbers


def filter_extended(series: Series, point: Point, model: Model, tick_s: float) -> tuple[FloatArray, FloatArray]:
    """(whitened innovations, shape (n, 2); corrected states of `extended.py`, shape (n, 6)) of one recording."""
    n = len(series)
    out, state, white = np.empty((n, OUT_COLUMNS)), np.empty((n, STATES)), np.full((n, 2), np.nan)
    noise = (point.sigma_i_c_a, point.sigma_x_m, point.process_i_c_a, point.process_a_m_s2, tick_s)
    c = plant_numbers(model, tick_s).c
    s, t = series, np.cumsum(series.step)
    run_extended(tuple(base(model)), c, noise, (0.0, 0.0), t, s.step, s.u, s.i, s.x, s.flags, out, state)
    whiten(out, np.zeros(n), white)
    return white, state


def as_shown(state: FloatArray, model: Model) -> FloatArray:
    """i_c and x as the sensors show them, and x', of states of shape (n, 6); shape (n, 3)."""
    c = plant_numbers(model, 1e-3).c
    shown = np.empty((len(state), 3))
    shown[:, 0] = [current_reading(c, i) for i in state[:, I_C].tolist()]
    shown[:, 1], shown[:, 2] = state[:, SENSOR], state[:, V]
    return shown


def predictions(series: Series, state: FloatArray, model: Model, ahead: int, settle: int) -> FloatArray:
    """Reading of x predicted for each sample `ahead` samples earlier, m, shape (n,); NaN where there is none.

    Within the stops, as the rig's ball is: what the sensor shows there without a current.
    """
    x_hat = np.empty(len(series))
    t = np.cumsum(series.step)
    c = plant_numbers(model, 1e-3).c
    roll(
        tuple(base(model)),
        c,
        t,
        series.step,
        series.u,
        series.flags,
        state,
        ahead,
        settle,
        np.ones(len(t), np.bool_),
        x_hat,
    )
    p = Base(*base(model))
    stops = [position_reading(p, c, position, 0.0) for position in (0.0, p.travel_m)]
    return np.clip(x_hat, min(stops), max(stops))


def window(series: Series, state: FloatArray, model: Model, begin: int, length: int) -> FloatArray:
    """Readings of x from the estimate at `begin` on, by u_c alone, m, shape (length,); the last is NaN."""
    out = np.full(length, np.nan)
    c, y = plant_numbers(model, 1e-3).c, state[begin].copy()
    breaks = np.flatnonzero(series.flags[: begin + 1] & FOLLOWS == 0)
    first = int(breaks[-1]) if len(breaks) else 0
    out[0] = y[SENSOR]
    for k in range(1, length - 1):
        drive_over(tuple(base(model)), c, y, series.u, begin + k, first, 0.0, float(series.step[begin + k]), True)
        out[k] = y[SENSOR]
    return out


def current(u: FloatArray, step: FloatArray, start_a: float, x: FloatArray, model: Model) -> FloatArray:
    """Reading of i_c under u_c with the ball held where it was seen, A, shape (n,).

    Args:
        u: u_c from each sample on, V, shape (n,).
        step: time to the sample before, s, shape (n,).
        start_a: first reading.
        x: positions of the ball, m, shape (n,).
        model: with causes.
    """
    c, p = plant_numbers(model, 1e-3).c, tuple(base(model))
    y = np.zeros(STATES)
    y[I_C] = y[FIELD] = current_of_reading(c, start_a)
    y[WARMTH] = y[I_C] ** 2
    shown = np.empty(len(u))
    shown[0] = start_a
    for k in range(1, len(u)):
        y[X], y[V] = x[k - 1], 0.0
        drive_over(p, c, y, u, k, 0, 0.0, float(step[k]), False)
        shown[k] = current_reading(c, y[I_C])
    return shown
