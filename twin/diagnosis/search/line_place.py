"""The place of a line of x, the force or the reading: each as a sinusoid with a phase in each recording.

The fits of the two are not comparable where the data hardly tell them apart.  A force has one size and a phase for
each recording, at their best; the states of a sensor's line have both integrated out, and lose ln(1 + gain) for each
recording by it.  So they are compared by least squares, both with one size and a phase for each recording.  With r the
whitened innovations of a recording and A how a sine and a cosine move them, A' A is n times the unit matrix, and

    gain = 1/2 (sum of |A' r|)^2 / sum of n,     sums over the recordings

Rule 1: the sinusoid of a force goes through the dynamics of the ball, in flight alone.  That of a reading does not, and
        is there at rest, too.
Rule 2: a line of i_c is a reading's error if a current that flows explains the motion of the ball less well.
Rule 3: the noise is that of the fit with the line: without it, process noise would take up a part of the line.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, Literal

import numpy as np

from twin.diagnosis.search import periodic
from twin.diagnosis.search.candidate_fits import Trial, refine
from twin.estimation.innovations import Series, whitened
from twin.estimation.record import FloatArray
from twin.inference.likelihood import Criterion
from twin.inference.theta import Theta
from twin.model.causes.catalogue import BY_NAME, CATALOGUE
from twin.model.causes.sensor_line import FIRST, harmonics
from twin.settings import diagnosis as settings

FORCE = periodic.CAUSE.name
SENSOR = next(c.name for c in CATALOGUE if c.detector == "sensor-line" and c.strength.index == FIRST[1])
_CURRENT_A = 0.002  # of a wave whose effect is linear; the comparison does not depend on its size


def placed(criterion: Criterion, selected: Trial, trials: Sequence[Trial]) -> list[Trial]:
    """The trials, with the gain of the other place of a selected line of x as it compares with the selected one."""
    other = next((trial for trial in trials if {trial.cause, selected.cause} == {FORCE, SENSOR}), None)
    if other is None:
        return list(trials)
    gains = place_gains(criterion, selected.fit.theta)
    # Least squares hold for small effects.  A lead within a thousandth of the gain may come from a large line, and
    # counts as none.
    lead = gains[other.cause] - gains[selected.cause]
    decided = abs(lead) > settings.PLACE_SHARE * gains[selected.cause]
    moved = replace(other, gain=selected.gain + (lead if decided else 0.0))
    if moved.gain > selected.gain + settings.EQUIVALENT_GAIN:  # it will be the selected one
        moved = replace(refine(criterion, moved), gain=moved.gain)
    rest = [trial for trial in trials if trial is not other]
    return sorted([*rest, moved], key=lambda trial: -trial.gain)


def place_gains(criterion: Criterion, theta: Theta) -> Mapping[str, float]:
    """The gain of log-likelihood by the line of a model as a force, and as an error of x.

    Both have the harmonics of the model.
    """
    lines = [hz for hz, size in harmonics(theta.vector(), 1) if size > 0.0] or periodic.frequencies(theta)
    bare = replace(theta.without(FORCE, criterion.plant).without(SENSOR, criterion.plant), phases_s=())
    white = whitened(criterion.outputs(bare))
    # The signatures are differences of whole runs of the filter: it reacts to a line, and follows a part of it.
    return {
        FORCE: sum(_gain(criterion, white, _forced(criterion, bare, white, hz)) for hz in lines),
        SENSOR: sum(_gain(criterion, white, _misread(criterion, bare, white, hz)) for hz in lines),
    }


def reading_leads(criterion: Criterion, theta: Theta, frequency_hz: float) -> float:
    """The lead of log-likelihood of a line of i_c as an error of its reading over one as a current that flows.

    A current that flows moves the ball, as behind a supply with a ripple.  The catalogue does not have it.
    """
    white = whitened(criterion.outputs(theta))
    misread = _moved(criterion, theta, white, _waves(criterion, "i", _CURRENT_A, frequency_hz))
    flows = _moved(criterion, theta, white, _waves(criterion, "u", _CURRENT_A / theta.K_A, frequency_hz))
    return _gain(criterion, white, misread) - _gain(criterion, white, flows)


def place_lead(criterion: Criterion, theta: Theta, cause: str, frequency_hz: float) -> float:
    """The lead of log-likelihood of a further line of x at one place over the other, which the model has a line of.

    A model has one force and one line of the sensor.  inf without the other: it then competes as a candidate.
    """
    other = {SENSOR: FORCE, FORCE: SENSOR}[cause]
    if not any(name.startswith(f"{other}.") for name, _ in theta.causes):
        return math.inf
    lead = _sensor_lead(criterion, theta, frequency_hz)
    return lead if cause == SENSOR else -lead


def _sensor_lead(criterion: Criterion, theta: Theta, frequency_hz: float) -> float:
    """The lead of a line of x as an error of its reading over a force, both beside those of the model."""
    white = whitened(criterion.outputs(theta))
    bare = replace(theta.without(FORCE, criterion.plant), phases_s=())
    force = _forced(criterion, bare, whitened(criterion.outputs(bare)), frequency_hz)
    return _gain(criterion, white, _misread(criterion, theta, white, frequency_hz)) - _gain(criterion, white, force)


def _forced(criterion: Criterion, bare: Theta, white: FloatArray, frequency_hz: float) -> list[FloatArray]:
    """The changes of the whitened innovations of a model without a periodic force by a sine and a cosine of one."""
    return [whitened(out) - white for out in periodic.shaken(criterion, bare, frequency_hz)]


def _misread(criterion: Criterion, theta: Theta, white: FloatArray, frequency_hz: float) -> list[FloatArray]:
    """The changes of the whitened innovations by a sine and a cosine in the readings of x, each of shape (n, 2)."""
    size_m = BY_NAME[SENSOR].strength.probes[0]
    return _moved(criterion, theta, white, _waves(criterion, "x", size_m, frequency_hz))


def _waves(criterion: Criterion, channel: Literal["u", "i", "x"], size: float, frequency_hz: float) -> list[Series]:
    """The series with a sine and with a cosine of this size in a channel."""
    series = criterion.evidence.series
    turns = frequency_hz * criterion.evidence.t
    values: dict[str, FloatArray] = {"u": series.u, "i": series.i, "x": series.x}
    moved = [values[channel] + size * np.sin(2.0 * np.pi * (turns + phase)) for phase in (0.0, 0.25)]
    changes: list[dict[str, Any]] = [{channel: wave} for wave in moved]
    return [replace(series, **change) for change in changes]


def _moved(criterion: Criterion, theta: Theta, white: FloatArray, waves: Sequence[Series]) -> list[FloatArray]:
    parts = [criterion.over(replace(criterion.evidence, series=series)) for series in waves]
    return [whitened(part.outputs(theta)) - white for part in parts]


def _gain(criterion: Criterion, white: FloatArray, moves: Sequence[FloatArray]) -> float:
    recording = criterion.evidence.series.recording
    total = weight = 0.0
    for number in np.unique(recording):
        rows = recording == number
        columns = np.column_stack([move[rows].ravel() for move in moves])
        residual = white[rows].ravel()
        good = np.isfinite(residual) & np.isfinite(columns).all(axis=1)
        if np.count_nonzero(good) < settings.WAVE_READINGS or not columns[good].any():
            continue
        # With a cutoff: where sine and cosine nearly coincide, least squares would give huge amplitudes for nothing.
        fitted = columns[good] @ np.linalg.lstsq(columns[good], residual[good], rcond=1e-6)[0]
        # Both columns weigh alike, as A' A is nearly n times the unit matrix over many periods.  Exact weights would
        # need a search for the phases.
        n = 0.5 * float(np.sum(columns[good] ** 2))
        total, weight = total + math.sqrt(n) * float(np.linalg.norm(fitted)), weight + n
    return 0.5 * total**2 / weight if weight > 0.0 else 0.0
