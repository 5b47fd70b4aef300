"""What the filter takes and gives, as its kernels take it: named tuples of arrays and numbers.

An array of length 0 stands for what nobody wants or knows.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from twin.compiled import Packed
from twin.model.extended import STATES

OUT_COLUMNS = 5  # nu_i, nu_x, S_ii, S_ix, S_xx; NaN where nothing was predicted


class NoiseLevels(NamedTuple):
    """Standard deviations of white noise."""

    sigma_i_c_a: float  # of a reading, A
    sigma_x_m: float  # of a reading, m
    process_i_c_a: float  # disturbance of i_c in a tick, A; over other intervals its variance grows with their length
    process_a_m_s2: float  # acceleration, constant over an interval, m/s^2
    tick_s: float  # s


NOISES = NoiseLevels._fields[:4]


class Stops(NamedTuple):
    """Where the ball lies at the stops."""

    low_m: float  # m
    high_m: float  # above the travel, m


AT_THE_ENDS = Stops(0.0, 0.0)


class System(NamedTuple):
    """A model and the noise that a filter expects about it."""

    base: Packed  # tuple(Base)
    c: NDArray[np.float64]  # the causes' parameters, shape (PLACES,)
    noise: NoiseLevels
    stops: Stops
    # (1) and (6) and nothing else: stepped by `ekf/transition.py`, u_c in force as recorded from the first sample on,
    # and the current deaf to the ball.
    closed_form: bool = False


ALIKE = np.empty((0, 2))  # each reading has the noise of its channel


class Samples(NamedTuple):
    """Readings in order, arrays of shape (n,)."""

    t: NDArray[np.float64]  # s, with the phase of periodic causes
    step: NDArray[np.float64]  # s, to the sample before
    u: NDArray[np.float64]  # V, from this sample on
    i: NDArray[np.float64]  # A
    x: NDArray[np.float64]  # m
    flags: NDArray[np.uint8]  # `innovations.py`, `ekf.py`
    noise_ratio: NDArray[np.float64] = ALIKE  # variance of the noise of i and x over that of their levels, shape (n, 2)

    def part(self, piece: slice) -> Samples:
        """Some of them, as views."""
        t, step, u, i, x, flags, noise_ratio = self
        return Samples(t[piece], step[piece], u[piece], i[piece], x[piece], flags[piece], noise_ratio[piece])


class Steps(NamedTuple):
    """The steps of a run in flight, linearised, for runs of models nearby; m active states."""

    slopes: NDArray[np.float64]  # d state / d state at the sample before, shape (n, m, m)
    before: NDArray[np.float64]  # the correction: states, shape (n, 7)
    after: NDArray[np.float64]  # shape (n, 7)

    def part(self, piece: slice) -> Steps:
        """Those of some samples, as views."""
        return Steps(*(column[piece] for column in self))

    @property
    def slopes_alone(self) -> Steps:
        """Without the states: a run takes the slopes from here and makes the steps itself."""
        return Steps(self.slopes, _NO_STATE, _NO_STATE)


class Results(NamedTuple):
    """What a run of the filter fills in."""

    innovations: NDArray[np.float64]  # nu_i, nu_x, S_ii, S_ix, S_xx, shape (n, 5), NaN where nothing was predicted
    state: NDArray[np.float64]  # after the correction, shape (n, 7), NaN where the ball does not fly
    spread: NDArray[np.float64]  # covariance of the active states after the correction, shape (n, m, m)
    steps: Steps

    def part(self, piece: slice) -> Results:
        """Those of some samples, as views."""
        return Results(self.innovations[piece], self.state[piece], self.spread[piece], self.steps.part(piece))


_NO_STATE, _NO_MATRIX = np.empty((0, STATES)), np.empty((0, 3, 3))
NO_STEPS = Steps(_NO_MATRIX, _NO_STATE, _NO_STATE)


def room_for(n: int, m: int, *, state: bool = False, spread: bool = False, steps: bool = False) -> Results:
    """Room for the results of n samples with m active states; what is not asked for has none."""
    return Results(
        innovations=np.empty((n, OUT_COLUMNS)),
        state=np.empty((n, STATES)) if state else _NO_STATE,
        spread=np.empty((n, m, m)) if spread else _NO_MATRIX,
        steps=Steps(np.zeros((n, m, m)), np.empty((n, STATES)), np.empty((n, STATES))) if steps else NO_STEPS,
    )
