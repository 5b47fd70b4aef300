"""The readings of a ball at rest without the lines of their sensors, so that a line does not count as white noise."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from twin.estimation.innovations import FOLLOWS, USE_I, USE_X, Series
from twin.estimation.periodogram import highest_hz, spectrum_of
from twin.estimation.record import BoolArray, FloatArray, runs
from twin.evidence.noise_levels import RESTS
from twin.model.causes.sensor_line import MEMORY_S
from twin.settings import diagnosis as settings


def without_lines(series: Series) -> Series:
    """The series without the significant lines of i_c and x with the ball at rest; the same object without any."""
    at_rest = series.flags & RESTS != 0
    if np.count_nonzero(at_rest) < settings.LINE_SAMPLES:
        return series
    step_s = float(np.median(series.step[at_rest]))
    follows = at_rest & (series.flags & FOLLOWS != 0)
    steady = follows & (np.diff(series.u, prepend=np.nan) == 0.0)
    i = _cleaned(series, series.i, steady & (series.flags & USE_I != 0), step_s)
    x = _cleaned(series, series.x, follows & (series.flags & USE_X != 0), step_s)
    return series if i is series.i and x is series.x else replace(series, i=i, x=x)


def _cleaned(series: Series, values: FloatArray, known: BoolArray, step_s: float) -> FloatArray:
    """The values without their lines where the mask `known` is set."""
    pieces = runs(np.asarray(known & np.isfinite(values)), settings.WAVE_READINGS)
    # In blocks, with phase and size anew in each: the mains wander, so that one sinusoid over minutes would leave most
    # of the line.
    length = max(round(MEMORY_S / step_s), settings.LINE_SAMPLES)
    blocks = [
        block
        for piece in pieces
        for begin in range(piece.start, piece.stop, length)
        if (block := slice(begin, min(begin + length, piece.stop))).stop - begin >= settings.WAVE_READINGS
    ]
    level = np.full(len(values), np.nan)  # of each piece: one input or one stop; their steps would be lines
    for piece in pieces:
        level[piece] = np.mean(values[piece])
    known = np.isfinite(level)
    # One line at a time, the strongest first: its side lobes would count as lines of their own.
    for _ in range(settings.MAX_LINES):
        spectrum = spectrum_of(series, values - level, known, step_s)
        at = None if spectrum is None else spectrum.line(settings.LINE_LOWEST_HZ, highest_hz(step_s))
        if spectrum is None or at is None:
            break
        turns = float(spectrum.frequency_hz[at]) * step_s
        values = values.copy()
        for block in blocks:
            values[block] = _without(values[block], turns)
    return values


def _without(values: FloatArray, turns: float) -> FloatArray:
    """The values without the sinusoid of so many turns a reading, found by least squares beside a straight line.

    What is left is as large as before in the mean: a sinusoid takes two degrees of freedom of its noise with it.
    """
    k = np.arange(len(values)) - 0.5 * (len(values) - 1)
    line = np.column_stack([np.ones(len(k)), k / len(k)])
    wave = np.column_stack([np.cos(2.0 * np.pi * turns * k), np.sin(2.0 * np.pi * turns * k)])
    weights = np.linalg.lstsq(np.column_stack([line, wave]), values, rcond=None)[0]
    trend = line @ weights[:2]
    rest = values - trend - wave @ weights[2:]
    return np.asarray(trend + rest * math.sqrt(len(values) / (len(values) - 2.0)))
