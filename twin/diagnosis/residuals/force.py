"""Residual force and residual current of a model as functions of the state.

Residual force: m (measured acceleration - acceleration of (6)).  The measured acceleration is that of a parabola
through 30 ms of readings.  The model's acceleration is averaged with the same weights, so that a right model leaves 0
for any motion.  Residual current: the innovation of i_c, one sample ahead.

Rule 1: the model's acceleration uses the readings of x, and current and speed of the filter.  Within an interval the
        current moves to its value at the next sample, so errors of the amplifier do not affect the force.  A constant
        current would lag by half an interval and imitate a drag.  The filter's x is not used, because for a wrong model
        its error is larger than that of a reading.
Rule 2: the model's sensor effects are first removed from the readings.
Rule 3: a periodic force is left in the residual, because it is not a function of the state.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from protocol.campaign import Plant
from twin.compiled import Packed, kernel
from twin.diagnosis.residuals.regimes import (
    Blocks,
    Estimate,
    bin_labels,
    estimate,
    even_edges,
    means,
    quantile_edges,
    solid,
)
from twin.diagnosis.search import periodic
from twin.estimation.ekf.filter import filtered as run_filter
from twin.estimation.innovations import FLIES, FOLLOWS, USE_I, USE_X
from twin.estimation.record import FloatArray
from twin.evidence.gather import Evidence
from twin.inference.theta import Theta
from twin.model.causes.catalogue import CATALOGUE
from twin.model.extended import I_C, STATES, Base, V, X, position_of_reading, sensor_lag_s
from twin.model.integration import FREE, advance

WINDOW_S = 0.03
MIN_READINGS = 7  # readings in a window
GROUPS = 10
# The middle group is the ball at rest.  Its measured speed is noise to which the loop responds, so several groups there
# would show a spurious force.
_SPEED_SHARES = (0.002, 0.02, 0.08, 0.2, 0.8, 0.92, 0.98, 0.998)
_CHANGE_SHARES = (0.002, 0.02, 0.08, 0.2, 0.35, 0.5, 0.65, 0.8, 0.92, 0.98, 0.998)
_INPUT_SHARES = tuple(float(share) for share in np.linspace(0.0, 1.0, 11))


@dataclass(frozen=True, slots=True, kw_only=True)
class Point:
    """Mean residual of both models in one group of samples."""

    at: float
    baseline: Estimate
    extended: Estimate


@dataclass(frozen=True, slots=True, kw_only=True)
class Curve:
    """A mean residual over one quantity."""

    name: str  # of the quantity
    title: str
    unit: str  # of `at`
    residual_unit: str
    points: tuple[Point, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class Filtered:
    """The estimates of one model along a series."""

    state: FloatArray  # shape (n, STATES), NaN while the ball is not in flight
    unforeseen_i_a: FloatArray  # innovation of i_c, one sample ahead, shape (n,)
    force_n: FloatArray  # residual, shape (n,)
    slope_m_s: FloatArray  # speed of the parabola, shape (n,); its noise is independent of the residual, unlike v's


def filtered(evidence: Evidence, theta: Theta, plant: Plant, tick_s: float) -> Filtered:
    """Run one model along a series; `tick_s`: the sampling interval, s."""
    s = evidence.series
    system = theta.system(plant, tick_s)
    base, c = system.base, system.c
    c[periodic.CAUSE.strength.index] = 0.0  # a periodic force is left in the residual
    out, state, _, _ = run_filter(system, evidence.samples, state=True)
    modelled, positions_m = np.empty(len(s)), np.empty(len(s))
    # Without the causes of the amplifier: the current is known at both ends of an interval, and its errors are the
    # residual current.
    quiet = c.copy()
    for cause in CATALOGUE:
        if cause.family == "amplifier":
            for parameter in cause.parameters:
                quiet[parameter.index] = parameter.neutral
    _fill_positions(base, quiet, state, s.x, positions_m)
    flies = (s.flags & FLIES != 0) & (s.flags & USE_X != 0) & np.isfinite(positions_m)
    _fill_acceleration(base, quiet, state, positions_m, s.step, s.flags, evidence.t, modelled)
    force, slope = np.full(len(s), np.nan), np.full(len(s), np.nan)
    for piece in _recordings(s.recording):
        window = windows(s.step[piece], s.flags[piece], flies[piece])
        if window is not None:
            positions = np.where(flies[piece], positions_m[piece], 0.0)
            slope[piece] = window.slope(positions)
            force[piece] = window.left(positions, modelled[piece])
    known = np.isfinite(out[:, 0]) & (s.flags & USE_I != 0)
    return Filtered(
        state=state,
        unforeseen_i_a=np.where(known, out[:, 0], np.nan),
        force_n=plant.mass_kg * force,
        slope_m_s=slope,
    )


@kernel
def _fill_positions(
    base: Packed,
    c: NDArray[np.float64],
    state: NDArray[np.float64],
    reading: NDArray[np.float64],
    x_m: NDArray[np.float64],
) -> None:
    """Fill `x_m`, shape (n,), with the position that gives each reading in flight, m."""
    p = Base(*base)
    for n in range(len(reading)):
        x_m[n] = np.nan
        if not np.isnan(state[n, V]):
            prompt = reading[n] + sensor_lag_s(c) * state[n, V]
            x_m[n] = position_of_reading(p, c, prompt, state[n, I_C])


@kernel
def _fill_acceleration(
    base: Packed,
    c: NDArray[np.float64],
    state: NDArray[np.float64],
    x: NDArray[np.float64],
    step: NDArray[np.float64],
    flags: NDArray[np.uint16],
    t: NDArray[np.float64],
    modelled: NDArray[np.float64],
) -> None:
    """Fill `modelled`, shape (n,), with the model's mean acceleration around each sample, m/s^2; NaN at gaps.

    The second difference of x at sample k is T dv + p_k+1 - p_k.  There dv is the change of speed from k - 1 to k, and
    p_k the change of x in that interval beyond T x'.
    """
    p = Base(*base)
    y = np.empty(STATES)
    gained, moved = np.nan, np.nan  # changes of speed and position in the previous interval
    for n in range(len(x)):
        modelled[n] = np.nan
        last = n + 1 >= len(x) or flags[n + 1] & FOLLOWS == 0 or np.isnan(state[n + 1, V])
        if np.isnan(x[n]) or last:
            gained = np.nan
            continue
        T_s = step[n + 1]
        for k in range(STATES):
            y[k] = state[n, k]
        y[X] = x[n]
        left = math.exp(-T_s / p.T_A)
        # The input that takes the current to its next value, in place of u_c: no error of the amplifier then acts on
        # the force.
        target = (state[n + 1, I_C] - state[n, I_C] * left) / (1.0 - left)
        advance(base, c, y, target / p.K_A, t[n], T_s, FREE)
        further = y[X] - x[n] - T_s * state[n, V]
        if not np.isnan(gained):
            modelled[n] = (T_s * gained + further - moved) / (T_s * T_s)
        gained, moved = y[V] - state[n, V], further


def _recordings(recording: NDArray[np.int32]) -> list[slice]:
    edges = [0, *(np.flatnonzero(np.diff(recording)) + 1).tolist(), len(recording)]
    return [slice(a, b) for a, b in pairwise(edges) if b > a]


@dataclass(frozen=True, slots=True, kw_only=True)
class Windows:
    """Windows of one recording for the parabolas."""

    half: int  # samples on each side of the middle
    T_s: float
    whole: NDArray[np.bool_]  # whether the window around each sample is in flight without gaps, shape (n,)

    def slope(self, positions_m: FloatArray) -> FloatArray:
        """Return the speed in the middle of each window, m/s, shape (n,)."""
        return self._aligned(np.convolve(positions_m, parabola(self.half, self.T_s)[0][::-1], "valid"))

    def left(self, positions_m: FloatArray, modelled: FloatArray) -> FloatArray:
        """Return measured - modelled acceleration in the middle of each window, m/s^2, shape (n,)."""
        weights = parabola(self.half, self.T_s)[1]
        # The acceleration at each sample contributes to the parabola with the double sum of the weights.
        spread = np.cumsum(np.cumsum(weights))[:-2] * self.T_s * self.T_s
        known = np.isfinite(modelled)
        expected = np.convolve(np.where(known, modelled, 0.0)[1:-1], spread[::-1], "valid")
        all_known = np.convolve(known[1:-1], np.ones(len(spread)), "valid") >= len(spread) - 0.5
        measured = np.convolve(positions_m, weights[::-1], "valid")
        return self._aligned(np.where(all_known, measured - expected, np.nan))

    def _aligned(self, values: FloatArray) -> FloatArray:
        result = np.full(len(self.whole), np.nan)
        result[self.half : self.half + len(values)] = values
        return np.where(self.whole, result, np.nan)


def windows(step: FloatArray, flags: NDArray[np.uint16], flies: NDArray[np.bool_]) -> Windows | None:
    """The windows of one recording; None if it is too short.

    Args:
        step: time since the previous sample, s, shape (n,).
        flags: of `twin/estimation/innovations.py`, shape (n,).
        flies: whether each sample has a position in flight, shape (n,).
    """
    known = step[flies & (step > 0.0)]
    if not len(known):
        return None
    T_s = float(np.median(known))
    half = max(round(0.5 * WINDOW_S / T_s), MIN_READINGS // 2)
    width, n = 2 * half + 1, len(step)
    if n < width:
        return None
    uneven = (np.abs(step - T_s) > 0.05 * T_s) | (flags & FOLLOWS == 0)
    good = np.convolve(flies, np.ones(width), "valid") >= width - 0.5
    good &= np.convolve(uneven[1:], np.ones(width - 1), "valid") < 0.5
    whole = np.zeros(n, np.bool_)
    whole[half : half + len(good)] = good
    return Windows(half=half, T_s=T_s, whole=whole)


def parabola(half: int, T_s: float) -> tuple[FloatArray, FloatArray]:
    """Return weights of the readings for both derivatives (1/s, 1/s^2) of their parabola, shape (2 half + 1,)."""
    k = np.arange(-half, half + 1, dtype=np.float64)
    # A. Savitzky, M. J. E. Golay, Smoothing and differentiation of data by simplified least squares procedures, 1964.
    # The second difference of three readings would have a hundred times the noise.
    rows = np.linalg.pinv(np.vander(k, 3, increasing=True))
    return np.asarray(rows[1] / T_s), np.asarray(2.0 * rows[2] / T_s**2)


def force_curves(models: tuple[Filtered, Filtered], evidence: Evidence, blocks: Blocks) -> list[Curve]:
    """Return the residual force of baseline and extended model as functions of x, x' and i_c."""
    s = evidence.series
    # The speed of the parabola, not of the filter: the noise of the latter is in the residual, too, and would look like
    # a drag.
    x, v, i = s.x, models[1].slope_m_s, s.i
    flown = np.isfinite(models[0].force_n) & np.isfinite(models[1].force_n)
    x, v, i = (np.where(flown, values, np.nan) for values in (x, v, i))
    residuals = [model.force_n for model in models]
    quantities = (
        ("x", "position x", "m", x, even_edges(x, GROUPS)),
        ("v", "speed x'", "m/s", v, quantile_edges(v, _SPEED_SHARES)),
        ("i", "current i_c", "A", i, even_edges(i, GROUPS)),
    )
    return _curves(quantities, residuals, "N", blocks)


