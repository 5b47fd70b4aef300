"""The force and the current that a model leaves unexplained, as functions of the state.

Residual force: m (measured acceleration - acceleration of (6)).  A parabola through 30 ms of readings gives the
acceleration; the model's is averaged with the same weights, so that a right model leaves 0 however fast things move.
Residual current: what the filter did not foresee of i_c, one sample ahead.

Rule 1: the model's acceleration is taken at the readings of x and at the filter's current and speed.  The current goes
        to where the next sample has it: what u_c should have done to it does not enter the force.  Taken as it stands
        at the samples it would be half an interval late, which looks like a drag; the filter's x of a wrong model is
        wrong by more than a reading.
Rule 2: sensor effects that the model has are taken out of the readings first.
Rule 3: a periodic force is left in the residual: its phase is nobody's function of the state.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from protocol.campaign import Plant
from twin.compiled import Packed, kernel
from twin.diagnose.evidence.gather import Evidence
from twin.diagnose.inference.theta import Theta
from twin.diagnose.residuals.regimes import Blocks, Estimate, by_edges, estimate, even_edges, means, shared_edges, solid
from twin.diagnose.search import periodic
from twin.estimation.ekf.filter import filtered as along
from twin.estimation.innovations import FLIES, FOLLOWS, USE_I, USE_X
from twin.estimation.record import FloatArray
from twin.model.causes.catalogue import CATALOGUE
from twin.model.extended import I_C, STATES, Base, V, X, advance, position_of_reading, sensor_lag_s

WINDOW_S = 0.03
FEWEST = 7  # readings in a window
GROUPS = 10
# The middle is one group, the ball at rest: there the slope is noise that the loop has answered, and parts of it would
# show a force that is none.
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
    points: tuple[Point, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class Filtered:
    """One model along a series."""

    state: FloatArray  # shape (n, 7), NaN where the ball is not in the air
    unforeseen_i_a: FloatArray  # i_c - predicted, one sample ahead, shape (n,)
    force_n: FloatArray  # residual, shape (n,)
    slope_m_s: FloatArray  # of the parabola: the filter's speed shares its noise with the residual, this one does not


def filtered(evidence: Evidence, theta: Theta, plant: Plant, tick_s: float) -> Filtered:
    """The residuals of one model."""
    s = evidence.series
    system = theta.system(plant, tick_s)
    base, c = system.base, system.c
    c[periodic.CAUSE.strength.place] = 0.0  # the force of what has no clock here is left in the residual
    out, state, _, _ = along(system, evidence.samples, state=True)
    modelled, seen = np.empty(len(s)), np.empty(len(s))
    quiet = c.copy()
    for cause in CATALOGUE:
        if cause.family == "amplifier":
            for parameter in cause.parameters:
                quiet[parameter.place] = parameter.neutral
    _behind(base, quiet, state, s.x, seen)
    flies = (s.flags & FLIES != 0) & (s.flags & USE_X != 0) & np.isfinite(seen)
    _along(base, quiet, state, seen, s.step, s.flags, evidence.t, modelled)
    force, slope = np.full(len(s), np.nan), np.full(len(s), np.nan)
    for piece in _recordings(s.recording):
        window = windows(s.step[piece], s.flags[piece], flies[piece])
        if window is not None:
            positions = np.where(flies[piece], seen[piece], 0.0)
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
def _behind(
    base: Packed,
    c: NDArray[np.float64],
    state: NDArray[np.float64],
    reading: NDArray[np.float64],
    seen: NDArray[np.float64],
) -> None:
    """The position behind each reading of a flying ball, m, shape (n,)."""
    p = Base(*base)
    for n in range(len(reading)):
        seen[n] = np.nan
        if not np.isnan(state[n, V]):
            prompt = reading[n] + sensor_lag_s(c) * state[n, V]
            seen[n] = position_of_reading(p, c, prompt, state[n, I_C])


@kernel
def _along(
    base: Packed,
    c: NDArray[np.float64],
    state: NDArray[np.float64],
    x: NDArray[np.float64],
    step: NDArray[np.float64],
    flags: NDArray[np.uint8],
    t: NDArray[np.float64],
    modelled: NDArray[np.float64],
) -> None:
    """Mean acceleration around each sample by the model, m/s^2, shape (n,), NaN where it has no neighbours.

    The second difference of x at sample k is T v' + p_k+1 - p_k, where v' is what the speed gains from k - 1 to k, and
    p_k what x gains in that interval over x + T x'.
    """
    p = Base(*base)
    y = np.empty(STATES)
    gained, moved = np.nan, np.nan  # speed and position over the interval before
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
        target = (state[n + 1, I_C] - state[n, I_C] * left) / (1.0 - left)
        advance(base, c, y, target / p.K_A, t[n], T_s, False)
        further = y[X] - x[n] - T_s * state[n, V]
        if not np.isnan(gained):
            modelled[n] = (T_s * gained + further - moved) / (T_s * T_s)
        gained, moved = y[V] - state[n, V], further


def _recordings(recording: NDArray[np.int32]) -> list[slice]:
    edges = np.flatnonzero(np.diff(recording)) + 1
    starts, stops = [0, *edges.tolist()], [*edges.tolist(), len(recording)]
    return [slice(a, b) for a, b in zip(starts, stops, strict=True) if b > a]


@dataclass(frozen=True, slots=True, kw_only=True)
class Windows:
    """Unbroken windows of one recording, each with a parabola."""

    half: int
    T_s: float
    whole: NDArray[np.bool_]  # whether the ball flies, sampled evenly, in the window around each sample, shape (n,)

    def slope(self, seen: FloatArray) -> FloatArray:
        """Speed in the middle of each window, m/s, shape (n,)."""
        return self._placed(np.convolve(seen, parabola(self.half, self.T_s)[0][::-1], "valid"))

    def left(self, seen: FloatArray, modelled: FloatArray) -> FloatArray:
        """Measured - modelled acceleration in the middle of each window, m/s^2, shape (n,)."""
        weights = parabola(self.half, self.T_s)[1]
        # x'' of a ball that has a_k at sample k: each a_k enters the parabola with the double sum of the weights.
        spread = np.cumsum(np.cumsum(weights))[:-2] * self.T_s * self.T_s
        known = np.isfinite(modelled)
        expected = np.convolve(np.where(known, modelled, 0.0)[1:-1], spread[::-1], "valid")
        all_known = np.convolve(known[1:-1], np.ones(len(spread)), "valid") >= len(spread) - 0.5
        measured = np.convolve(seen, weights[::-1], "valid")
        return self._placed(np.where(all_known, measured - expected, np.nan))

    def _placed(self, values: FloatArray) -> FloatArray:
        result = np.full(len(self.whole), np.nan)
        result[self.half : self.half + len(values)] = values
        return np.where(self.whole, result, np.nan)


def windows(step: FloatArray, flags: NDArray[np.uint8], flies: NDArray[np.bool_]) -> Windows | None:
    """The windows of one recording; None where it is too short for one."""
    known = step[flies & (step > 0.0)]
    if not len(known):
        return None
    T_s = float(np.median(known))
    half = max(round(0.5 * WINDOW_S / T_s), FEWEST // 2)
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
    """Weights of the readings in first (1/s) and second (1/s^2) derivative of their parabola, shape (2 half + 1,)."""
    k = np.arange(-half, half + 1, dtype=np.float64)
    rows = np.linalg.pinv(np.vander(k, 3, increasing=True))
    return np.asarray(rows[1] / T_s), np.asarray(2.0 * rows[2] / T_s**2)


def force_curves(models: tuple[Filtered, Filtered], evidence: Evidence, blocks: Blocks) -> list[Curve]:
    """Residual force of baseline and extended model over x, x' and i_c."""
    s = evidence.series
    x, v, i = s.x, models[1].slope_m_s, s.i
    flown = np.isfinite(models[0].force_n) & np.isfinite(models[1].force_n)
    inside = [np.where(flown, values, np.nan) for values in (x, v, i)]
    return [
        curve
        for curve in (
            _curve("x", "position x", "m", "N", inside[0], even_edges(inside[0], GROUPS), models, blocks),
            _curve("v", "speed x'", "m/s", "N", inside[1], shared_edges(inside[1], _SPEED_SHARES), models, blocks),
            _curve("i", "current i_c", "A", "N", inside[2], even_edges(inside[2], GROUPS), models, blocks),
        )
        if curve is not None
    ]


