"""A periodic force: its frequency from the spectrum of the innovations, its phase from each recording.

Rule 1: the clock of a periodic force is not the board's, so each recording has its own phase.  Least squares over two
        signatures a quarter of a period apart gives it.  Phases enter the filter as shifts of time.
Rule 2: a line must stand out of the spectrum around it (`twin/estimation/periodogram.py`), so that coloured innovations
        of a wrong model are not a line.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from twin.diagnosis.search.score_test import Score
from twin.estimation.innovations import FLIES
from twin.estimation.periodogram import TRIED, spectrum_of
from twin.estimation.record import FloatArray
from twin.inference.fisher_scoring import Fit, climb
from twin.inference.likelihood import Criterion
from twin.inference.theta import Theta
from twin.model.causes.catalogue import cause_of_detector
from twin.settings import diagnosis as settings

CAUSE = cause_of_detector("spectral-line")
AMPLITUDE, FREQUENCY = (f"{CAUSE.name}.{parameter.name}" for parameter in CAUSE.parameters[:2])
_STEP = 0.1  # rad, to take the slope of a phase by
_FAR_STEPS = 4.0  # of these at once: farther away a parabola does not lead


@dataclass(frozen=True, slots=True, kw_only=True)
class Line:
    """A candidate for a periodic force."""

    frequency_hz: float
    amplitude_n: float
    gain: float  # of log-likelihood
    chance: float  # of it, that the best of all frequencies and free phases make out of noise
    phases_s: tuple[float, ...]  # of each recording, as `Theta` has them


def find_line(criterion: Criterion, theta: Theta, frequency: float | None = None) -> Line | None:
    """The strongest line, or the one at `frequency`, as a force; None where there is none."""
    series = criterion.evidence.series
    frequency = frequency or _strongest(criterion, theta)
    if frequency is None:
        return None
    probe = CAUSE.strength.probes[0]
    count = len(criterion.evidence.records)
    base = criterion.outputs(theta)
    sine, cosine = shaken(criterion, theta, frequency)
    scale = np.sqrt(base[:, 4])
    residual = base[:, 1] / scale
    columns = np.column_stack((sine[:, 1] - base[:, 1], cosine[:, 1] - base[:, 1])) / scale[:, None]
    good = np.isfinite(residual) & np.isfinite(columns).all(axis=1)
    phases_s = [0.0] * count
    gain, weighted, weight, phases = 0.0, 0.0, 0.0, 0
    for number in np.unique(series.recording):
        in_recording = series.recording == number
        use = in_recording & good
        if use.sum() < settings.WAVE_READINGS:  # without a phase it would be shaken at a wrong time
            continue
        design = columns[use]
        normal = design.T @ design
        # Two signatures that nearly coincide determine no phase: without one the recording adds nothing.
        if np.linalg.cond(normal) > 1e10:
            continue
        # An innovation falls where the prediction rises, so residual + columns * pair -> 0.
        pair = np.linalg.solve(normal, design.T @ -residual[use])
        power = float(pair @ normal @ pair)
        gain += 0.5 * power
        phases += 1
        # One amplitude for all recordings: each counts by its information, as a short flight says little.
        size = math.hypot(*pair)
        weighted, weight = weighted + size * float(np.trace(normal)), weight + float(np.trace(normal))
        shift_s = math.atan2(pair[1], pair[0]) / (2.0 * math.pi * frequency)
        phases_s[number] = _without_whole_periods(shift_s, float(criterion.evidence.t[use].mean()), frequency)
    if weight == 0.0:
        return None
    return Line(
        frequency_hz=frequency,
        amplitude_n=probe * weighted / weight,
        gain=gain,
        chance=math.log(TRIED) + phases,
        phases_s=tuple(phases_s),
    )


def shaken(criterion: Criterion, theta: Theta, frequency_hz: float) -> list[FloatArray]:
    """The outputs under a small force of this frequency, as a sine and as a cosine of the time."""
    at = theta.having(FREQUENCY, frequency_hz).having(AMPLITUDE, CAUSE.strength.probes[0])
    count = len(criterion.evidence.records)
    # The phases of an earlier line are not used: the two signatures would not be a quarter of a period apart.
    return [criterion.outputs(replace(at, phases_s=(s,) * count)) for s in (0.0, 0.25 / frequency_hz)]


def frequencies(theta: Theta) -> list[float]:
    """Return the frequency of the force in a model and of each harmonic that it has, Hz."""
    orders = {shape.name.rpartition("_")[2] for shape in CAUSE.shapes if theta.value(f"{CAUSE.name}.{shape.name}")}
    return [k * theta.value(FREQUENCY) for k in (1, *sorted(int(order) for order in orders))]


def score(criterion: Criterion, theta: Theta) -> Score | None:
    """The score of the strongest line as a force; None where there is none, or where the model has it."""
    line = None if any(name == AMPLITUDE for name, _ in theta.causes) else find_line(criterion, theta)
    if line is None:
        return None
    z = math.sqrt(2.0 * line.gain)
    return Score(
        cause=CAUSE.name,
        probe=line.amplitude_n,
        gain=line.gain,
        step=1.0,
        z=z,
        detectable=z * CAUSE.strength.probes[0] / max(line.amplitude_n, 1e-12),
        visible=1.0,
        moves=(),
        chance=line.chance,
        other_values=((FREQUENCY, line.frequency_hz),),
        phases_s=line.phases_s,
    )


def fit_phases(criterion: Criterion, fit: Fit, passes: int) -> Fit:
    """Return the fit with phases that belong to its own frequency, or the old fit if they gain nothing."""
    frequency = fit.theta.value(FREQUENCY)
    line = find_line(criterion, fit.theta.without(CAUSE.name, criterion.plant), frequency)
    return fit if line is None else _with_phases(criterion, fit, line.phases_s, passes)


def refine_phases(criterion: Criterion, fit: Fit, passes: int) -> Fit:
    """The fit with the phase of each recording where its own likelihood is largest.

    The phases of `fit_phases` are a linear estimate.  They are wrong on a ramp in which the force decides when the ball
    lifts off; a lag that was fitted with them came out 3 % short.
    """
    for _ in range(settings.PHASE_ROUNDS):
        again = _with_phases(criterion, fit, _newton_phases(criterion, fit.theta), passes)
        gained, fit = again.loglik - fit.loglik, again
        if gained < settings.PHASE_GAIN:
            break
    return fit


def _with_phases(criterion: Criterion, fit: Fit, phases_s: tuple[float, ...], passes: int) -> Fit:
    """Return the fit with these phases, or the old fit if they gain nothing."""
    again = climb(criterion, replace(fit.theta, phases_s=phases_s), fit.free, passes=passes)
    return again if again.loglik > fit.loglik else fit


def _newton_phases(criterion: Criterion, theta: Theta) -> tuple[float, ...]:
    """Return the phases a Newton step nearer to the best of each recording, s."""
    series = criterion.evidence.series
    phases_s = list(theta.phases_s or (0.0,) * len(criterion.evidence.records))
    step = _STEP / (2.0 * math.pi * theta.value(FREQUENCY))
    # Three runs for the phases of all recordings at once: each sample depends on the phase of its own recording alone.
    less, middle, more = (
        criterion.white(replace(theta, phases_s=tuple(phase + shift_s for phase in phases_s)))[0]
        for shift_s in (-step, 0.0, step)
    )
    for number in np.unique(series.recording):
        in_recording = series.recording == number
        slope, curve = (
            float(np.sum((more - less)[in_recording])),
            float(np.sum((more - 2.0 * middle + less)[in_recording])),
        )
        # Where the curvature has the wrong sign a Newton step would lead downwards, so the phase stays.
        shift_s = step * float(np.clip(0.5 * slope / curve, -_FAR_STEPS, _FAR_STEPS)) if curve < 0.0 else 0.0
        middle_s = float(criterion.evidence.t[in_recording].mean())
        phases_s[number] = _without_whole_periods(phases_s[number] - shift_s, middle_s, theta.value(FREQUENCY))
    return tuple(phases_s)


def _without_whole_periods(shift_s: float, middle_s: float, frequency_hz: float) -> float:
    """The shift less whole periods, so that another frequency turns the phase about the middle of the recording.

    A minute away, a thousandth of a hertz would turn the whole phase, and phase and frequency would fix each other.
    """
    return shift_s - round((shift_s + middle_s) * frequency_hz) / frequency_hz


def _strongest(criterion: Criterion, theta: Theta) -> float | None:
    """The frequency of the line of x in flight that stands out most, all recordings together; None without one."""
    series, step_s = criterion.evidence.series, criterion.tick_s
    _, white = criterion.white(theta)
    flying = (series.flags & FLIES != 0) & np.isfinite(white[:, 1])
    spectrum = spectrum_of(series, white[:, 1], flying, step_s)
    # Not up to the end of the spectrum: a fast force hardly moves the ball.
    low_hz, high_hz = CAUSE.parameters[1].low, min(CAUSE.parameters[1].high, settings.FORCE_HIGHEST / step_s)
    at = None if spectrum is None else spectrum.line(low_hz, high_hz)
    return None if spectrum is None or at is None else float(spectrum.frequency_hz[at])
