"""The colour of the sensor noise, from the ball at rest and from captures away from their step, without a model.

A part of a reading's noise is white.  The correlation of the rest decays exponentially, as behind a low-pass filter
(Ornstein-Uhlenbeck).  Level, share and correlation time maximise the restricted likelihood of windows under a constant
input.  Mean and slope of each window are projected out (H. D. Patterson, R. Thompson, Biometrika 58(3), 1971).

Rule 1: noise is coloured only if three conditions hold.  It is significant without the window that shows it most.
        Successive readings are correlated by more than a limit.  A wandering offset explains the windows less well.
Rule 2: the noise of captures is that of the other recordings unless they surely differ.  A capture of 10 ms does not
        separate slow noise from an offset.
Rule 3: without a ball at rest, noise counts as white: in flight, coloured noise of x looks like missing dynamics.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import null_space, toeplitz

from twin.distributions import chi2_exceeded
from twin.estimation.innovations import CAPTURED, FLIES, FOLLOWS, USE_I, USE_X, Series
from twin.estimation.record import BoolArray, FloatArray, runs
from twin.evidence.gather import Evidence
from twin.evidence.noise_levels import RESTS, Colour, uncut
from twin.evidence.rest_lines import without_lines
from twin.model.integration import SHORT_S
from twin.settings import diagnosis as settings

WINDOW = settings.COLOUR_WINDOW  # readings; the matrices below are made for it
# Grids over the ranges of `TAU_S` and `WHITE` of `twin/inference/theta.py`.
_TAU_S = np.geomspace(2e-4, 0.1, 41)
_WHITE = np.concatenate((np.geomspace(1e-3, 0.5, 14), 1.0 - np.geomspace(0.4, 0.02, 8)))
_FREE = null_space(np.vander(np.arange(WINDOW) - 0.5 * (WINDOW - 1.0), 2).T).T  # projects mean and slope out
_WALK = _FREE @ np.minimum.outer(np.arange(WINDOW), np.arange(WINDOW)) @ _FREE.T / WINDOW


@dataclass(frozen=True, slots=True, kw_only=True)
class _Windows:
    """Windows of one instrument at one interval."""

    step_s: float
    rows: FloatArray  # without mean and slope, shape (count, WINDOW - 2)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Fit:
    """The largest likelihood of one kind of noise."""

    each: FloatArray  # log-likelihood of each window
    colour: Colour | None = None

    @property
    def total(self) -> float:
        return float(self.each.sum())


def colours_of(evidences: Sequence[Evidence]) -> tuple[Colour | None, Colour | None, Colour | None]:
    """The colours of i_c, x, and i_c in captures; None: white, or not known."""
    calm = [without_lines(evidence.series) for evidence in evidences]
    i_c, x, captured = (
        [entry for series in calm for entry in _windows(series, column, captures=captures)]
        for column, captures in ((0, False), (1, False), (0, True))
    )
    i_c_colour, captured_colour = _colour(i_c), _colour(captured)
    if i_c_colour is not None and captured:
        # Together and apart, by the likelihood ratio: the instrument of captures may be another one, or the same behind
        # another filter.
        joint, separate = (
            _coloured([*i_c, *captured]),
            _coloured(i_c).total + max(_white(captured).total, _coloured(captured).total),
        )
        if 2.0 * (separate - joint.total) < chi2_exceeded(settings.COLOUR_CHANCE, 3):
            # One colour, with three parameters fewer, unless two are significantly better.
            i_c_colour = captured_colour = joint.colour
    return i_c_colour, _colour(x), captured_colour


def expected_gain(colour: Colour, step_s: float, weights: FloatArray) -> float:
    """Return the mean square of a weighted sum of successive readings over that of white noise of the same level.

    `step_s` is the interval of the readings; `weights` has shape (n,).
    """
    covariance = colour.white * np.eye(len(weights)) + (1.0 - colour.white) * _correlation(
        colour.tau_s, step_s, len(weights)
    )
    return float(weights @ covariance @ weights / (weights @ weights))


def _colour(windows: Sequence[_Windows]) -> Colour | None:
    if sum(len(part.rows) for part in windows) < settings.COLOUR_WINDOWS:
        return None
    # The score needs no fit, so white noise is recognised without the costly grid of fits.
    if max(_score(windows, tau_s) for tau_s in _TAU_S[::5].tolist()) < settings.COLOUR_SCORE:
        return None
    white, coloured = _white(windows), _coloured(windows)
    gains = coloured.each - white.each
    min_gain = 0.5 * chi2_exceeded(settings.COLOUR_CHANCE, 2)
    # Without the best window, as one disturbed window must not make the noise of a whole campaign coloured.
    surely = float(gains.sum() - gains.max()) > min_gain and coloured.total > _wandering(windows).total
    colour = coloured.colour
    assert colour is not None
    successive = max((1.0 - colour.white) * math.exp(-part.step_s / colour.tau_s) for part in windows)
    return colour if surely and successive > settings.MAX_AUTOCORRELATION else None


def _score(windows: Sequence[_Windows], tau_s: float) -> float:
    """Return the score of a small part with this correlation time in white noise, in standard errors."""
    # The score test (C. R. Rao, 1948) for a second number beside the variance, (S 8).
    variance = sum(float(np.sum(part.rows**2)) for part in windows) / sum(part.rows.size for part in windows)
    slope = information = trace = 0.0
    for part in windows:
        shape = _free_of_trend(tau_s, part.step_s)
        slope += 0.5 * (
            float(np.sum(part.rows @ shape * part.rows)) / variance - len(part.rows) * float(np.trace(shape))
        )
        information += 0.5 * len(part.rows) * float(np.sum(shape**2))
        trace += len(part.rows) * float(np.trace(shape))
    information -= 0.5 * trace**2 / sum(part.rows.size for part in windows)
    return slope / math.sqrt(information)


@cache
def _free_of_trend(tau_s: float, step_s: float) -> FloatArray:
    return np.asarray(_FREE @ _correlation(tau_s, step_s, WINDOW) @ _FREE.T)


@cache
def _axes(tau_s: float, step_s: float) -> tuple[FloatArray, FloatArray]:
    values, axes = np.linalg.eigh(_free_of_trend(tau_s, step_s))
    return values, axes


def _correlation(tau_s: float, step_s: float, count: int) -> FloatArray:
    """Return exp(-|k - l| step_s / tau_s), shape (count, count)."""
    return np.asarray(toeplitz(np.exp(-np.arange(count) * step_s / tau_s)))


def _white(windows: Sequence[_Windows]) -> _Fit:
    return _Fit(each=_likelihood([(part.rows**2, np.ones(WINDOW - 2)) for part in windows])[0])


def _coloured(windows: Sequence[_Windows]) -> _Fit:
    best: _Fit | None = None
    # A grid, not an optimiser: the likelihood is flat between white noise and short correlation times, and the
    # eigenvectors of each time are cached.
    for tau_s in _TAU_S.tolist():
        transformed = []
        for part in windows:
            values, axes = _axes(tau_s, part.step_s)
            transformed.append(((part.rows @ axes) ** 2, values))
        for white in _WHITE.tolist():
            each, sigma = _likelihood([(squares, white + (1.0 - white) * values) for squares, values in transformed])
            if best is None or each.sum() > best.total:
                best = _Fit(
                    each=each, colour=Colour(tau_s=tau_s, white=white, sigma=sigma, readings=each.size * WINDOW)
                )
    assert best is not None
    return best


def _wandering(windows: Sequence[_Windows]) -> _Fit:
    """Fit white noise with an offset that wanders."""
    # Its variance grows with the interval, so windows of another interval are scaled.  Without this rival a slow walk
    # would count as a colour with a long correlation time.
    values, axes = np.linalg.eigh(_WALK)
    fits = []
    for white in _WHITE.tolist():
        transformed = [
            ((part.rows @ axes) ** 2, white + (1.0 - white) * part.step_s / windows[0].step_s * values)
            for part in windows
        ]
        fits.append(_Fit(each=_likelihood(transformed)[0]))
    return max(fits, key=lambda fit: fit.total)


def _likelihood(transformed: Sequence[tuple[FloatArray, FloatArray]]) -> tuple[FloatArray, float]:
    """Return (log-likelihood of each window, its maximising standard deviation) from squares and relative variances."""
    # The variance has a maximum in closed form, so the grid has two numbers and not three.
    squares = [rows / variances for rows, variances in transformed]
    variance = sum(float(values.sum()) for values in squares) / sum(values.size for values in squares)
    each = [
        -0.5 * (values.sum(axis=1) / variance + float(np.log(variance * variances).sum()))
        for values, (_, variances) in zip(squares, transformed, strict=True)
    ]
    return np.concatenate(each), math.sqrt(variance)


def _windows(series: Series, column: int, *, captures: bool) -> list[_Windows]:
    """Return the windows of i_c (column 0) or x under a constant input, with the ball at rest or from captures."""
    values = (series.i, series.x)[column]
    use = (USE_I, USE_X)[column]
    changed = _changed(series)
    used = series.flags & use != 0
    used &= uncut(series, values, used)
    if captures:
        allowed = used & settled_captures(series)
    else:
        rest = (series.flags & RESTS != 0) & (series.flags & FLIES == 0)
        allowed = used & ~is_fast(series) & rest & (_since(changed) >= settings.COLOUR_SETTLES)
    rows_of_step: dict[float, list[FloatArray]] = {}
    for piece in runs(allowed, WINDOW):
        for start in range(piece.start, piece.stop - WINDOW + 1, WINDOW):
            window = slice(start, start + WINDOW)
            if changed[window][1:].any():
                continue
            # Three digits of the interval: jitter of the clock would give each window matrices of its own.
            step_s = float(f"{np.median(series.step[start + 1 : start + WINDOW]):.3g}")
            rows_of_step.setdefault(step_s, []).append(_FREE @ values[window])
    return [calm for step_s, rows in rows_of_step.items() if (calm := _calm(step_s, np.array(rows))) is not None]


def settled_captures(series: Series) -> BoolArray:
    """Return a mask of captured samples before the step, or long enough after it, shape (n,)."""
    follows, changed = series.flags & FOLLOWS != 0, _changed(series)
    steps = np.cumsum(changed & follows) - np.maximum.accumulate(np.where(follows, 0, np.cumsum(changed & follows)))
    return np.asarray(is_fast(series) & ((steps == 0) | (_since(changed) >= settings.COLOUR_SETTLES_FAST)))


def _changed(series: Series) -> BoolArray:
    """Return a mask of samples at which u_c is not that of the sample before, shape (n,)."""
    return np.asarray((series.flags & FOLLOWS == 0) | (np.diff(series.u, prepend=series.u[:1]) != 0.0))


def _since(changed: BoolArray) -> NDArray[np.int64]:
    """Return the number of samples since the last change, shape (n,)."""
    index = np.arange(len(changed))
    return index - np.maximum.accumulate(np.where(changed, index, 0))


def is_fast(series: Series) -> BoolArray:
    """Return a mask of captured or equally fast samples, shape (n,): they may be of another instrument."""
    begins = series.flags & FOLLOWS == 0
    step_s = np.where(begins, np.append(series.step[1:], np.inf), series.step)  # the first sample has no interval
    return np.asarray((series.flags & CAPTURED != 0) | (step_s < SHORT_S))


def _calm(step_s: float, rows: FloatArray) -> _Windows | None:
    """Remove windows far noisier than the others; None if only rounding is left."""
    squares = np.mean(rows**2, axis=1)
    # The median as the scale: in a mean, a window in which the rig was touched would hide itself.
    calm = (squares <= settings.RESTLESS * float(np.median(squares))) & (squares > 0.0)
    return _Windows(step_s=step_s, rows=rows[calm]) if calm.any() else None
