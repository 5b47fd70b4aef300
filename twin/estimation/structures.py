"""Arguments and results of the filter: named tuples of arrays and numbers.

An array of length 0 marks a quantity that is unknown or not requested.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from twin.compiled import Packed
from twin.model.extended import STATES

OUT_COLUMNS = 5  # nu_i, nu_x, S_ii, S_ix, S_xx; NaN without a prediction


class NoiseLevels(NamedTuple):
    """Standard deviations of the noise, and the colour of that of the readings.

    A share of a reading's variance is white, the rest is forgotten exponentially (Ornstein-Uhlenbeck).
    """

    sigma_i_c_a: float  # of a reading, A
    sigma_x_m: float  # of a reading, m
    process_i_c_a: float  # disturbance of i_c in a tick, A; its variance is proportional to the interval
    process_a_m_s2: float  # acceleration, constant over an interval, m/s^2
    tick_s: float  # s
    tau_i_c_s: float = 0.0  # correlation time of the coloured part; 0: all is white
    white_i_c: float = 1.0  # share of the variance that is white, with a correlation time
    tau_x_s: float = 0.0
    white_x: float = 1.0
    tau_i_c_captured_s: float = 0.0  # of captures and recordings as fast, which another instrument may have taken
    white_i_c_captured: float = 1.0


NOISES = NoiseLevels._fields[:4]
COLOURS = NoiseLevels._fields[5:]


class Stops(NamedTuple):
    """Positions of the ball at the stops."""

    low_m: float  # m
    high_m: float  # above the travel, m


AT_THE_ENDS = Stops(0.0, 0.0)


class System(NamedTuple):
    """A model and its noise."""

    base: Packed  # tuple(Base)
    c: NDArray[np.float64]  # the causes' parameters, shape (PLACES,)
    noise: NoiseLevels
    stops: Stops
    # The model is (1) and (6) without causes, advanced by `ekf/transition.py`.  u_c is in force from its sample on, and
    # the current does not depend on the ball.
    closed_form: bool = False


EQUAL_NOISE = np.empty((0, 2))  # all readings of a channel have the same noise


class Samples(NamedTuple):
    """Readings in order, arrays of shape (n,)."""

    t: NDArray[np.float64]  # s, with the phase of periodic causes
    step: NDArray[np.float64]  # s, since the previous sample
    u: NDArray[np.float64]  # V, from this sample on
    i: NDArray[np.float64]  # A
    x: NDArray[np.float64]  # m
    flags: NDArray[np.uint16]  # see `innovations.py` and `ekf/filter.py`
    # Variance of the noise of i and x over that of their levels, shape (n, 2).
    noise_ratio: NDArray[np.float64] = EQUAL_NOISE

    def part(self, piece: slice) -> Samples:
        """A slice of the samples, as views."""
        t, step, u, i, x, flags, noise_ratio = self
        return Samples(t[piece], step[piece], u[piece], i[piece], x[piece], flags[piece], noise_ratio[piece])


class Steps(NamedTuple):
    """The linearised steps and the gains of a run, for runs of nearby models; m active states."""

    slopes: NDArray[np.float64]  # Jacobian d state / d previous state, shape (n, m, m)
    before: NDArray[np.float64]  # active states before the correction, shape (n, m)
    after: NDArray[np.float64]  # active states after the correction, shape (n, m)
    gains: NDArray[np.float64]  # Kalman gains of the readings of i_c and x, shape (n, 2, m)

    def part(self, piece: slice) -> Steps:
        """Return the part that belongs to some samples, as views."""
        return Steps(*(column[piece] for column in self))


class Results(NamedTuple):
    """Results of a run of the filter."""

    innovations: NDArray[np.float64]  # nu_i, nu_x, S_ii, S_ix, S_xx, shape (n, 5), NaN without a prediction
    state: NDArray[np.float64]  # after the correction, shape (n, STATES), NaN while the ball is not in flight
    spread: NDArray[np.float64]  # covariance of the active states after the correction, shape (n, m, m)
    steps: Steps

    def part(self, piece: slice) -> Results:
        """Return the part that belongs to some samples, as views."""
        return Results(self.innovations[piece], self.state[piece], self.spread[piece], self.steps.part(piece))


_NO_STATE, _NO_MATRIX = np.empty((0, STATES)), np.empty((0, 3, 3))
NO_STEPS = Steps(_NO_MATRIX, _NO_STATE, _NO_STATE, _NO_MATRIX)


def room_for(n: int, m: int, *, state: bool = False, spread: bool = False, steps: bool = False) -> Results:
    """Return the arrays for the results of n samples with m active states; those not requested have length 0."""
    return Results(
        innovations=np.empty((n, OUT_COLUMNS)),
        state=np.empty((n, STATES)) if state else _NO_STATE,
        spread=np.empty((n, m, m)) if spread else _NO_MATRIX,
        steps=Steps(*(np.zeros((n, *shape)) for shape in ((m, m), (m,), (m,), (2, m)))) if steps else NO_STEPS,
    )