def current_curves(models: tuple[Filtered, Filtered], evidence: Evidence, tick_s: float, blocks: Blocks) -> list[Curve]:
    """Unforeseen current of both models over u_c, and over the change of u_c that came with it."""
    s = evidence.series
    u = np.concatenate(([np.nan], s.u[:-1]))
    change = np.concatenate(([np.nan, np.nan], np.diff(s.u)[:-1]))
    linked = s.flags & FOLLOWS != 0
    usual = linked & (s.step > 0.5 * tick_s)
    before = np.concatenate(([False], linked[:-1]))
    known = usual & np.isfinite(models[0].unforeseen_i_a) & np.isfinite(models[1].unforeseen_i_a)
    u, change = np.where(known, u, np.nan), np.where(known & before, change, np.nan)
    return [
        curve
        for curve in (
            _curve("u", "input u_c", "V", "A", u, shared_edges(u, _INPUT_SHARES), models, blocks),
            _curve("du", "change of u_c", "V", "A", change, shared_edges(change, _CHANGE_SHARES), models, blocks),
        )
        if curve is not None
    ]


def _curve(
    name: str,
    title: str,
    unit: str,
    residual_unit: str,
    values: FloatArray,
    edges: FloatArray,
    models: tuple[Filtered, Filtered],
    blocks: Blocks,
) -> Curve | None:
    if len(edges) < 3:
        return None
    labels, groups = by_edges(values, edges), len(edges) - 1
    where, _, samples, pieces = means(np.where(labels >= 0, values, 0.0), labels, groups, blocks)
    sides = []
    for model in models:
        residual = model.force_n if residual_unit == "N" else model.unforeseen_i_a
        mean, drawn, _, _ = means(np.where(labels >= 0, residual, 0.0), labels, groups, blocks)
        sides.append((mean, drawn))
    points = tuple(
        Point(
            at=float(where[k]),
            baseline=estimate(float(sides[0][0][k]), sides[0][1][:, k]),
            extended=estimate(float(sides[1][0][k]), sides[1][1][:, k]),
        )
        for k in np.flatnonzero(solid(samples, pieces))
    )
    if len(points) < 2:
        return None
    return Curve(name=name, title=title, unit=unit, residual_unit=residual_unit, points=points)
