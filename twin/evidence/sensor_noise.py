"""Sensor noise without a model: from the ball at rest and settled captures, else from differences of the readings."""

from __future__ import annotations

import math

import numpy as np

from twin.estimation.contact import HELD_SAMPLES
from twin.estimation.innovations import LOST, RESTS_HIGH, RESTS_LOW, USE_I, USE_X
from twin.estimation.record import runs
from twin.evidence.colour import settled_captures
from twin.evidence.gather import Evidence
from twin.evidence.noise_levels import RESTS, uncut
from twin.evidence.rest_lines import without_lines
from twin.settings import diagnosis as settings

_LINE = np.arange(HELD_SAMPLES) - (HELD_SAMPLES - 1) / 2.0


def sensor_noise(evidence: Evidence) -> tuple[float | None, float | None]:
    """Return the noise of i_c, A, and x, m; None: too few samples.

    It is that of the ball at rest, for i_c also of settled captures, else that of `instruments.py`.
    """
    squares = _rest_squares(evidence)
    result = [float(np.sqrt(total / count)) if count > 300 and total > 0 else None for total, count in squares]
    if evidence.noise is not None:
        coloured = zip(result, evidence.noise.colours[:2], strict=True)
        result = [colour.sigma if colour is not None else sigma for sigma, colour in coloured]
        # At rest before in flight: there the loop answers to the noise, so that differences show a little more than
        # the sensor.
        in_flight = [channel.sigma if math.isfinite(channel.sigma) else None for channel in evidence.noise.channels]
        result = [sigma if sigma is not None else other for sigma, other in zip(result, in_flight, strict=True)]
    return result[0], result[1]


def noise_errors(evidence: Evidence) -> tuple[float, float]:
    """Return the standard errors of ln sigma of i_c and x: sqrt(1 / 2n), and that of the noise ratios."""
    # Of n readings of normal noise, var ln sigma = 1 / 2n.
    squares = [0.5 / count if count > 300 else 0.0 for _, count in _rest_squares(evidence)]
    if evidence.noise is not None:
        coloured = zip(squares, evidence.noise.colours[:2], strict=True)
        squares = [0.5 / colour.readings if colour is not None else square for square, colour in coloured]
        squares = [
            square + evidence.noise.error(evidence.records, evidence.series, column) ** 2
            for column, square in enumerate(squares)
        ]
    return math.sqrt(squares[0]), math.sqrt(squares[1])


def _rest_squares(evidence: Evidence) -> list[tuple[float, int]]:
    """Return (sum of squares about straight lines at rest and in captures, degrees of freedom) for i_c and x.

    Windows far noisier than the others are left out: the current still settles there, or the rig was touched.
    """
    series = without_lines(evidence.series)
    whole = [
        (series.flags & use != 0) & uncut(series, values, series.flags & (use | RESTS_LOW | RESTS_HIGH) != 0)
        for values, use in ((series.i, USE_I), (series.x, USE_X))
    ]
    lost = series.flags & LOST != 0
    rest = series.flags & RESTS != 0
    # Captures, too: they triple the readings of i_c where a rig rests for a few seconds only.  Not those whose noise
    # differs: their ratio to the ball at rest is measured, so they say nothing about its level.
    if evidence.noise is not None and rest.any():
        ratio = evidence.noise_ratio
        rest |= settled_captures(series) & (ratio[:, 0] == 1.0 if len(ratio) else True)
    windows: tuple[list[tuple[float, int]], list[tuple[float, int]]] = ([], [])
    for piece in runs(rest, 2 * HELD_SAMPLES):
        for start in range(piece.start, piece.stop - HELD_SAMPLES + 1, HELD_SAMPLES):
            window = slice(start, start + HELD_SAMPLES)
            for column, values in enumerate((series.i[window], series.x[window])):
                read = ~lost[window]
                freedom = int(np.count_nonzero(read)) - 2
                steady = column == 1 or np.ptp(series.u[window]) == 0.0
                if not whole[column][window][read].all() or freedom < HELD_SAMPLES // 2 or not steady:
                    continue
                # About a line, not about the mean: a coil that warms up moves i_c by more than its noise within
                # seconds.
                line = np.polynomial.polynomial.polyfit(_LINE[read], values[read], 1)
                residual = values[read] - np.polynomial.polynomial.polyval(_LINE[read], line)
                if len(evidence.noise_ratio):  # scaled to the reference instrument
                    residual = residual / np.sqrt(evidence.noise_ratio[window, column][read])
                windows[column].append((float(residual @ residual), freedom))
    result = []
    for channel in windows:
        middle = float(np.median([square / freedom for square, freedom in channel])) if channel else 0.0
        usual = [window for window in channel if not window[0] > settings.RESTLESS * middle * window[1] > 0.0]
        result.append((sum(square for square, _ in usual), sum(freedom for _, freedom in usual)))
    return result
