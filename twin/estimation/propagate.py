"""The state from one sample to the next under the u_c in force, with delays and lost samples.

Rule 1: the delays of actuation and of sampling add to one delay between u_c and the readings; a capture, which counts
        its time from its own step, shows a share of it.
Rule 2: the u_c of a lost sample is estimated from the next reading of i_c.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from twin.compiled import Packed, inlined, kernel
from twin.model.causes import actuation_delay, sampling_delay
from twin.model.extended import Base, feels_ball, held_current, reading_of_current
from twin.model.flight import fly
from twin.model.integration import FREE, over

INPUT_DELTA_V = 1e-3
UNKNOWN_INPUT_V = 1.0  # standard deviation of a lost u_c about the previous one
_ANSWERS = 0.02  # of K_A: smallest response of i_c to u_c within the interval that determines u_c


@inlined
def copy(to: NDArray[np.float64], of: NDArray[np.float64]) -> None:
    """Copy `of` to `to`, both of shape (n,), without the overlap check of a slice assignment."""
    for k in range(len(of)):
        to[k] = of[k]


@inlined
def delay_s(c: NDArray[np.float64]) -> float:
    """Return the delay from u_c to the readings, s."""
    return float(c[actuation_delay.DELAY] + c[sampling_delay.DELAY])


@inlined
def see_delays(to: NDArray[np.float64], c: NDArray[np.float64], captured: bool) -> None:
    """Set delays and jitter in `to`, shape (PLACES,), to those of the causes c in a capture, or in the control loop."""
    share, share_of_sensors = 1.0, 1.0
    if captured:
        share, share_of_sensors = c[actuation_delay.IN_CAPTURES], c[sampling_delay.IN_CAPTURES]
    to[actuation_delay.DELAY] = share * c[actuation_delay.DELAY]
    to[actuation_delay.JITTER] = share * c[actuation_delay.JITTER]
    to[sampling_delay.DELAY] = share_of_sensors * c[sampling_delay.DELAY]


class HeldInput(NamedTuple):
    """The u_c in force over one interval."""

    before: float  # V, up to the change
    change_s: float  # since the beginning of the interval, s
    after: float  # V, from the change on


@inlined
def input_over(c: NDArray[np.float64], u: NDArray[np.float64], n: int, first: int, T_s: float) -> HeldInput:
    """Return the u_c in force from sample n - 1 to n, after all delays.

    Args:
        c: the causes' parameters, shape (PLACES,).
        u: u_c of each sample, V, shape (n_samples,).
        n: the sample at the end of the interval.
        first: sample of the first known input.
        T_s: interval from n - 1 to n, s.
    """
    # The interval is split where the delayed input changes. With a delay of whole samples, the likelihood would be a
    # staircase without a slope.
    delay = delay_s(c)
    whole = int(delay / T_s)
    return HeldInput(u[max(n - 2 - whole, first)], delay - whole * T_s, u[max(n - 1 - whole, first)])


@inlined
def propagate(
    base: Packed, c: NDArray[np.float64], y: NDArray[np.float64], u: HeldInput, t: float, T_s: float, stops: bool
) -> None:
    """Advance the state over one sampling interval.

    Args:
        base: tuple(Base).
        c: the causes' parameters, shape (PLACES,).
        y: the state, shape (STATES,), updated in place.
        u: of `input_over`.
        t: time at the beginning, s.
        T_s: the interval, s.
        stops: as in `advance`.
    """
    if not stops and not feels_ball(c):
        fly(base, c, y, u.before, u.change_s, u.after, t, T_s)
        return
    if u.change_s > 0.0:
        over(base, c, y, u.before, t, u.change_s, stops)
    over(base, c, y, u.after, t + u.change_s, T_s - u.change_s, stops)


@inlined
def current_held(
    base: Packed,
    c: NDArray[np.float64],
    i: float,
    u: HeldInput,
    T_s: float,
    w: float,
    x: float,
) -> float:
    """The current after T_s with the ball held at x, A, from i; w: the warmth; others as `propagate`."""
    p = Base(*base)
    if u.change_s > 0.0:
        i = held_current(p, c, i, w, x, u.before, u.change_s)
    return held_current(p, c, i, w, x, u.after, T_s - u.change_s)


@kernel
def find_input(
    base: Packed,
    c: NDArray[np.float64],
    before: NDArray[np.float64],
    u: NDArray[np.float64],
    lost: int,
    n: int,
    first: int,
    t: float,
    T_s: float,
    reading: float,
    moved: NDArray[np.float64],
) -> None:
    """Set u[lost] to the input that brings i_c from the state `before` at n - 1 to its `reading` at n, A.

    The other arguments are those of `input_over` and `propagate`; `moved`, shape (STATES,), is a working array.
    """
    # From the response of i_c, not from the control law: so the law of the board need not be known.
    held = u[lost]
    for _ in range(3):
        copy(moved, before)
        propagate(base, c, moved, input_over(c, u, n, first, T_s), t, T_s, FREE)
        i_c = reading_of_current(c, moved)
        u[lost] += INPUT_DELTA_V
        copy(moved, before)
        propagate(base, c, moved, input_over(c, u, n, first, T_s), t, T_s, FREE)
        u[lost] -= INPUT_DELTA_V
        answer = (reading_of_current(c, moved) - i_c) / INPUT_DELTA_V
        # Where i_c hardly responds within an interval, its noise would be divided by almost nothing: the last input
        # stays.
        if not answer > _ANSWERS * base[0]:
            return
        max_change = 5.0 * UNKNOWN_INPUT_V
        u[lost] = min(max(u[lost] + (reading - i_c) / answer, held - max_change), held + max_change)
