"""The lines in the spectra of a diagnosis: the channel of each, its frequency and its size.

Rule 1: a line that a cause explains is in the sensor or in the force, as its likelihood decided.  A line of the
        innovations that no cause explains is reported with its channel only.
Rule 2: a line of u_c is the loop's response to one of these: u_c is computed, and has no noise of its own.
Rule 3: the size of a sensor's line is the mean amplitude of its states in the filter over the recordings, and its error
        is their scatter.  In the likelihood it is a variance of the initial state: two values in each recording.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from twin.diagnosis.report.quantities import quantity
from twin.diagnosis.result import Finding, SpectralLine
from twin.diagnosis.search.line_place import reading_leads
from twin.diagnosis.search.sensor_line import CHANNELS, Line, find_line
from twin.estimation.ekf.filter import filtered
from twin.estimation.innovations import FLIES, whitened
from twin.estimation.periodogram import spectrum_of
from twin.estimation.record import FloatArray
from twin.inference.fisher_scoring import Fit
from twin.inference.likelihood import Criterion
from twin.inference.theta import Theta, coordinates_of
from twin.model.causes.catalogue import BY_NAME, cause_of_detector
from twin.model.extended import I_LINES, X_LINES
from twin.model.parameters import Parameter
from twin.settings import diagnosis as settings

FORCE = cause_of_detector("spectral-line").name
_UNITS = {"i_c": "A", "x": "m"}


def with_sizes(criterion: Criterion, fit: Fit) -> tuple[Fit, dict[str, float]]:
    """Return the fit with the measured amplitudes of the sensors' lines, and their standard errors by coordinate."""
    errors: dict[str, float] = {}
    theta = fit.theta
    for cause, column in CHANNELS.items():
        strength, _, *ratios = coordinates_of(cause)
        if theta.value(strength) == 0.0:
            continue
        first = _sizes(criterion, theta, (I_LINES, X_LINES)[column])
        if len(first) < 2:
            continue
        fit, errors[strength] = _measured(fit, strength, first)
        for k, name in enumerate(ratios, 1):
            if theta.value(name) > 0.0:
                sizes = _sizes(criterion, theta, (I_LINES, X_LINES)[column] + 2 * k)
                fit, errors[name] = _measured(fit, name, sizes / float(np.mean(first)))
    return fit, errors


def _measured(fit: Fit, name: str, values: FloatArray) -> tuple[Fit, float]:
    """Return (the fit with `name` at the mean of `values`, one for each recording, its standard error)."""
    # The scatter between recordings gives the error.  The likelihood has the amplitude as a variance, known from two
    # values in each recording.
    fit = replace(fit, theta=fit.theta.having(name, float(np.mean(values))))
    return fit, float(np.std(values, ddof=1)) / math.sqrt(len(values))


def lines_of(findings: Sequence[Finding], criterion: Criterion, theta: Theta) -> tuple[SpectralLine, ...]:
    """The lines of the named causes and of the loop's answer, then those that `theta` leaves in the innovations."""
    lines: list[SpectralLine] = []
    for finding in findings:
        if finding.name in (FORCE, *CHANNELS):
            line = SpectralLine(
                channel="force" if finding.name == FORCE else ("i_c", "x")[CHANNELS[finding.name]],
                cause=finding.name,
                frequency_hz=finding.parameters["frequency_hz"],
                amplitude=finding.parameters[BY_NAME[finding.name].strength.name],
                sentence=finding.sentence,
            )
            lines += [line, *_answer(criterion, line)]
    out = criterion.outputs(theta)
    for column, (channel, unit) in enumerate(_UNITS.items()):
        left = find_line(criterion.evidence.series, whitened(out), column, criterion.tick_s)
        if left is not None:
            size = left.amplitude * math.sqrt(float(np.nanmedian(out[:, (2, 4)[column]])))
            lines.append(
                SpectralLine(
                    channel=channel,
                    cause="",
                    frequency_hz=Parameter(value=left.frequency_hz, unit="Hz"),
                    amplitude=Parameter(value=size, unit=unit),
                    sentence=f"the error of {channel} one sample ahead has a line of {quantity(size, unit)} at"
                    f" {left.frequency_hz:.2f} Hz that no cause explains{_current(criterion, theta, left, column)}",
                )
            )
    return tuple(lines)


def _current(criterion: Criterion, theta: Theta, line: Line, column: int) -> str:
    """Return a remark if the ball shows that the current of an unexplained line of i_c flows; "" otherwise."""
    if column or reading_leads(criterion, theta, line.frequency_hz) > -settings.EQUIVALENT_GAIN:
        return ""
    return ": the ball follows it, so this current flows, as behind a supply with a ripple"


def _answer(criterion: Criterion, line: SpectralLine) -> list[SpectralLine]:
    """The line of u_c in flight at the frequency of a cause; empty where none stands out."""
    series, frequency_hz = criterion.evidence.series, line.frequency_hz.value
    spectrum = spectrum_of(series, series.u, series.flags & FLIES != 0, criterion.tick_s)
    if spectrum is None:
        return []
    width_hz = settings.LINE_WIDTH_HZ
    at = spectrum.line(frequency_hz - width_hz, frequency_hz + width_hz)
    if at is None:
        return []
    size_v = spectrum.amplitude(at)
    sentence = f"the loop answers to it: u_c swings by {quantity(size_v, 'V')} at {frequency_hz:.2f} Hz"
    amplitude = Parameter(value=size_v, unit="V")
    return [replace(line, channel="u_c", amplitude=amplitude, sentence=sentence)]


def _sizes(criterion: Criterion, theta: Theta, first: int) -> FloatArray:
    """The amplitude of a line in each recording that is long enough; `first`: of its states."""
    series = criterion.evidence.series
    samples = theta.samples(criterion.evidence.samples, series.recording)
    state = filtered(theta.system(criterion.plant, criterion.tick_s), samples, state=True).state
    # Both states together: their squares add up to that of the amplitude at any phase.
    squares = state[:, first] ** 2 + state[:, first + 1] ** 2
    known = np.isfinite(squares)
    counts = np.bincount(series.recording[known])
    means = np.bincount(series.recording[known], squares[known]) / np.maximum(counts, 1)
    return np.asarray(np.sqrt(means[counts >= settings.LINE_SAMPLES]))
