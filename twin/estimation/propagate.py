"""From sample to sample: which u_c is in force on the way, delays and lost samples included.

Rule 1: the delays of input and of sampling are one delay between u_c and the readings.
Rule 2: the u_c of a lost sample is what brings the current to the next reading, within what noise leaves open.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from twin.compiled import Packed, inlined, kernel
from twin.model.causes import actuation_delay, sampling_delay
from twin.model.extended import I_C, Base, current_reading, drive, over

INPUT_DELTA_V = 1e-3
UNKNOWN_INPUT_V = 1.0  # standard deviation of a lost u_c about the one before
_ANSWERS = 0.02  # of K_A: what i_c must answer to u_c within the interval, to be asked for it


@inlined
def copy(to: NDArray[np.float64], of: NDArray[np.float64]) -> None:
    """Fill `to` from `of`, both of shape (n,): an assigned slice asks first whether the two overlap."""
    for k in range(len(of)):
        to[k] = of[k]


@inlined
def delay_s(c: NDArray[np.float64]) -> float:
    """From u_c to what the readings show of it, s."""
    return float(c[actuation_delay.DELAY] + c[sampling_delay.DELAY])


@inlined
def jitter_s(c: NDArray[np.float64]) -> float:
    """Standard deviation of the delay from tick to tick, s."""
    return float(c[actuation_delay.JITTER] + c[sampling_delay.JITTER])


@kernel
def propagate(
    base: Packed,
    c: NDArray[np.float64],
    y: NDArray[np.float64],
    u: NDArray[np.float64],
    n: int,
    first: int,
    t: float,
    T_s: float,
    stops: bool,
) -> None:
    """From sample n - 1 to n: the inputs in force, delays applied, one after the other.

    Args:
        base: tuple(Base).
        c: the causes' parameters, shape (PLACES,).
        y: the state at n - 1, shape (7,), updated in place.
        u: u_c of each sample, V, shape (n_samples,).
        n: the sample that is reached.
        first: no earlier input is known than that of this sample.
        t: of n - 1, s.
        T_s: from n - 1 to n, s.
        stops: as in `advance`.
    """
    delay = delay_s(c)
    if delay <= 0.0:
        over(base, c, y, u[n - 1], t, T_s, stops)
        return
    whole = int(delay / T_s)
    part = delay - whole * T_s
    over(base, c, y, u[max(n - 2 - whole, first)], t, part, stops)
    over(base, c, y, u[max(n - 1 - whole, first)], t + part, T_s - part, stops)


@kernel
def current_held(
    base: Packed, c: NDArray[np.float64], i: float, u: NDArray[np.float64], n: int, first: int, T_s: float, w: float
) -> float:
    """The current of a held ball at sample n, A, from i at n - 1, by (1) alone; the other arguments as `propagate`."""
    p = Base(*base)
    delay = delay_s(c)
    whole = int(delay / T_s)
    part = delay - whole * T_s
    if part > 0.0:
        target = drive(p, c, u[max(n - 2 - whole, first)], w)
        i = target + (i - target) * math.exp(-part / p.T_A)
    target = drive(p, c, u[max(n - 1 - whole, first)], w)
    return target + (i - target) * math.exp(-(T_s - part) / p.T_A)


@kernel
def find_input(
    base: Packed,
    c: NDArray[np.float64],
    here: NDArray[np.float64],
    u: NDArray[np.float64],
    lost: int,
    n: int,
    first: int,
    t: float,
    T_s: float,
    reading: float,
    moved: NDArray[np.float64],
) -> None:
    """Put into u[lost] what brings i_c from the state `here` at n - 1 to its reading at n.

    The arguments are those of `propagate`; `moved`, shape (7,), is room.
    """
    held = u[lost]
    for _ in range(3):
        copy(moved, here)
        propagate(base, c, moved, u, n, first, t, T_s, False)
        i_c = current_reading(c, moved[I_C])
        u[lost] += INPUT_DELTA_V
        copy(moved, here)
        propagate(base, c, moved, u, n, first, t, T_s, False)
        u[lost] -= INPUT_DELTA_V
        answer = (current_reading(c, moved[I_C]) - i_c) / INPUT_DELTA_V
        if not answer > _ANSWERS * base[0]:
            return
        most = 5.0 * UNKNOWN_INPUT_V
        u[lost] = min(max(u[lost] + (reading - i_c) / answer, held - most), held + most)
