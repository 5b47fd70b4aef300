"""Alarms whose false-alarm rate is stated beforehand: one decision per window, hysteresis between two thresholds.

The statistic is a mean of squares that a right model makes about 1 (error) or 2 (NIS).  Windows follow each other
without overlap, so a rate per day is a probability per decision, whatever the correlation within a window:

    probability = false alarms per day * window / 86400 s

Rule 1: a window that is not complete decides nothing in the model's favour; a mean of squares can only be proven too
        large early, and then it is: as soon as the squares so far alone exceed the threshold, the alarm is raised.  The
        decision is the one the full window would have given, so the stated rate holds.
Rule 2: cleared by one complete window below the lower threshold, which 19 of 20 windows of a right model are.
"""

from __future__ import annotations

from scipy.special import gammainccinv

from protocol.bus import board51_pb2 as pb

DAY_S = 86400.0


def probability_per_window(false_alarms_per_day: float, window_s: float) -> float:
    """Of a false alarm at one decision; at most 0.1, the range of the tail formulas."""
    return min(false_alarms_per_day * window_s / DAY_S, 0.1)


def white_threshold(window: int, degrees: int, probability: float) -> float:
    """What the mean of `window` independent chi-squares of `degrees` degrees each exceeds with `probability`.

    Innovations of a right model are white, so their NIS (2 degrees) are independent and the sum is chi-square too.
    """
    return float(2.0 * gammainccinv(0.5 * degrees * window, probability)) / window


class WindowAlarm:
    """One alarm: squares in, changes of state out."""

    def __init__(self, name: str, *, window: int) -> None:
        self.name = name
        self.active = False
        self.decisions = 0
        self.raised = 0
        self._window = window
        self._sum = 0.0
        self._count = 0
        self._exceeded = False
        self._on = self._off = 0.0

    def clear_window(self, *, window: int | None = None) -> None:
        """Begin a new window (of another length, where one is given); the state of the alarm stays."""
        self._window = window or self._window
        self._sum = 0.0
        self._count = 0
        self._exceeded = False
        self._on = self._off = 0.0

    def drop(self) -> pb.Alarm | None:
        """End the alarm without a decision: what it was about cannot be compared any longer."""
        self.clear_window()
        if not self.active:
            return None
        self.active = False
        return pb.Alarm(name=self.name, active=False, text="ended: twin and rig are not compared any longer")

    def add(self, square: float, *, on: float, off: float) -> pb.Alarm | None:
        """Take one square; `on`, `off` are the thresholds of its window mean at this operating point.

        Returns the alarm where its state changes.  Over a window the largest thresholds seen apply.
        """
        self._sum += square
        self._count += 1
        if on > self._on:
            self._on = on
        if off > self._off:
            self._off = off
        change: pb.Alarm | None = None
        if not self._exceeded and self._sum > self._on * self._window:
            self._exceeded = True
            if not self.active:
                self.active = True
                self.raised += 1
                change = self._message(self._sum / self._window, "more than noise and a right model explain")
        if self._count == self._window:
            self.decisions += 1
            if self.active and not self._exceeded and self._sum < self._off * self._window:
                self.active = False
                change = self._message(self._sum / self._window, "back to what noise explains")
            self.clear_window()
        return change

    def _message(self, value: float, text: str) -> pb.Alarm:
        return pb.Alarm(
            name=self.name, active=self.active, value=value, threshold_on=self._on, threshold_off=self._off, text=text
        )
