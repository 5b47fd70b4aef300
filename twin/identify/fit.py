"""Maximum likelihood of the innovations over a whole campaign: four parameters of (1), (6) and four noise levels.

Fisher scoring with Levenberg damping.  The derivatives of innovations and their covariance are one-sided differences of
the filter, so the score is that of the likelihood itself, terms through the gains included.

Rule 1: K_A, T_A, K_c and the noise levels move as logarithms; b moves freely through zero, because a record that knows
        nothing of the drag must be able to say so.
        It is held below the unstable pole: beyond, it only stands for something else.
Rule 2: a noise level or T_A at its floor with a score that pushes it further down is left there.
Rule 3: never raises for numbers: an impossible step is refused, no convergence is a value (`converged`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from protocol.campaign import Plant
from twin.estimation.innovations import FOLLOWS, USE_I, USE_X, Series, information, run_filter, whiten
from twin.estimation.optimiser import Damping, covariance_of, inverse, newton
from twin.estimation.prepare import BLOCK_SAMPLES
from twin.estimation.record import FloatArray
from twin.estimation.structures import NoiseLevels
from twin.estimation.transition import GAP_MIN_SHARE, Physics

PARAMETERS = ("K_A", "T_A", "K_c", "b")
NOISES = ("sigma_i_c_a", "sigma_x_m", "process_i_c_a", "process_a_m_s2")
NAMES = PARAMETERS + NOISES
FLOORS = {
    "T_A": 2e-6,  # faster than any coil: below, the likelihood is flat and no climb ends
    "sigma_i_c_a": 1e-7,
    "sigma_x_m": 1e-9,
    "process_i_c_a": 1e-6,
    "process_a_m_s2": 1e-3,
}
_STEP = {"K_A": 1e-5, "T_A": 1e-4, "K_c": 1e-5} | dict.fromkeys(NOISES, 1e-4)
_DRAG_STEP = 1e-2  # 1/s, of b / m
_MOST = {"K_A": 0.7, "T_A": 1.5, "K_c": 0.5} | dict.fromkeys(NOISES, 2.0)  # largest step of a logarithm
_DRAG_MOST = 20.0  # 1/s
DONE = 0.01  # of a standard error (Newton decrement): smaller steps move nothing that matters
NEAR = 0.3  # the same, where a wrong model makes the climb slow: what is left to gain is 0.05 of log-likelihood
GATE = 6.0  # standard deviations: a right model does that once in 5e8 samples
PASSES = 40
_NO_STATE = np.empty((0, 3))


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
        """The noise levels, as the filter takes them; `tick_s`: that they refer to, s."""
        return NoiseLevels(self.sigma_i_c_a, self.sigma_x_m, self.process_i_c_a, self.process_a_m_s2, tick_s)

    def moved(self, name: str, by: float, mass_kg: float) -> Point:
        """One coordinate moved: by a logarithm, b by `by` times m (so that its unit is 1/s)."""
        if name == "b":
            return replace(self, b=self.b + by * mass_kg)
        value = float(getattr(self, name)) * math.exp(by)
        return replace(self, **{name: max(value, FLOORS.get(name, 0.0))})


@dataclass(frozen=True, slots=True, kw_only=True)
class Fit:
    """A maximum and what is known about it."""

    point: Point
    loglik: float
    free: tuple[str, ...]  # coordinates of `covariance`
    covariance: FloatArray  # of the coordinates (logarithms, b / m), inverse Fisher information
    converged: bool
    passes: int
    decrement: float
    robust: FloatArray | None = None  # sandwich covariance

    def std(self, name: str, mass_kg: float, *, robust: bool = False) -> float:
        """Standard error in the unit of the parameter; inf where it was not free."""
        if name not in self.free:
            return float("inf")
        matrix = self.robust if robust and self.robust is not None else self.covariance
        place = self.free.index(name)
        spread = float(np.sqrt(max(matrix[place, place], 0.0)))
        return spread * (mass_kg if name == "b" else getattr(self.point, name))


class Likelihood:
    """The criterion over one series.

    Args:
        series: of `prepare`.
        plant: mass, x_max, gravity.
        tick_s: the interval that process noise refers to.
    """

    def __init__(self, series: Series, plant: Plant, tick_s: float) -> None:
        self.plant = plant
        self.tick_s = tick_s
        self.series = series
        starts = np.flatnonzero((series.flags & FOLLOWS) == 0)
        self._blocks = _blocks(starts, len(series))
        self.evaluations = 0
        self.drag_most = most_drag(plant)

    def value(self, point: Point) -> float:
        """The log-likelihood."""
        total = 0.0
        for block in self._blocks:
            out = self._filter(point, block)
            total += whiten(out, np.empty(len(out)), np.empty((len(out), 2)))
        return total

    def white(self, point: Point) -> FloatArray:
        """Whitened innovations, shape (n, 2), NaN where unused."""
        white = np.full((len(self.series), 2), np.nan)
        for block in self._blocks:
            out = self._filter(point, block)
            whiten(out, np.empty(len(out)), white[block])
        return white

    def gradient(
        self, point: Point, free: Sequence[str], *, lags: int = 0
    ) -> tuple[float, FloatArray, FloatArray, FloatArray]:
        """(log-likelihood, score, Fisher information, Newey-West sum of scores) in the free coordinates.

        The sum is taken within blocks of `BLOCK_SAMPLES`: the scores of an hour would not fit beside its data.
        """
        count = len(free)
        fisher, spread = np.zeros((count, count)), np.zeros((count, count))
        score = np.zeros(count)
        total = 0.0
        for block in self._blocks:
            base = self._filter(point, block)
            n = len(base)
            total += whiten(base, np.empty(n), np.empty((n, 2)))
            moved = np.empty((count, n, 5))
            for place, name in enumerate(free):
                by = _DRAG_STEP if name == "b" else _STEP[name]
                np.subtract(self._filter(point.moved(name, by, self.plant.mass_kg), block), base, out=moved[place])
                moved[place] /= by
            each = np.empty((n, count))
            information(base, moved, each, fisher)
            score += each.sum(axis=0)
            if lags:
                spread += _newey_west(each, lags)
        return total, score, fisher, spread

    def states(self, point: Point) -> FloatArray:
        """Corrected estimates (i_c, x, x') at each sample, shape (n, 3), NaN where the ball does not fly."""
        state = np.empty((len(self.series), 3))
        for block in self._blocks:
            self._filter(point, block, state[block])
        return state

    def _filter(self, point: Point, block: slice, state: FloatArray = _NO_STATE) -> FloatArray:
        part = self.series.part(block)
        out = np.empty((len(part), 5))
        run_filter(
            tuple(physics(point, self.plant)),
            point.noise(self.tick_s),
            part.step,
            part.u,
            part.i,
            part.x,
            part.flags,
            out,
            state,
        )
        self.evaluations += 1
        return out


def most_drag(plant: Plant) -> float:
    """B / m that equals the unstable pole sqrt(2 g / gap) in the middle of the travel, 1/s: no ball in air has it."""
    return math.sqrt(2.0 * plant.gravity_m_s2 / (plant.x_max_m - 0.5 * plant.travel_m))


def physics(point: Point, plant: Plant) -> Physics:
    """The numbers of the kernel."""
    return Physics(
        K_A=point.K_A,
        T_A=point.T_A,
        k=point.K_c / plant.mass_kg,
        d=point.b / plant.mass_kg,
        gravity_m_s2=plant.gravity_m_s2,
        x_max_m=plant.x_max_m,
        gap_min_m=GAP_MIN_SHARE * plant.travel_m,
        travel_m=plant.travel_m,
    )


def fit(likelihood: Likelihood, start: Point, free: Sequence[str], *, passes: int = PASSES) -> Fit:
    """Climb to the maximum from `start`; coordinates not in `free` stay."""
    mass = likelihood.plant.mass_kg
    point, damping, decrement, converged = start, Damping(), np.inf, False
    used = slow = 0
    loglik, score, fisher, _ = likelihood.gradient(point, free)
    for _ in range(passes):
        used += 1
        active = _active(point, free, score, likelihood.drag_most * mass)
        step, decrement = newton(score, fisher, active, damping.value)
        if decrement < DONE or (slow >= 3 and decrement < NEAR):
            converged = True
            break
        trial = _move(point, free, step, mass)
        trial = replace(trial, b=min(trial.b, likelihood.drag_most * mass))
        value = likelihood.value(trial)
        if np.isfinite(value) and value > loglik - 1e-9 * abs(loglik):
            slow = slow + 1 if value - loglik < 0.05 else 0
            damping.taken()
            point = trial
            loglik, score, fisher, _ = likelihood.gradient(point, free)
        elif not damping.refused():
            break
    converged = converged or decrement < NEAR
    active = _active(point, free, score, likelihood.drag_most * mass)
    return Fit(
        point=point,
        loglik=loglik,
        free=tuple(free),
        covariance=covariance_of(fisher, active),  # at its floor a number is known to be as good as zero
        converged=converged,
        passes=used,
        decrement=float(decrement),
    )


def sandwich(likelihood: Likelihood, found: Fit, lags: int) -> Fit:
    """The fit with the covariance that holds for coloured residuals too: F^-1 (Newey-West sum of scores) F^-1."""
    _, _, fisher, middle = likelihood.gradient(found.point, found.free, lags=lags)
    active = np.diag(found.covariance) > 0.0
    inner = inverse(fisher[np.ix_(active, active)])
    robust = np.zeros_like(found.covariance)
    robust[np.ix_(active, active)] = inner @ middle[np.ix_(active, active)] @ inner
    return replace(found, robust=robust)


def _newey_west(scores: FloatArray, lags: int) -> FloatArray:
    total = scores.T @ scores
    for lag in range(1, min(lags, len(scores) - 1) + 1):
        cross = scores[lag:].T @ scores[:-lag]
        total += (1.0 - lag / (lags + 1.0)) * (cross + cross.T)
    return np.asarray(total)


def gate(series: Series, white: FloatArray, recording_count: int) -> tuple[Series, FloatArray]:
    """(the series without the readings that are beyond GATE, how many in each recording).

    A reading is dropped only where its neighbours are plausible: a stretch of large innovations is a wrong model or an
    undetected contact, and dropping it would hide that.
    """
    flags = series.flags.copy()
    dropped = np.zeros(recording_count)
    for column, bit in ((0, USE_I), (1, USE_X)):
        values = np.abs(white[:, column])
        known = values[np.isfinite(values)]
        if known.size < 50:
            continue
        scale = max(float(np.median(known)) / 0.6745, 1e-12)
        del known
        wild = np.isfinite(values) & (values > GATE * max(scale, 1.0))
        crowd = np.convolve(wild.astype(np.int8), np.ones(11, np.int8), mode="same") > 4
        wild &= ~crowd
        flags[wild] &= np.uint8(~bit & 0xFF)
        np.add.at(dropped, series.recording[wild], 1)
    return replace(series, flags=flags), dropped


def _blocks(starts: np.ndarray[tuple[int, ...], np.dtype[np.intp]], n: int) -> list[slice]:
    edges = [0]
    for start in starts:
        if start - edges[-1] >= BLOCK_SAMPLES:
            edges.append(int(start))
    return [slice(a, b) for a, b in zip(edges, [*edges[1:], n], strict=True) if b > a]


def _active(
    point: Point, free: Sequence[str], score: FloatArray, b_most: float
) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
    """Which coordinates may move: not a noise at its floor that wants less, nor a drag at its bound that wants more."""
    stuck = [
        (name in FLOORS and getattr(point, name) <= FLOORS[name] * 1.001 and score[place] <= 0.0)
        or (name == "b" and point.b >= b_most and score[place] >= 0.0)
        for place, name in enumerate(free)
    ]
    return ~np.array(stuck, np.bool_)


def _move(point: Point, free: Sequence[str], step: FloatArray, mass_kg: float) -> Point:
    # One factor for all: a step cut coordinate by coordinate points elsewhere.
    most = [_DRAG_MOST if name == "b" else _MOST[name] for name in free]
    parameters = [place for place, name in enumerate(free) if name in PARAMETERS]
    factor = min([1.0, *(most[place] / max(abs(step[place]), 1e-300) for place in parameters)])
    for place, name in enumerate(free):
        by = float(np.clip(step[place] * factor, -most[place], most[place]))
        point = point.moved(name, by, mass_kg)
    return point
