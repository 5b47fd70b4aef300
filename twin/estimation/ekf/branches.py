"""Prediction over an interval in which something happened that no sample shows: moments over equally likely cases.

Two such things are known to happen, and each has one unknown between 0 and 1:

    the coil was switched off    at which share of the tick: a STOP acts at once, not at the next tick
    the ball hit a stop          with which restitution: the model has none

Rule 1: each case is simulated, and mean and covariance over the cases replace the prediction.  A linear share of the
        input, as for a lost sample, would be wrong here.  Most cut currents have decayed at the next tick and say
        nothing about the instant, but the speed of the ball still depends on it.
Rule 2: the first and the last case are the ends of the interval.  So a coil that was switched off at a tick (change of
        mode, fault, lost host) is one of the cases.
"""

from __future__ import annotations

import math

from twin.compiled import kernel
from twin.estimation.ekf.memory import Floats, Memory, base_of
from twin.estimation.propagate import copy, delay_s
from twin.model.extended import I_COLOUR, Base, V, X
from twin.model.integration import FREE, STOPS, over

CASES = 8
_MIXED = 3  # has no divisor in common with CASES: the order of the restitutions, independent of that of the instants


@kernel
def spread_over_cases(f: Memory, inputs: Floats, n: int, T_s: float, cut: int) -> None:
    """Replace the prediction of sample n in `f.y` by the mean over the cases, and add their covariance to `f.P`.

    Args:
        f: the filter, after a prediction from `f.here`.
        inputs: u_c of each sample, V, shape (n,).
        n: the sample to reach.
        T_s: interval from n - 1 to n, s.
        cut: sample in whose tick the coil was switched off; -1: none.
    """
    cases = f.G
    for case in range(CASES):
        copy(f.moved[:], f.previous[:])
        restitution = case * _MIXED % CASES / (CASES - 1)
        _run(f, f.moved[:], inputs, n, T_s, cut, case / (CASES - 1) * T_s, restitution)
        copy(cases[case], f.moved[:])
    for k in range(I_COLOUR):  # coloured noise does not depend on the case
        total = 0.0
        for case in range(CASES):
            total += cases[case, k]
        f.y[k] = total / CASES
    for a in range(f.coloured):
        row = f.places[a]
        for b in range(f.coloured):
            column = f.places[b]
            total = 0.0
            for case in range(CASES):
                total += (cases[case, row] - f.y[row]) * (cases[case, column] - f.y[column])
            f.P[a, b] += total / CASES


@kernel
def _run(f: Memory, y: Floats, inputs: Floats, n: int, T_s: float, cut: int, cut_s: float, restitution: float) -> None:
    """Run one case in place of y: the input `cut` became 0 `cut_s` after its sample; delays as in `propagate`."""
    delay = delay_s(f.c[:])
    whole = int(delay / T_s)
    part = delay - whole * T_s
    earlier, later = max(n - 2 - whole, f.first), max(n - 1 - whole, f.first)
    earlier_s = min(part, max(0.0, cut_s + part - T_s)) if earlier == cut else part
    later_s = min(T_s, part + cut_s) if later == cut else T_s
    _fly(f, y, inputs[earlier], earlier_s, restitution)
    _fly(f, y, 0.0, part - earlier_s, restitution)
    _fly(f, y, inputs[later], later_s - part, restitution)
    _fly(f, y, 0.0, T_s - later_s, restitution)


@kernel
def _fly(f: Memory, y: Floats, u: float, duration: float, restitution: float) -> None:
    """Advance y by `duration` s under u, V; the first stop on the way is hit with `restitution`, another one with 0."""
    if duration <= 0.0:
        return
    base, c, before = base_of(f), f.c[:], f.back[:]
    travel_m = Base(*base).travel_m
    copy(before, y)
    over(base, c, y, u, 0.0, duration, FREE)
    if 0.0 <= y[X] <= travel_m:
        return
    stop_m = 0.0 if y[X] < 0.0 else travel_m
    # The instant of contact under the mean acceleration: off by less than 1 us.
    away_m, v = before[X] - stop_m, before[V]
    at_contact = math.sqrt(max(v * v - 2.0 * (y[V] - v) / duration * away_m, 0.0))
    closing = v + (at_contact if stop_m > 0.0 else -at_contact)
    until = min(max(-2.0 * away_m / closing, 0.0), duration) if closing != 0.0 else 0.0
    copy(y, before)
    over(base, c, y, u, 0.0, until, FREE)
    y[X], y[V] = stop_m, -restitution * y[V]
    over(base, c, y, u, 0.0, duration - until, STOPS)
