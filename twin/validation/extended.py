"""The model with its causes, as `validate` uses it: for the filter, as readings, and its amplifier.

Rule: the phase of a periodic force is unknown, so the force is left out and the notes report it (`simulate.left_out`).
"""

from __future__ import annotations

import numpy as np

from twin.estimation.propagate import input_over, propagate, see_delays
from twin.estimation.record import FloatArray, Record
from twin.estimation.structures import AT_THE_ENDS, NoiseLevels, System
from twin.model.extended import SENSOR, STATES, V, X, current_of_reading, reading_of_current, settle_current
from twin.model.extension import base
from twin.model.integration import FREE
from twin.model.parameters import Model
from twin.model.simulate import plant_numbers


def system_of(model: Model, record: Record) -> System:
    """The model in the form of the filter, with the quantisation of this recording added to its noise."""
    n, tick_s = model.noise, record.interval_s
    noise = NoiseLevels(
        sigma_i_c_a=float(np.hypot(n.sigma_i_c_a, record.lsb[0] / np.sqrt(12.0))),
        sigma_x_m=float(np.hypot(n.sigma_x_m, record.lsb[1] / np.sqrt(12.0))),
        process_i_c_a=n.process_i_c_a,
        process_a_m_s2=n.process_a_m_s2,
        tick_s=tick_s,
    )
    c = plant_numbers(model, tick_s).c
    return System(tuple(base(model)), c, noise, AT_THE_ENDS, closed_form=not model.causes)


def as_readings(state: FloatArray, model: Model) -> FloatArray:
    """Turn states, shape (n, STATES), into readings of i_c and x, and the speed; shape (n, 3), in A, m, m/s."""
    c = plant_numbers(model, 1e-3).c
    readings = np.empty((len(state), 3))
    readings[:, 0] = [reading_of_current(c, y) for y in state]
    readings[:, 1], readings[:, 2] = state[:, SENSOR], state[:, V]
    return readings


def current(
    u: FloatArray, step: FloatArray, start_a: float, x: FloatArray, model: Model, *, captured: bool
) -> FloatArray:
    """Return the reading of i_c under u_c with the ball at its recorded positions, A, shape (n,).

    Args:
        u: u_c from each sample on, V, shape (n,).
        step: time since the previous sample, s, shape (n,).
        start_a: first reading, A.
        x: positions of the ball, m, shape (n,).
        model: with causes.
        captured: whether the readings are a capture.
    """
    # T_s has no part in c: any will do.
    c, p = plant_numbers(model, 1e-3).c, tuple(base(model))
    see_delays(c, c, captured)
    y = np.zeros(STATES)
    settle_current(c, y, current_of_reading(c, start_a))
    readings = np.empty(len(u))
    readings[0] = start_a
    for k in range(1, len(u)):
        # The recorded position, not the model's: an error of (6) must not count against (1).
        y[X], y[V] = x[k - 1], 0.0
        T_s = float(step[k])
        propagate(p, c, y, input_over(c, u, k, 0, T_s), 0.0, T_s, FREE)
        readings[k] = reading_of_current(c, y)
    return readings
