"""Log-likelihood of the innovations of the extended model: one parameter set for the whole campaign.

Rule 1: sums over samples do not depend on the number of workers: each worker computes whole derivatives.
Rule 2: what is no series speaks too: priors of the stops, lift-off points, equilibria.
Rule 3: a run is paid from the budget before it begins, by who asks for it.
"""

from __future__ import annotations

import itertools
import math
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from protocol.campaign import Plant
from twin.diagnose.evidence.dead_time import dead_time
from twin.diagnose.evidence.gather import Evidence
from twin.diagnose.inference.budget import Budget, Spent
from twin.diagnose.inference.theta import NOISES, STOP_UNIT_M, STOPS, Theta, derivative_step, moved
from twin.estimation.ekf import (
    ALONE,
    ALONG,
    NOISE_ALONG,
    OUT_COLUMNS,
    RECORDS,
    RESTS_HIGH,
    RESTS_LOW,
    run_along,
    states_in,
)
from twin.estimation.innovations import FLIES, information, whiten
from twin.estimation.pace import pace_of
from twin.estimation.record import FloatArray
from twin.identify.starting.liftoff import LiftOff
from twin.model.causes.catalogue import with_trait
from twin.model.extended import STATES, magnetic_force, position_reading

T = TypeVar("T")
R = TypeVar("R")
STOP_STD_M = 2e-5  # how well anybody knows where a stop is
_NO_STATE = np.empty((0, STATES))
_NO_SPREAD = np.empty((0, 3, 3))


@dataclass(frozen=True, slots=True, kw_only=True)
class Run:
    """The filter of one model along the evidence, and what a run of a model nearby takes over."""

    out: FloatArray  # shape (n, 5)
    slopes: FloatArray  # of each step, shape (n, m, m)
    before: FloatArray  # the correction: states, shape (n, 6)
    after: FloatArray


_NO_RUN = Run(out=np.empty((0, OUT_COLUMNS)), slopes=np.empty((0, 3, 3)), before=_NO_STATE, after=_NO_STATE)


