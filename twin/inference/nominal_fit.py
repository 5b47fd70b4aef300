"""Maximum likelihood of the innovations over a campaign: four parameters of (1), (6) and four noise levels.

The method is Fisher scoring with Levenberg damping.  Innovations and their covariances are differentiated by one-sided
differences of the filter, so the score includes the effect of the parameters on the Kalman gains.

Rule 1: K_A, T_A, K_c and the noise levels are estimated as logarithms.  b may become negative, so that its interval is
        right when the data do not show the drag.  b / m is kept below the unstable pole: a larger value would imitate
        another effect.
Rule 2: a noise level or T_A stays at its floor if the score points below it.
Rule 3: numerical problems do not raise: an impossible step is rejected, and `converged` reports convergence.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from protocol.campaign import Plant
from twin.estimation.ekf.filter import filtered
from twin.estimation.innovations import FOLLOWS, USE_I, USE_X, Series, information, whiten
from twin.estimation.optimiser import Slopes, climb, inverse
from twin.estimation.prepare import BLOCK_SAMPLES
from twin.estimation.record import FloatArray
from twin.estimation.structures import AT_THE_ENDS, NO_STEPS, NOISES, NoiseLevels, Results, Steps, System
from twin.model.causes.catalogue import neutral
from twin.model.extended import STATES, Base

PARAMETERS = ("K_A", "T_A", "K_c", "b")
NAMES = PARAMETERS + NOISES
FLOORS = {
    "T_A": 2e-6,  # faster than any coil; below, the likelihood is flat and the iteration would not converge
    "sigma_i_c_a": 1e-7,
    "sigma_x_m": 1e-9,
    "process_i_c_a": 1e-6,
    "process_a_m_s2": 1e-3,
}
_STEP = {"K_A": 1e-5, "T_A": 1e-4, "K_c": 1e-5} | dict.fromkeys(NOISES, 1e-4)
_DRAG_STEP = 1e-2  # 1/s, of b / m
_MAX_STEP = {"K_A": 0.7, "T_A": 1.5, "K_c": 0.5} | dict.fromkeys(NOISES, 2.0)  # largest step of a logarithm
_MAX_DRAG_STEP = 20.0  # largest step of b / m, 1/s
TOLERANCE = 0.01  # Newton decrement of convergence, standard errors
GATE = 6.0  # standard deviations of an outlier; a right model exceeds it once in 5e8 samples
PASSES = 40


@dataclass(frozen=True, slots=True, kw_only=True)
class Point:
    """Parameters and noise levels in SI units."""

    K_A: float
    T_A: float
    K_c: float
    b: float
    sigma_i_c_a: float
    sigma_x_m: float
    process_i_c_a: float
    process_a_m_s2: float

    def noise(self, tick_s: float) -> NoiseLevels:
        """The noise levels in the form of the filter; `tick_s`: interval of the process noise, s."""
        return NoiseLevels(self.sigma_i_c_a, self.sigma_x_m, self.process_i_c_a, self.process_a_m_s2, tick_s)

    def system(self, plant: Plant, tick_s: float) -> System:
        """The model and its noise in the form of the filter; `tick_s`: interval of the process noise, s."""
        base = Base(
            self.K_A, self.T_A, self.K_c, self.b, plant.mass_kg, plant.gravity_m_s2, plant.x_max_m, plant.travel_m
        )
        return System(tuple(base), neutral(), self.noise(tick_s), AT_THE_ENDS, closed_form=True)

    def moved(self, name: str, step: float, mass_kg: float) -> Point:
        """The point with one coordinate moved by `step`: a logarithm, or for b the quotient b / m in 1/s."""
        # b is linear: as a logarithm it could not become negative, and an interval that reaches 0 would be wrong.
        if name == "b":
            return replace(self, b=self.b + step * mass_kg)
        value = float(getattr(self, name)) * math.exp(step)
        return replace(self, **{name: max(value, FLOORS.get(name, 0.0))})


@dataclass(frozen=True, slots=True, kw_only=True)
class Fit:
    """A maximum with its covariance and convergence."""

    point: Point
    loglik: float
    free: tuple[str, ...]  # coordinates of `covariance`
    covariance: FloatArray  # of the coordinates (logarithms, b / m), inverse Fisher information
    converged: bool
    passes: int
    decrement: float
    robust: FloatArray | None = None  # sandwich covariance

    def std(self, name: str, mass_kg: float, *, robust: bool = False) -> float:
        """Return the standard error in the unit of the parameter; inf if it was not free; `robust`: of the sandwich."""
        if name not in self.free:
            return float("inf")
        matrix = self.robust if robust and self.robust is not None else self.covariance
        index = self.free.index(name)
        spread = float(np.sqrt(max(matrix[index, index], 0.0)))
        return spread * (mass_kg if name == "b" else getattr(self.point, name))


class Likelihood:
    """The likelihood of one series.

    Args:
        series: of `prepare`.
        plant: mass, x_max, gravity.
        tick_s: interval of the process noise, s.
    """

    def __init__(self, series: Series, plant: Plant, tick_s: float) -> None:
        self.plant = plant
        self.tick_s = tick_s
        self.series = series
        starts = np.flatnonzero((series.flags & FOLLOWS) == 0)
        self._blocks = _blocks(starts, len(series))
        self.evaluations = 0
        self.max_drag = max_drag(plant)

    def value(self, point: Point) -> float:
        """The log-likelihood."""
        total = 0.0
        for block in self._blocks:
            out = self._filter(point, block)
            total += whiten(out, np.empty(len(out)), np.empty((len(out), 2)))
        return total

    def white(self, point: Point) -> FloatArray:
        """Return the whitened innovations, shape (n, 2), NaN where unused."""
        white = np.full((len(self.series), 2), np.nan)
        for block in self._blocks:
            out = self._filter(point, block)
            whiten(out, np.empty(len(out)), white[block])
        return white

    def gradient(
        self, point: Point, free: Sequence[str], *, lags: int = 0
    ) -> tuple[float, FloatArray, FloatArray, FloatArray]:
        """Return the log-likelihood and its derivatives by the free coordinates.

        Args:
            point: the point.
            free: names of the coordinates.
            lags: of the Newey-West sum, samples; 0: no sum.

        Returns:
            Log-likelihood, score of shape (count,), Fisher information and Newey-West sum of scores, both of shape
            (count, count).  The sum is taken within blocks of `BLOCK_SAMPLES` to save memory.
        """
        count = len(free)
        fisher, spread = np.zeros((count, count)), np.zeros((count, count))
        score = np.zeros(count)
        total = 0.0
        for block in self._blocks:
            base_run = self._run(point, block, steps=True)
            base, n = base_run.innovations, len(base_run.innovations)
            total += whiten(base, np.empty(n), np.empty((n, 2)))
            moved = np.empty((count, n, 5))
            for index, name in enumerate(free):
                step = _DRAG_STEP if name == "b" else _STEP[name]
                # A model that differs only in its noise has the same steps.
                known = base_run.steps if name in NOISES else NO_STEPS
                shifted_run = self._run(point.moved(name, step, self.plant.mass_kg), block, known)
                np.subtract(shifted_run.innovations, base, out=moved[index])
                moved[index] /= step
            each = np.empty((n, count))
            information(base, moved, each, fisher)
            score += each.sum(axis=0)
            if lags:
                spread += _newey_west(each, lags)
        return total, score, fisher, spread

    def moved(self, point: Point, name: str, step: float) -> Point:
        """The point with one coordinate moved, within its bounds."""
        shifted = point.moved(name, step, self.plant.mass_kg)
        return replace(shifted, b=min(shifted.b, self.max_drag * self.plant.mass_kg))

    def max_step(self, name: str) -> float:
        """The largest move of a coordinate in one pass."""
        return _MAX_DRAG_STEP if name == "b" else _MAX_STEP[name]

    def visit(self, point: Point) -> tuple[float, None]:
        """Return (log-likelihood, None): nothing is stored for the derivatives, to save memory."""
        return self.value(point), None

    def slopes(
        self, point: Point, outputs: None, free: Sequence[str], before: Slopes | None, decrement: float
    ) -> Slopes:
        """Return the exact derivatives; see `exact`."""
        return self.exact(point, outputs, free)

    def exact(self, point: Point, outputs: None, free: Sequence[str]) -> Slopes:
        """Return the score and Fisher information at this point."""
        _, score, fisher, _ = self.gradient(point, free)
        return Slopes(score=score, fisher=fisher)

    def states(self, point: Point) -> FloatArray:
        """Return the corrected states at each sample, shape (n, STATES); NaN while the ball is not in flight."""
        parts = [self._run(point, block, state=True).state for block in self._blocks]
        return np.concatenate(parts) if parts else np.empty((0, STATES))

    def _filter(self, point: Point, block: slice) -> FloatArray:
        return self._run(point, block).innovations

    def _run(
        self, point: Point, block: slice, known: Steps = NO_STEPS, *, state: bool = False, steps: bool = False
    ) -> Results:
        self.evaluations += 1
        system, samples = point.system(self.plant, self.tick_s), self.series.part(block).samples
        return filtered(system, samples, known, state=state, steps=steps)


def max_drag(plant: Plant) -> float:
    """Return the largest b / m, 1/s: the unstable pole sqrt(2 g / gap) at mid-travel, far above the drag in air."""
    return math.sqrt(2.0 * plant.gravity_m_s2 / (plant.x_max_m - 0.5 * plant.travel_m))


def fit(likelihood: Likelihood, start: Point, free: Sequence[str], *, passes: int = PASSES) -> Fit:
    """Maximise the likelihood from `start` over the coordinates `free`, with at most `passes` passes."""
    top = climb(likelihood, start, free, passes=passes, tolerance=TOLERANCE, patience=3)
    return Fit(
        point=top.point,
        loglik=top.loglik,
        free=tuple(free),
        covariance=top.covariance,  # 0 for a coordinate at its floor
        converged=top.converged,
        passes=top.passes,
        decrement=top.decrement,
    )


def sandwich(likelihood: Likelihood, fitted: Fit, lags: int) -> Fit:
    """The fit with the sandwich covariance, which holds for coloured residuals: F^-1 (Newey-West sum of scores) F^-1.

    Source: Newey and West, Econometrica 55(3), 1987.
    """
    _, _, fisher, middle = likelihood.gradient(fitted.point, fitted.free, lags=lags)
    active = np.diag(fitted.covariance) > 0.0
    inner = inverse(fisher[np.ix_(active, active)])
    robust = np.zeros_like(fitted.covariance)
    robust[np.ix_(active, active)] = inner @ middle[np.ix_(active, active)] @ inner
    return replace(fitted, robust=robust)


def _newey_west(scores: FloatArray, lags: int) -> FloatArray:
    total = scores.T @ scores
    # The weights fall with the lag. With equal weights the sum need not be positive semidefinite, and a variance could
    # be negative.
    for lag in range(1, min(lags, len(scores) - 1) + 1):
        cross = scores[lag:].T @ scores[:-lag]
        total += (1.0 - lag / (lags + 1.0)) * (cross + cross.T)
    return np.asarray(total)


def gate(series: Series, white: FloatArray, recording_count: int) -> tuple[Series, FloatArray]:
    """Return (the series without outliers, their number in each recording, shape (recording_count,)).

    An outlier is a whitened innovation beyond GATE whose neighbours are plausible.  A stretch of large innovations is
    retained, as it shows a wrong model or an undetected contact.

    Args:
        series: the samples.
        white: whitened innovations, shape (n, 2).
        recording_count: number of recordings.
    """
    flags = series.flags.copy()
    dropped = np.zeros(recording_count)
    for column, bit in ((0, USE_I), (1, USE_X)):
        values = np.abs(white[:, column])
        known = values[np.isfinite(values)]
        if known.size < 50:
            continue
        # The median, not the standard deviation, gives the scale: outliers would widen the limit that is to catch them.
        scale = max(float(np.median(known)) / 0.6745, 1e-12)
        del known
        wild = np.isfinite(values) & (values > GATE * max(scale, 1.0))
        crowd = np.convolve(wild.astype(np.int8), np.ones(11, np.int8), mode="same") > 4
        wild &= ~crowd
        flags[wild] &= np.uint16(~bit & 0xFFFF)
        np.add.at(dropped, series.recording[wild], 1)
    return replace(series, flags=flags), dropped


def _blocks(starts: np.ndarray[tuple[int, ...], np.dtype[np.intp]], n: int) -> list[slice]:
    edges = [0]
    for start in starts:
        # Only at the start of a chain: a cut elsewhere would make the filter forget its state.
        if start - edges[-1] >= BLOCK_SAMPLES:
            edges.append(int(start))
    return [slice(a, b) for a, b in zip(edges, [*edges[1:], n], strict=True) if b > a]