def current_curves(models: tuple[Filtered, Filtered], evidence: Evidence, tick_s: float, blocks: Blocks) -> list[Curve]:
    """Return the residual current of both models as functions of u_c and of its change."""
    s = evidence.series
    u = np.concatenate(([np.nan], s.u[:-1]))
    change = np.concatenate(([np.nan, np.nan], np.diff(s.u)[:-1]))
    linked = s.flags & FOLLOWS != 0
    usual = linked & (s.step > 0.5 * tick_s)
    before = np.concatenate(([False], linked[:-1]))
    known = usual & np.isfinite(models[0].unforeseen_i_a) & np.isfinite(models[1].unforeseen_i_a)
    u, change = np.where(known, u, np.nan), np.where(known & before, change, np.nan)
    residuals = [model.unforeseen_i_a for model in models]
    quantities = (
        ("u", "input u_c", "V", u, quantile_edges(u, _INPUT_SHARES)),
        ("du", "change of u_c", "V", change, quantile_edges(change, _CHANGE_SHARES)),
    )
    return _curves(quantities, residuals, "A", blocks)


def _curves(
    quantities: Sequence[tuple[str, str, str, FloatArray, FloatArray]],
    residuals: Sequence[FloatArray],
    residual_unit: str,
    blocks: Blocks,
) -> list[Curve]:
    """Return the mean residuals of both models in each group of a quantity; without the curves of too few groups.

    Args:
        quantities: name, title, unit, values of the samples, edges of the groups.
        residuals: of baseline and extended model.
        residual_unit: of these.
        blocks: of the samples.
    """
    curves = []
    for name, title, unit, values, edges in quantities:
        if len(edges) < 3:
            continue
        labels, groups = bin_labels(values, edges), len(edges) - 1
        where, _, samples, pieces = means(np.where(labels >= 0, values, 0.0), labels, groups, blocks)
        first, second = (means(np.where(labels >= 0, residual, 0.0), labels, groups, blocks) for residual in residuals)
        points = tuple(
            Point(
                at=float(where[k]),
                baseline=estimate(float(first[0][k]), first[1][:, k]),
                extended=estimate(float(second[0][k]), second[1][:, k]),
            )
            for k in np.flatnonzero(solid(samples, pieces))
        )
        if len(points) > 1:
            curves.append(Curve(name=name, title=title, unit=unit, residual_unit=residual_unit, points=points))
    return curves
