"""A step of observer, twin, windows and alarms in one call: each call into compiled code costs about 1 us.

Every sample goes this way, ordinary or not, so there is one set of numbers.
"""

from __future__ import annotations

import math
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from twin.compiled import Packed, kernel
from twin.mirror.loop import advance
from twin.mirror.monitor.alarms import UNCHANGED
from twin.mirror.monitor.divergence import I_C, U_C, Figures, Windows, X, figures, judge_error, judge_innovation
from twin.mirror.observer import observe

Innovation: TypeAlias = tuple[float, float, float, float, bool]  # of i_c (A), of x (m), NIS, its mean, valid
Flight: TypeAlias = tuple[float, float, float, float]  # i_c, x, x', u_c of the twin: A, m, m/s, V
Answer: TypeAlias = tuple[Innovation, Flight, Figures, Figures, Figures, bool, tuple[int, int, int]]


class Twin(NamedTuple):
    """The twin of one board as the kernels take it, as long as the regime lasts; memories included."""

    plant: Packed  # tuple(PlantNumbers)
    law: Packed  # tuple(LawNumbers)
    observer: Packed  # tuple(Observer)
    windows: Packed  # tuple(Windows)
    free: NDArray[np.float64]  # memory of the free twin, a simulated rig, see `advance`


class Yardstick(NamedTuple):
    """The scales by which errors are measured, around one reference."""

    std_x: float  # m
    std_i: float  # A
    std_u: float  # V
    on_x: float  # thresholds of the mean squares, in squares of `std`
    on_i: float
    off_x: float
    off_i: float
    on_nis: float
    off_nis: float


class Tick(NamedTuple):
    """A sample, and its relation to the previous ones."""

    i: float  # measured i_c, A; like the next three NaN where the sample lacks it
    x: float  # measured, m
    u: float  # u_c in force from this tick on, V
    x_ref: float  # m
    closed_loop: bool  # mode of the sample
    follows: bool  # one tick after the sample before, for the observer
    usable: bool  # by the observer: i, x, u finite and within the sensors' ranges
    switched_off: bool  # the first sample in idle, for the observer
    flying: bool  # whether there is a free twin; else its part of the answer is NaN
    in_step: bool  # whether windows, and in closed loop alarms, take the sample


@kernel
def step(twin: Packed, yardstick: Packed, tick: Packed) -> Answer:
    """Run the tick of one sample and compare.

    Args:
        twin: tuple(Twin).
        yardstick: tuple(Yardstick).
        tick: tuple(Tick).

    Returns:
        (innovation, twin, figures of x, i_c, u_c, whether an alarm changed, the changes in the order of ALARMS).
    """
    t, scale, now = Twin(*twin), Yardstick(*yardstick), Tick(*tick)
    w = Windows(*t.windows)
    n_i, n_x, nis, valid = observe(t.observer, now.follows, now.usable, now.switched_off, now.i, now.x, now.u)
    nis_mean, of_innovation = judge_innovation(w, n_i, n_x, nis, valid, scale.on_nis, scale.off_nis)
    flight = (math.nan, math.nan, math.nan, math.nan)
    of_x = of_i = of_u = (math.nan, math.nan, math.nan, math.nan, math.nan, False)
    # The observer first: it judges every sample, also where there is no free twin.
    if now.flying:
        flight = advance(t.plant, t.law, t.free, now.closed_loop, now.x_ref, now.u)
        of_x = figures(w, X, now.x, flight[1], scale.std_x, now.in_step)
        of_i = figures(w, I_C, now.i, flight[0], scale.std_i, now.in_step)
        of_u = figures(w, U_C, now.u, flight[3], scale.std_u, now.in_step)
    # In closed loop only: in open loop no model predicts an unstable ball for long.
    is_evidence = now.flying and now.closed_loop and now.in_step
    change_x = judge_error(w, 1, of_x[1], scale.on_x, scale.off_x, is_evidence)
    change_i = judge_error(w, 2, of_i[1], scale.on_i, scale.off_i, is_evidence)
    changed = of_innovation != UNCHANGED or change_x != UNCHANGED or change_i != UNCHANGED
    innovation = (n_i, n_x, nis, nis_mean, valid)
    return innovation, flight, of_x, of_i, of_u, changed, (of_innovation, change_x, change_i)
