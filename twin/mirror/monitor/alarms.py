"""Alarms whose false-alarm rate is stated beforehand: one decision per window, hysteresis between two thresholds.

The statistic is a mean of squares that a right model makes about 1 (error) or 2 (NIS).  Windows follow each other
without overlap, so a rate per day is a probability per decision, whatever the correlation within a window:

    probability = false alarms per day * window / 86400 s

Rule 1: an incomplete window decides nothing in the model's favour, but it can decide against it.  The alarm is raised
        as soon as the squares so far alone exceed the threshold.  The full window would have decided the same, so the
        stated rate holds.
Rule 2: one complete window below the lower threshold clears the alarm; 19 of 20 windows of a right model are below it.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammainccinv

from protocol.bus import board51_pb2 as pb
from twin.compiled import kernel

DAY_S = 86400.0


def probability_per_window(false_alarms_per_day: float, window_s: float) -> float:
    """Return the probability of a false alarm at one decision; at most 0.1, the range of the tail formulas."""
    return min(false_alarms_per_day * window_s / DAY_S, 0.1)


def white_threshold(window: int, degrees: int, probability: float) -> float:
    """Return the value that the mean of `window` chi-squares of `degrees` degrees exceeds with `probability`.

    Innovations of a right model are white, so their NIS (2 degrees) are independent and the sum is chi-square too.
    """
    return float(2.0 * gammainccinv(0.5 * degrees * window, probability)) / window


# What an alarm remembers, by its place in a row: the window so far, ...
SUM, COUNT, ON, OFF, EXCEEDED = 0, 1, 2, 3, 4
# ... the alarm over all time, and what was so when it last changed.
ACTIVE, DECISIONS, RAISED, CHANGED_MEAN, CHANGED_ON, CHANGED_OFF = 5, 6, 7, 8, 9, 10
PLACES = 11
UNCHANGED, TURNED_ON, TURNED_OFF, ENDED = 0, 1, 2, 3  # what a sample did to an alarm
_TEXTS = ("", "the error is larger than noise explains", "the error is within the noise again")


@kernel
def clear_window(row: NDArray[np.float64]) -> None:
    """Begin a new window; the state of the alarm stays."""
    row[SUM : EXCEEDED + 1] = 0.0


@kernel
def end(row: NDArray[np.float64]) -> int:
    """End the alarm without a decision: what it was about cannot be compared any longer."""
    clear_window(row)
    if row[ACTIVE] == 0.0:
        return UNCHANGED
    row[ACTIVE] = 0.0
    return ENDED


@kernel
def decide(row: NDArray[np.float64], window: int, square: float, on: float, off: float) -> int:
    """Take one square; `on`, `off` are the thresholds of its window mean at this operating point.

    Over a window the largest thresholds seen apply.
    """
    # One decision in a window, not at each tick on a sliding mean. That would need the crossing rate of a correlated
    # process, and would gain a window at most.
    row[SUM] += square
    row[COUNT] += 1.0
    # The largest threshold of the window: so the stated rate also holds for a reference that moves within it.
    row[ON] = max(row[ON], on)
    row[OFF] = max(row[OFF], off)
    change = UNCHANGED
    if row[EXCEEDED] == 0.0 and row[SUM] > row[ON] * window:
        row[EXCEEDED] = 1.0
        if row[ACTIVE] == 0.0:
            row[ACTIVE] = 1.0
            row[RAISED] += 1.0
            change = TURNED_ON
    full = row[COUNT] == window
    # A lower threshold clears the alarm: with one threshold, an error near it would switch the alarm on and off.
    if full and row[ACTIVE] == 1.0 and row[EXCEEDED] == 0.0 and row[SUM] < row[OFF] * window:
        row[ACTIVE] = 0.0
        change = TURNED_OFF
    if change != UNCHANGED:
        row[CHANGED_MEAN], row[CHANGED_ON], row[CHANGED_OFF] = row[SUM] / window, row[ON], row[OFF]
    if full:
        row[DECISIONS] += 1.0
        clear_window(row)
    return change


def message(name: str, row: NDArray[np.float64], change: int, *, why_ended: str = "") -> pb.Alarm:
    """Return the alarm message for a change."""
    if change == ENDED:
        why = why_ended or "twin and rig are not compared any longer"
        return pb.Alarm(name=name, active=False, text=f"ended: {why}")
    return pb.Alarm(
        name=name,
        active=change == TURNED_ON,
        value=row[CHANGED_MEAN],
        threshold_on=row[CHANGED_ON],
        threshold_off=row[CHANGED_OFF],
        text=_TEXTS[change],
    )
