"""The error of the board's clock, by the times at which its samples arrived at the computer.

    host time - board time = delay of a sample + error of the clock times the board time

A delay has a lower bound that does not change, so the earliest sample of each block marks the line.

Rule 1: a straight line through these points gives the error, and their scatter its standard error.
Rule 2: an error below MIN_STD is that of the computer's own clock, which is a crystal, too, and may be slewed.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from twin.estimation.record import FloatArray

MIN_S = 10.0  # shorter sessions are left out: the scatter of the delays would be larger than any error
BLOCKS = 20
MIN_STD = 5e-4  # the slewing of a clock by NTP (500 ppm)
SURE_ERRORS, WORTH = 5.0, 0.005  # standard errors and size from which an error is mentioned
MAX_ERROR = 0.3  # beyond it the board is not a board in real time


ClockError = tuple[float, float]  # e of true interval = (1 + e) interval of the board, and its standard error


def clock_error(board_s: FloatArray, host_s: FloatArray) -> ClockError | None:
    """Return the error of the clock in one session; None if it is too short.

    Args:
        board_s: times of the samples on the board's clock, rising, shape (n,).
        host_s: times of their arrival, shape (n,).
    """
    if len(board_s) < 10 * BLOCKS or board_s[-1] - board_s[0] < MIN_S:
        return None
    behind = (host_s - host_s[0]) - (board_s - board_s[0])
    earliest = [block[np.argmin(behind[block])] for block in np.array_split(np.arange(len(behind)), BLOCKS)]
    # A slow clock tilts the blocks themselves, so a second line is found without the first one's tilt.
    slope = _line(board_s[earliest], behind[earliest])[0]
    flat = behind - slope * board_s
    earliest = [block[np.argmin(flat[block])] for block in np.array_split(np.arange(len(flat)), BLOCKS)]
    more, std = _line(board_s[earliest], flat[earliest])
    error = slope + more
    return (error, max(std, MIN_STD)) if abs(error) < MAX_ERROR else None


def combined(errors: Sequence[ClockError | None]) -> ClockError | None:
    """Return the error by all sessions; None if none shows it."""
    known = np.array([error for error in errors if error is not None])
    if not len(known):
        return None
    # The error of the computer's clock is common to all sessions, so their number does not reduce it.
    return float(np.average(known[:, 0], weights=known[:, 1] ** -2.0)), float(known[:, 1].min())


def clock_note(file: str, clock: ClockError | None) -> list[str]:
    """Return the note on a board's clock that is surely wrong; none otherwise."""
    if clock is None or abs(clock[0]) < max(SURE_ERRORS * clock[1], WORTH):
        return []
    error, way = 100.0 * abs(clock[0]), "slow" if clock[0] > 0.0 else "fast"
    return [f"{file}: the board's clock is {error:.2g} % {way} by the computer's. Check the board's sampling interval"]


def _line(t: FloatArray, y: FloatArray) -> tuple[float, float]:
    """Return (slope, its standard error) of a straight line."""
    centred = t - t.mean()
    slope = float(centred @ y / (centred @ centred))
    residual = y - y.mean() - slope * centred
    return slope, float(np.sqrt(residual @ residual / (len(t) - 2) / (centred @ centred)))
