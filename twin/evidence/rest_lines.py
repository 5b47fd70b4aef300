"""The readings of a ball at rest without the lines of their sensors, so that a line does not count as white noise."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from twin.estimation.innovations import FOLLOWS, USE_I, USE_X, Series
from twin.estimation.periodogram import periodogram
from twin.estimation.record import FloatArray, runs
from twin.evidence.noise_levels import RESTS
from twin.settings import diagnosis as settings

_MAX_LINES = 6  # lines of a channel, their harmonics included
_BLOCK = 500  # readings that share amplitude and phase
_MIN_READINGS = 50  # readings for two numbers


def without_lines(series: Series) -> Series:
    """The series without the significant lines of i_c and x with the ball at rest; the same object without any."""
    at_rest = series.flags & RESTS != 0
    if np.count_nonzero(at_rest) < settings.LINE_SAMPLES:
        return series
    step_s = float(np.median(series.step[at_rest]))
    regular = at_rest & (series.flags & FOLLOWS != 0) & (np.abs(series.step - step_s) < 0.02 * step_s)
    steady = regular & (np.diff(series.u, prepend=np.nan) == 0.0)
    i = _cleaned(series.i, steady & (series.flags & USE_I != 0), step_s)
    x = _cleaned(series.x, regular & (series.flags & USE_X != 0), step_s)
    return series if i is series.i and x is series.x else replace(series, i=i, x=x)


def _cleaned(values: FloatArray, known: np.ndarray, step_s: float) -> FloatArray:
    """The values without their lines, in the stretches of the mask `known`."""
    pieces = runs(known, _MIN_READINGS)
    for _ in range(_MAX_LINES):
        spectrum = periodogram([values[p] for p in pieces if p.stop - p.start >= settings.LINE_SAMPLES], step_s)
        highest = settings.LINE_NYQUIST_SHARE * 0.5 / step_s
        at = None if spectrum is None else spectrum.strongest(settings.LINE_LOWEST_HZ, highest)
        if spectrum is None or at is None:
            break
        tried = int(np.count_nonzero(spectrum.frequency_hz <= highest))
        if spectrum.log_chance(at, tried=tried) > math.log(settings.LINE_CHANCE):
            break
        values = values.copy()
        for piece in pieces:
            for begin in range(piece.start, piece.stop, _BLOCK):
                block = slice(begin, min(begin + _BLOCK, piece.stop))
                if block.stop - block.start >= _MIN_READINGS:
                    values[block] -= _sinusoid(values[block], float(spectrum.frequency_hz[at]) * step_s)
    return values


def _sinusoid(values: FloatArray, turns: float) -> FloatArray:
    """The sinusoid of so many turns a reading in the values, by least squares beside a straight line."""
    k = np.arange(len(values)) - 0.5 * (len(values) - 1)
    regressors = np.column_stack(
        [np.cos(2.0 * np.pi * turns * k), np.sin(2.0 * np.pi * turns * k), np.ones(len(k)), k / len(k)]
    )
    weights = np.linalg.lstsq(regressors, values, rcond=None)[0]
    return np.asarray(regressors[:, :2] @ weights[:2])
