"""What `validate` computes with a model that has causes: filter, predictions, windows and amplifier, by `extended.py`.

Rule: states handed on are as the sensors show them, so that they are compared with readings.  The phase of a periodic
      force is not known: it is left out, and the report's notes say so (`simulate.left_out`).
"""

from __future__ import annotations

import numpy as np

from twin.estimation.ekf.filter import filtered
from twin.estimation.innovations import FOLLOWS, Series, whiten
from twin.estimation.propagate import propagate
from twin.estimation.record import FloatArray
from twin.estimation.rollout import roll_out
from twin.estimation.structures import AT_THE_ENDS, NoiseLevels, Samples, System
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
    found = filtered(system_of(model, point.noise(tick_s)), samples_of(series), state=True)
    white = np.full((len(series), 2), np.nan)
    whiten(found.innovations, np.zeros(len(series)), white)
    return white, found.state


def system_of(model: Model, noise: NoiseLevels) -> System:
    """The model with this noise, as the filter takes them."""
    return System(tuple(base(model)), plant_numbers(model, noise.tick_s).c, noise, AT_THE_ENDS)


def samples_of(series: Series) -> Samples:
    """A series of one recording, as the filter takes it."""
    s = series
    return Samples(np.cumsum(s.step), s.step, s.u, s.i, s.x, s.flags)


def as_shown(state: FloatArray, model: Model) -> FloatArray:
    """i_c and x as the sensors show them, and x', of states of shape (n, 6); shape (n, 3)."""
    c = plant_numbers(model, 1e-3).c
    shown = np.empty((len(state), 3))
    shown[:, 0] = [current_reading(c, i) for i in state[:, I_C].tolist()]
    shown[:, 1], shown[:, 2] = state[:, SENSOR], state[:, V]
    return shown


def predictions(
    series: Series, state: FloatArray, model: Model, noise: NoiseLevels, ahead: int, settle_s: float
) -> FloatArray:
    """Reading of x predicted for each sample `ahead` samples earlier, m, shape (n,); NaN where there is none.

    Within the stops, as the rig's ball is: what the sensor shows there without a current.
    """
    system = system_of(model, noise)
    x_hat = roll_out(system, samples_of(series), state, ahead, settle_s=settle_s)
    p = Base(*system.base)
    stops = [position_reading(p, system.c, position, 0.0) for position in (0.0, p.travel_m)]
    return np.clip(x_hat, min(stops), max(stops))


def window(series: Series, state: FloatArray, model: Model, begin: int, length: int) -> FloatArray:
    """Readings of x from the estimate at `begin` on, by u_c alone, m, shape (length,); the last is NaN."""
    out = np.full(length, np.nan)
    c, y = plant_numbers(model, 1e-3).c, state[begin].copy()
    breaks = np.flatnonzero(series.flags[: begin + 1] & FOLLOWS == 0)
    first = int(breaks[-1]) if len(breaks) else 0
    out[0] = y[SENSOR]
    for k in range(1, length - 1):
        propagate(tuple(base(model)), c, y, series.u, begin + k, first, 0.0, float(series.step[begin + k]), True)
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
        propagate(p, c, y, u, k, 0, 0.0, float(step[k]), False)
        shown[k] = current_reading(c, y[I_C])
    return shown