class Criterion:
    """The likelihood of one evidence.

    Args:
        evidence: of `gather`.
        plant: mass, travel, x_max, gravity.
        tick_s: the interval that process noise refers to.
        workers: threads; the kernels run outside the interpreter's lock.
        budget: what the runs of the filter are paid from; without one they are free.
    """

    def __init__(
        self, evidence: Evidence, plant: Plant, tick_s: float, *, workers: int = 2, budget: Budget | None = None
    ) -> None:
        self.evidence, self.plant, self.tick_s = evidence, plant, tick_s
        self.shift_s: FloatArray = np.zeros(len(evidence.series))  # phases of a periodic cause, `search/periodic.py`
        # Recordings do not touch: where one begins in the middle, two workers share a run.
        begins = np.flatnonzero(np.diff(evidence.series.recording, prepend=-1))
        n = len(evidence.series)
        middle = int(begins[np.argmin(np.abs(begins - n // 2))]) if len(begins) else 0
        self._halves = [piece for piece in (slice(0, middle), slice(middle, n)) if piece.stop > piece.start]
        self._pool = ThreadPoolExecutor(max_workers=workers)
        self._climbers = ThreadPoolExecutor(max_workers=workers) if workers > 1 else None
        self.whole = budget or Budget()
        self._own = threading.local()
        self.pace = pace_of(evidence.series)
        self.evaluations = 0

    @property
    def budget(self) -> Budget:
        """What this thread pays from: inside `each` a share."""
        return getattr(self._own, "budget", self.whole)

    @contextmanager
    def free(self) -> Iterator[None]:
        """Runs here cost nothing: a fixed number of passes, whatever the recordings hold."""
        before, self.whole = self.whole, Budget()
        try:
            yield
        finally:
            self.whole = before

    def pay(self, *thetas: Theta, modes: Sequence[int] = ()) -> None:
        """For a run of each; `modes` as `beside` takes them.

        Raises:
            Spent: they are not affordable.
        """
        each = zip(thetas, modes or [ALONE] * len(thetas), strict=True)
        self.budget.take(sum(self.pace.steps(theta.vector(), mode) for theta, mode in each))

    def close(self) -> None:
        """End the workers."""
        if self._climbers is not None:
            self._climbers.shutdown()  # first: a climb asks the others
        self._pool.shutdown()

    def each(self, work: Callable[[T], R], items: Sequence[T]) -> list[R]:
        """`work` on each, several at once: such as a climb, which leaves a core idle between its derivatives.

        `work` may ask this criterion, but not for `each`.

        Raises:
            Spent: the share of one of them was too small.
        """
        shares = self.budget.shares(len(items))

        def paid(item: T, share: Budget) -> R | Spent:
            self._own.budget = share
            try:
                return work(item)
            except Spent as spent:
                return spent  # the others end all the same: what is spent must not depend on who is first
            finally:
                del self._own.budget

        results = list((map if self._climbers is None else self._climbers.map)(paid, items, shares))
        self.budget.settle(shares)
        done = [result for result in results if not isinstance(result, Spent)]
        if len(done) < len(results):
            raise Spent
        return done

    @cached_property
    def late(self) -> tuple[float, float] | None:
        """`dead_time` of the recordings, which no model changes."""
        return dead_time(self.evidence.records)

    def outputs(
        self, theta: Theta, state: NDArray[np.float64] = _NO_STATE, shift_s: FloatArray | None = None
    ) -> FloatArray:
        """Innovations and their covariance, shape (n, 5); `shift_s` as `self.shift_s`, for once."""
        self.pay(theta)
        return self._outputs(theta, state, shift_s)

    def _outputs(self, theta: Theta, state: FloatArray = _NO_STATE, shift_s: FloatArray | None = None) -> FloatArray:
        """Paid for."""
        out = np.empty((len(self.evidence.series), OUT_COLUMNS))
        self._fill(theta, slice(0, len(out)), out, state, shift_s)
        self.evaluations += 1
        return out

    def _fill(
        self,
        theta: Theta,
        part: slice,
        out: FloatArray,
        state: FloatArray = _NO_STATE,
        shift_s: FloatArray | None = None,
        mode: int = ALONE,
        at: Run = _NO_RUN,
    ) -> None:
        """`outputs` of whole recordings, into their place; `mode`, `at`: as `run_along` takes them."""
        s, t = self.evidence.series, self.evidence.t + (self.shift_s if shift_s is None else shift_s)
        noise = (theta.sigma_i_c_a, theta.sigma_x_m, theta.process_i_c_a, theta.process_a_m_s2, self.tick_s)
        run_along(
            tuple(theta.base(self.plant)),
            theta.vector(),
            noise,
            (theta.stop_low_m, theta.stop_high_m),
            t[part],
            s.step[part],
            s.u[part],
            s.i[part],
            s.x[part],
            s.flags[part],
            out[part],
            state[part],
            mode,
            at.slopes[part],
            at.before[part],
            at.after[part],
            _NO_SPREAD,
        )

    def run(self, theta: Theta) -> Run:
        """`outputs` with what `derivatives` take over from it."""
        self.pay(theta)
        n, m = len(self.evidence.series), states_in(theta.vector())
        done = Run(
            out=np.empty((n, OUT_COLUMNS)),
            slopes=np.empty((n, m, m)),
            before=np.empty((n, STATES)),
            after=np.empty((n, STATES)),
        )
        list(self._pool.map(lambda part: self._fill(theta, part, done.out, mode=RECORDS, at=done), self._halves))
        self.evaluations += 1
        return done

    def beside(self, thetas: Sequence[Theta], at: Run, modes: Sequence[int]) -> list[FloatArray]:
        """`outputs` of models near that of `at`, with what was found there.

        Args:
            thetas: the models.
            at: the run.
            modes: ALONE for a whole filter, ALONG with the slopes of the steps, NOISE_ALONG with the steps, too.
        """
        states = at.slopes.shape[1]
        modes = [
            mode if states_in(theta.vector()) == states else ALONE for theta, mode in zip(thetas, modes, strict=True)
        ]
        self.pay(*thetas, modes=modes)
        return list(self._pool.map(self._beside, thetas, modes, itertools.repeat(at)))

    def _beside(self, theta: Theta, mode: int, at: Run) -> FloatArray:
        if mode == ALONE:
            return self._outputs(theta)
        out = np.empty_like(at.out)
        self._fill(theta, slice(0, len(out)), out, mode=mode, at=at)
        self.evaluations += 1
        return out

    def several(self, thetas: Sequence[Theta]) -> list[FloatArray]:
        """`outputs` of each."""
        self.pay(*thetas)
        return list(self._pool.map(self._outputs, thetas))

    def value(self, theta: Theta) -> float:
        """Log-likelihood with the priors; -inf for impossible parameters."""
        self.pay(theta)
        return self._value(theta)

    def _value(self, theta: Theta) -> float:
        return self.loglik(self._outputs(theta)) + self.outside(theta)

    @staticmethod
    def loglik(out: FloatArray) -> float:
        """Of innovations."""
        return float(whiten(out, np.empty(len(out)), np.empty((len(out), 2))))

    @staticmethod
    def loudness(out: FloatArray) -> float:
        """Mean square of the whitened innovations: 1 where they are as large as the filter says, inf without any."""
        white = np.full((len(out), 2), np.nan)  # of impossible parameters not all is filled in
        whiten(out, np.empty(len(out)), white)
        known = white[np.isfinite(white)]
        return float(np.mean(known**2)) if len(known) else math.inf

    def values(self, thetas: Sequence[Theta]) -> list[float]:
        """`value` of each, -inf for those that are not finite."""
        self.pay(*thetas)
        return [value if math.isfinite(value) else -math.inf for value in self._pool.map(self._value, thetas)]

    def white(self, theta: Theta, shift_s: FloatArray | None = None) -> tuple[FloatArray, FloatArray]:
        """(log-likelihood of each sample, shape (n,); whitened innovations, shape (n, 2)); `shift_s`: `outputs`."""
        out = self.outputs(theta, shift_s=shift_s)
        loglik, white = np.zeros(len(out)), np.full((len(out), 2), np.nan)
        whiten(out, loglik, white)
        return loglik, white

    def outside(self, theta: Theta) -> float:
        """What is not in the series: priors of the stops, lift-off points, equilibria."""
        residuals = self._residuals(theta)
        return -0.5 * float(residuals @ residuals)

    def outside_slopes(
        self, theta: Theta, beside: Sequence[Theta], steps: Sequence[float]
    ) -> tuple[FloatArray, FloatArray]:
        """(score, Fisher information) of `outside`, from models beside `theta`, each by its step."""
        here = self._residuals(theta)
        change = np.array([(self._residuals(other) - here) / by for other, by in zip(beside, steps, strict=True)])
        return -change @ here, change @ change.T

    def _residuals(self, theta: Theta) -> FloatArray:
        """Of the stops, then of the static points, in standard errors."""
        stops = [theta.stop_low_m / STOP_STD_M, theta.stop_high_m / STOP_STD_M]
        return np.array(stops + [self._static(theta, point) for point in self.evidence.statics])

    def _static(self, theta: Theta, point: LiftOff) -> float:
        p, c = theta.base(self.plant), theta.vector()
        x = self.plant.x_max_m - point.gap_m
        sigma = max(0.5 * point.relative_error, 0.003)
        force = magnetic_force(p, c, point.i_c_a, x)
        weight = self.plant.mass_kg * self.plant.gravity_m_s2
        return 0.5 * math.log(max(force, 1e-12) / weight) / sigma

    def derivatives(
        self, theta: Theta, names: Sequence[str], at: Run | None = None, *, rough: bool = False
    ) -> tuple[FloatArray, FloatArray]:
        """(outputs, shape (n, 5); their derivatives by the coordinates, shape (count, n, 5)).

        Args:
            theta: the model.
            names: of the coordinates.
            at: a run of `theta`: for models beside it that differ in their noise the steps are taken from there.
            rough: for the others the slopes of the steps, too.  Half the work and less; where the innovations are about
                as large as the filter says it is good enough for where to go, not for where the maximum is.
        """
        steps = {name: derivative_step(theta, name, self.plant) for name in names if name not in STOPS}
        beside = [moved(theta, name, by, self.plant) for name, by in steps.items()]
        if at is None:
            base, *outs = self.several([theta, *beside])
        else:
            # With dry friction the slopes are taken as wide as the state is uncertain: a matter of the noise as well.
            smooth = not any(name.partition(".")[0] in with_trait("sticks") and value for name, value in theta.causes)
            near = [rough or (smooth and name in NOISES) for name in steps]
            modes = [NOISE_ALONG if name in NOISES else ALONG for name in steps]
            modes = [mode if ask else ALONE for mode, ask in zip(modes, near, strict=True)]
            base, outs = at.out, self.beside(beside, at, modes)
        change = np.empty((len(names), *base.shape))
        filtered = iter(outs)
        for place, name in enumerate(names):
            if name in STOPS:
                self._by_stop(theta, name, base, change[place])
            else:
                np.subtract(next(filtered), base, out=change[place])
                change[place] /= steps[name]
        return base, change

    def _by_stop(self, theta: Theta, name: str, base: FloatArray, change: FloatArray) -> None:
        """The derivative by the place of a stop: nothing but the readings of a ball that rests there."""
        flags, reading = self.evidence.series.flags, self.plant.travel_m if name == "stop_high_m" else 0.0
        low = flags & RESTS_LOW != 0
        there = low if name == "stop_low_m" else (flags & RESTS_HIGH != 0) & ~low
        p, c, stop = theta.base(self.plant), theta.vector(), reading + theta.value(name)
        here, beyond = (position_reading(p, c, place, 0.0) for place in (stop, stop + STOP_UNIT_M))
        np.multiply(base, 0.0, out=change)  # what is no number stays none
        change[there & (flags & FLIES == 0), 1] -= beyond - here

    def gradient(self, theta: Theta, names: Sequence[str]) -> tuple[float, FloatArray, FloatArray]:
        """(log-likelihood, score, Fisher information) in the coordinates `names`."""
        base, change = self.derivatives(theta, names)
        return self.slopes(theta, names, base, change)

    def slopes(
        self, theta: Theta, names: Sequence[str], base: FloatArray, change: FloatArray
    ) -> tuple[float, FloatArray, FloatArray]:
        """`gradient` from outputs and derivatives; those of a point nearby will do for the last steps of a climb."""
        n, count = len(base), len(names)
        fisher, each = np.zeros((count, count)), np.empty((n, count))
        total = whiten(base, np.empty(n), np.empty((n, 2))) + self.outside(theta)
        information(base, change, each, fisher)
        steps = [derivative_step(theta, name, self.plant) for name in names]
        beside = [moved(theta, name, by, self.plant) for name, by in zip(names, steps, strict=True)]
        score, curvature = self.outside_slopes(theta, beside, steps)
        return total, each.sum(axis=0) + score, fisher + curvature
