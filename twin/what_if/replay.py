"""The replay of a flight's disturbances in a closed loop under another law.

The filter splits a flight into the model's prediction and what the model did not predict: the innovation e of each
reading, and the correction d of the state.  In innovation form (T. Kailath, An Innovations Approach to Least-Squares
Estimation I, IEEE Trans. Automatic Control 13 (1968)) the rig is the model driven by u_c, d and e:

    y(k) = f(y(k-1) + d(k-1), u_c),   reading(k) = h(y(k)) + e(k),   u_c(k) = law(readings up to k)

Rule 1: d and e do not depend on the law.  Under the law that was flown, the replay is the recorded flight.
Rule 2: e holds noise, rounding and every error of the model in the readings, d those of the motion.
Rule 3: a ball that reaches a stop is lost; what it does afterwards is not predicted.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from twin.compiled import Packed, kernel
from twin.control import LawNumbers, law, rounded
from twin.estimation.propagate import copy, input_over, propagate
from twin.estimation.record import FloatArray
from twin.estimation.structures import System
from twin.model.extended import SENSOR, STATES, Base, X, reading_of_current
from twin.model.integration import STOPS

NEVER = -1


class Disturbances(NamedTuple):
    """The disturbances of a flight with n samples, without its first sample."""

    state: NDArray[np.float64]  # d, corrections of the state, shape (n - 1, STATES)
    readings: NDArray[np.float64]  # e, of i_c (A) and x (m), shape (n - 1, 2)


class Reference(NamedTuple):
    """The reference of a replay, and which disturbances act; arrays of shape (n,)."""

    x_ref: NDArray[np.float64]  # m
    step: NDArray[np.float64]  # s, since the sample before
    order: NDArray[np.int64]  # index of the disturbance of each sample


def disturbances(
    system: System, u: FloatArray, step: FloatArray, state: FloatArray, readings: FloatArray
) -> Disturbances:
    """Split a flight into prediction and disturbances.

    Args:
        system: the model of the filter that gave the states.
        u: u_c that acts from each sample on, V, shape (n,).
        step: time since the sample before, s, shape (n,).
        state: corrected states, shape (n, STATES).
        readings: of i_c (A) and x (m), shape (n, 2); NaN: none, and then its e is 0.
    """
    n = len(u)
    result = Disturbances(np.zeros((n - 1, STATES)), np.zeros((n - 1, 2)))
    _split(system.base, system.c, u, step, state, readings, *result)
    return result


@kernel
def _split(
    base: Packed,
    c: NDArray[np.float64],
    u: NDArray[np.float64],
    step: NDArray[np.float64],
    state: NDArray[np.float64],
    readings: NDArray[np.float64],
    d: NDArray[np.float64],
    e: NDArray[np.float64],
) -> None:
    y = np.empty(STATES)
    for k in range(1, len(u)):
        # From the corrected state each time: d is what one step missed, not what has added up.
        copy(y, state[k - 1])
        propagate(base, c, y, input_over(c, u, k, 0, step[k]), 0.0, step[k], STOPS)
        predicted = (reading_of_current(c, y), y[SENSOR])
        for n in range(2):
            if np.isfinite(readings[k, n]):
                e[k - 1, n] = readings[k, n] - predicted[n]
        for n in range(STATES):
            d[k - 1, n] = state[k, n] - y[n]


@kernel
def replay(
    base: Packed,
    c: NDArray[np.float64],
    law_: Packed,
    reference: Reference,
    disturbed: Disturbances,
    begin: NDArray[np.float64],
    before: NDArray[np.float64],
    memory: NDArray[np.float64],
    u_lsb: float,
    out: NDArray[np.float64],
) -> int:
    """Fill out, shape (3, n), with the readings of i_c (A) and x (m), and u_c (V).

    Args:
        base: tuple(Base).
        c: the causes' parameters, shape (PLACES,).
        law_: tuple(LawNumbers).
        reference: of the replay.
        disturbed: the flight's disturbances.
        begin: state at the first sample, shape (STATES,).
        before: inputs sent before the first sample and not yet acting, V, oldest first; their number is the delay.
        memory: readings of i_c (A) and x (m) at the first sample, x at the sample before, integral (m s), shape (4,).
        u_lsb: one count of u_c, V; 0: no rounding.
        out: receives the result.

    Returns:
        The sample at which the ball reaches a stop; NEVER if it does not.
    """
    numbers, travel = LawNumbers(*law_), Base(*base).travel_m
    n, delay = len(reference.x_ref), len(before)
    acting = np.empty(n + delay)
    acting[:delay] = before
    y = begin.copy()
    i, x, x_before, s = memory[0], memory[1], memory[2], memory[3]
    for k in range(n):
        if k > 0:
            T_s = reference.step[k]
            propagate(base, c, y, input_over(c, acting, k, 0, T_s), 0.0, T_s, STOPS)
            if y[X] <= 0.0 or y[X] >= travel:
                out[:, k:] = np.nan
                return k
            at = reference.order[k]
            i = reading_of_current(c, y) + disturbed.readings[at, 0]
            x_before, x = x, y[SENSOR] + disturbed.readings[at, 1]
            # After the readings: the filter found d from them, so it acts from this sample on.
            for m in range(STATES):
                y[m] += disturbed.state[at, m]
        u, s = law(numbers, i, x, x_before, s, reference.x_ref[k])
        u = rounded(u, u_lsb)
        acting[k + delay] = u
        out[0, k], out[1, k], out[2, k] = i, x, u
    return NEVER
