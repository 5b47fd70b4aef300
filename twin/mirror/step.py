"""One sample through observer, twin, windows and alarms, in one call: each call into compiled code costs about 1 us.

Every sample goes this way, ordinary or not, so there is one set of numbers.
"""

from __future__ import annotations

import math
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from twin.compiled import Packed, kernel
from twin.mirror.loop import advance
from twin.mirror.monitor.alarms import UNCHANGED
from twin.mirror.monitor.divergence import I_C, U_C, Figures, X, figures, judge_error, judge_innovation
from twin.mirror.observer import observe

Innovation: TypeAlias = tuple[float, float, float, float, bool]  # of i_c (A), of x (m), NIS, its mean, valid
Flight: TypeAlias = tuple[float, float, float, float]  # i_c, x, x', u_c of the twin: A, m, m/s, V
Constants: TypeAlias = tuple[  # the arguments of `step` that stay as long as the regime: plant .. alarms
    Packed,
    Packed,
    Packed,
    NDArray[np.int64],
    NDArray[np.float64],
    NDArray[np.float64],
    NDArray[np.float64],
    NDArray[np.float64],
    NDArray[np.float64],
    NDArray[np.int64],
    NDArray[np.float64],
    NDArray[np.float64],
]
Answer: TypeAlias = tuple[Innovation, Flight, Figures, Figures, Figures, bool, tuple[int, int, int]]


@kernel
def step(
    plant: Packed,
    law: Packed,
    noise: Packed,
    active: NDArray[np.int64],
    z: NDArray[np.float64],
    P: NDArray[np.float64],
    work: NDArray[np.float64],
    ring: NDArray[np.float64],
    sums: NDArray[np.float64],
    counts: NDArray[np.int64],
    totals: NDArray[np.float64],
    alarms: NDArray[np.float64],
    twin: NDArray[np.float64],
    yardstick: Packed,
    i: float,
    x: float,
    u: float,
    x_ref: float,
    closed_loop: bool,
    follows: bool,
    usable: bool,
    flying: bool,
    in_step: bool,
) -> Answer:
    """Run the tick of one sample and compare.

    Args:
        plant: PlantNumbers.
        law: LawNumbers.
        noise: the observer's numbers, see `observe`.
        active: the states in its covariance, shape (m,).
        z: its memory.
        P: its covariance, shape (m, m).
        work: its scratch, shape (3 m + 3, 6).
        ring: windows, shape (4, window, 3), see `Comparison`.
        sums: over them, shape (4, 4).
        counts: of samples in them, and without evidence, shape (8,).
        totals: over all time, shape (4, 4).
        alarms: shape (3, PLACES).
        twin: memory of the free twin, a simulated rig, see `advance`.
        yardstick: standard deviations of x, i_c, u_c (0..2); thresholds on of x, i_c (3, 4), off (5, 6); of the mean
            NIS on, off (7, 8).
        i: measured i_c, A; like the next three NaN where the sample lacks it.
        x: measured, m.
        u: u_c in force from this tick on, V.
        x_ref: m.
        closed_loop: mode of the sample.
        follows: one tick after the sample before, for the observer.
        usable: by the observer: i, x, u finite and within the sensors' ranges.
        flying: whether there is a free twin; else its part of the answer is NaN.
        in_step: whether windows, and in closed loop alarms, take the sample.

    Returns:
        (innovation, twin, figures of x, i_c, u_c, whether an alarm changed, the changes in the order of ALARMS).
    """
    n_i, n_x, nis, valid = observe(plant, noise, active, z, P, work, follows, usable, i, x, u)
    nis_mean, of_innovation = judge_innovation(
        ring, sums, counts, totals, alarms[0], n_i, n_x, nis, valid, yardstick[7], yardstick[8]
    )
    flight = (math.nan, math.nan, math.nan, math.nan)
    of_x = of_i = of_u = (math.nan, math.nan, math.nan, math.nan, False)
    if flying:
        flight = advance(plant, law, twin, closed_loop, x_ref, u)
        of_x = figures(ring, sums, counts, totals, X, x, flight[1], yardstick[0], in_step)
        of_i = figures(ring, sums, counts, totals, I_C, i, flight[0], yardstick[1], in_step)
        of_u = figures(ring, sums, counts, totals, U_C, u, flight[3], yardstick[2], in_step)
    judged = flying and closed_loop and in_step
    change_x = judge_error(alarms[1], counts, 1, ring.shape[1], of_x[1], yardstick[3], yardstick[5], judged)
    change_i = judge_error(alarms[2], counts, 2, ring.shape[1], of_i[1], yardstick[4], yardstick[6], judged)
    changed = of_innovation != UNCHANGED or change_x != UNCHANGED or change_i != UNCHANGED
    innovation = (n_i, n_x, nis, nis_mean, valid)
    return innovation, flight, of_x, of_i, of_u, changed, (of_innovation, change_x, change_i)
