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

from twin.diagnosis.search.line_place import place_lead, reading_leads
from twin.diagnosis.search.score_test import Score, probed
from twin.estimation.innovations import Series, whitened
from twin.estimation.periodogram import TRIED, highest_hz, spectrum_of
from twin.estimation.record import FloatArray
from twin.inference.fisher_scoring import Fit
from twin.inference.likelihood import Criterion
from twin.model.causes.catalogue import CATALOGUE
from twin.model.causes.cause import Cause
from twin.model.causes.sensor_line import FIRST
from twin.settings import diagnosis as settings

# Column of the channel that has the line, 0 for i_c, 1 for x.
CHANNELS = {cause.name: FIRST.index(cause.strength.index) for cause in CATALOGUE if cause.detector == "sensor-line"}


@dataclass(frozen=True, slots=True, kw_only=True)
class Line:
    """A line in the innovations of a channel."""

    frequency_hz: float
    amplitude: float  # of the whitened innovations
    harmonics: tuple[float, ...]  # amplitudes of the second and third over that of the first; 0: not significant


def find_line(series: Series, white: FloatArray, column: int, step_s: float) -> Line | None:
    """The line of a channel that stands out most; None if noise may have made it.

    Args:
        series: the samples.
        white: whitened innovations, shape (n, 2).
        column: 0 for i_c, 1 for x.
        step_s: the sampling interval, s.
    """
    spectrum = spectrum_of(series, white[:, column], np.isfinite(white[:, column]), step_s)
    if spectrum is None:
        return None
    at = spectrum.harmonics(settings.LINE_LOWEST_HZ, highest_hz(step_s))
    if not at or at[0] is None:
        return None
    size = spectrum.amplitude(at[0])
    return Line(
        frequency_hz=float(spectrum.frequency_hz[at[0]]),
        amplitude=size,
        harmonics=tuple(0.0 if k is None else spectrum.amplitude(k) / size for k in at[1:]),
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
        if line is None:
            continue
        # The motion of the ball must show that a line of i_c does not flow, as the name says.
        lead = (
            reading_leads(criterion, current.theta, line.frequency_hz)
            if column == 0
            else place_lead(criterion, current.theta, cause.name, line.frequency_hz)
        )
        if lead > settings.EQUIVALENT_GAIN:
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
    # The filter follows a part of the line, so its innovations show less than its size: multiples of it are tried.
    sizes = [min(size * factor, 0.5 * strength.high) for factor in settings.LINE_SIZES]
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
        chance=math.log(TRIED),
        other_values=other,
    )
