"""A line of a sensor: its frequency from the innovations of its channel, its start and gain from the likelihood.

A force of the same frequency is another candidate (`periodic.py`).  The likelihood of the fits decides: a force acts on
the ball in flight alone, and moves it more where the magnet pulls less; an error of the sensor is also there at rest.

Rule 1: a line must stand out of the innovations around it by Fisher's test (`twin/estimation/periodogram.py`).  Only
        then does it cost runs of the filter.
Rule 2: the harmonics of a line are those multiples of its frequency that stand out, too.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from twin.diagnosis.search.score_test import Score, probed
from twin.estimation.innovations import FOLLOWS, Series, whitened
from twin.estimation.periodogram import Periodogram, periodogram
from twin.estimation.record import FloatArray, runs
from twin.inference.fisher_scoring import Fit
from twin.inference.likelihood import Criterion
from twin.model.causes.catalogue import CATALOGUE
from twin.model.causes.cause import Cause
from twin.model.causes.sensor_line import FIRST, HARMONICS
from twin.settings import diagnosis as settings

# Column of the channel that has the line, 0 for i_c, 1 for x.
CHANNELS = {cause.name: FIRST.index(cause.strength.index) for cause in CATALOGUE if cause.detector == "sensor-line"}
_SIZES = (1.0, 2.0, 4.0, 8.0)  # of a line, over that in the innovations: the filter follows a part of it


@dataclass(frozen=True, slots=True, kw_only=True)
class Line:
    """A line in the innovations of a channel."""

    frequency_hz: float
    amplitude: float  # of the whitened innovations
    harmonics: tuple[float, ...]  # amplitudes of the second and third over that of the first; 0: not significant
    log_chance: float  # ln of the probability that noise makes it
    tried: int  # frequencies


def find_line(series: Series, white: FloatArray, column: int, step_s: float) -> Line | None:
    """The line of a channel that stands out most; None if noise may have made it.

    Args:
        series: the samples.
        white: whitened innovations, shape (n, 2).
        column: 0 for i_c, 1 for x.
        step_s: the sampling interval, s.
    """
    spectrum = periodogram(_stretches(series, white[:, column], step_s), step_s)
    if spectrum is None:
        return None
    highest = settings.LINE_NYQUIST_SHARE * 0.5 / step_s
    at = spectrum.strongest(settings.LINE_LOWEST_HZ, highest)
    tried = int(np.count_nonzero(spectrum.frequency_hz <= highest))
    if at is None or spectrum.log_chance(at, tried=tried) > math.log(settings.LINE_CHANCE):
        return None
    log_chance = spectrum.log_chance(at, tried=tried)
    for divisor in range(HARMONICS, 1, -1):  # the strongest may be a harmonic itself
        below = _significant(spectrum, float(spectrum.frequency_hz[at]) / divisor)
        if below is not None and spectrum.frequency_hz[below] > settings.LINE_LOWEST_HZ:
            at = below
            break
    first, size = float(spectrum.frequency_hz[at]), spectrum.amplitude(at)
    multiples = [_significant(spectrum, k * first) if k * first < highest else None for k in range(2, HARMONICS + 1)]
    return Line(
        frequency_hz=first,
        amplitude=size,
        harmonics=tuple(0.0 if k is None else spectrum.amplitude(k) / size for k in multiples),
        log_chance=log_chance,
        tried=tried,
    )


def line_scores(criterion: Criterion, current: Fit, candidates: Iterable[Cause]) -> list[Score]:
    """The scores of those candidates that are lines of a sensor and stand out; those in the model are left out."""
    present = {name.partition(".")[0] for name, _ in current.theta.causes}
    missing = [cause for cause in candidates if cause.name in CHANNELS and cause.name not in present]
    if not missing:
        return []
    out = criterion.outputs(current.theta)
    white = whitened(out)
    scores = []
    for cause in missing:
        column = CHANNELS[cause.name]
        line = find_line(criterion.evidence.series, white, column, criterion.tick_s)
        if line is not None:
            sigma = math.sqrt(float(np.nanmedian(out[:, (2, 4)[column]])))
            scores.append(_score(criterion, current, cause, line, line.amplitude * sigma))
    return scores


def _score(criterion: Criterion, current: Fit, cause: Cause, line: Line, size: float) -> Score:
    """The score of a line that has this amplitude in the innovations, A or m."""
    strength = cause.strength
    other = (
        (f"{cause.name}.frequency_hz", line.frequency_hz),
        *((f"{cause.name}.harmonic_{k}", value) for k, value in enumerate(line.harmonics, 2)),
    )
    sizes = [min(size * factor, 0.5 * strength.high) for factor in _SIZES]
    starts = [probed(current.theta, cause, value, other) for value in sizes]
    best = int(np.argmax(criterion.thinner.values(starts)))
    gain = max(criterion.value(starts[best]) - current.loglik, 0.0)
    z = math.sqrt(2.0 * gain)
    return Score(
        cause=cause.name,
        probe=sizes[best],
        gain=gain,
        step=1.0,
        z=z,
        detectable=z * strength.probes[0] / sizes[best],
        visible=1.0,
        moves=(),
        chance=math.log(line.tried),
        other_values=other,
    )


def _significant(spectrum: Periodogram, frequency_hz: float) -> int | None:
    """The significant ordinate at a multiple or a fraction of a frequency that is known to a hundredth of a hertz."""
    at = spectrum.strongest(frequency_hz - settings.LINE_WIDTH_HZ, frequency_hz + settings.LINE_WIDTH_HZ)
    if at is None or spectrum.log_chance(at, tried=HARMONICS * 16) > math.log(settings.LINE_CHANCE):
        return None
    return at


def _stretches(series: Series, values: FloatArray, step_s: float) -> list[FloatArray]:
    """The unbroken stretches of a channel at the usual interval."""
    usual = np.isfinite(values) & (series.flags & FOLLOWS != 0) & (np.abs(series.step - step_s) < 0.02 * step_s)
    return [values[piece] for piece in runs(usual, settings.LINE_SAMPLES)]
