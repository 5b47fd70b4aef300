"""Log-likelihood of the innovations of the extended model: one parameter set for the whole campaign.

Rule 1: sums over samples do not depend on the number of workers, as each worker computes whole derivatives.
Rule 2: evidence outside the series counts, too: priors of the stops and of the causes' shapes, lift-off points,
        equilibria.
Rule 3: a run is charged to the caller's budget before it begins.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import AbstractContextManager, contextmanager
from copy import copy
from functools import cached_property
from typing import TypeVar

import numpy as np

from protocol.campaign import Plant
from twin.estimation.ekf.filter import fill
from twin.estimation.ekf.memory import states_in
from twin.estimation.innovations import Series, information, whiten
from twin.estimation.pace import Reuse, pace_of
from twin.estimation.record import FloatArray
from twin.estimation.structures import NO_STEPS, OUT_COLUMNS, Results, Steps, room_for
from twin.evidence.dead_time import dead_time
from twin.evidence.gather import Evidence
from twin.evidence.thinned import thinned
from twin.inference.budget import Budget, Spent
from twin.inference.outside import Outside
from twin.inference.theta import COLOURS, NOISES, STOPS, Theta, derivative_step, moved, parameter_of
from twin.model.causes.catalogue import BY_NAME, with_trait
from twin.settings import diagnosis as settings

T = TypeVar("T")
R = TypeVar("R")


class Criterion:
    """The likelihood of a set of recordings.

    Args:
        evidence: the result of `gather`.
        plant: mass, travel, x_max, gravity.
        tick_s: the interval that process noise refers to.
        workers: threads; the kernels run outside the interpreter's lock.
        budget: what the runs of the filter are paid from; without one they are free.
    """

    def __init__(
        self, evidence: Evidence, plant: Plant, tick_s: float, *, workers: int = 2, budget: Budget | None = None
    ) -> None:
        self.plant, self.tick_s = plant, tick_s
        self.evidence, self.pace, self.halves = evidence, pace_of(evidence.series), _halves(evidence.series)
        self.share = 1.0  # of the samples of the campaign
        # Two pools: in a single one, climbs could occupy all threads and wait for their derivatives for ever.
        self._pool = ThreadPoolExecutor(max_workers=workers)
        self._climbers = ThreadPoolExecutor(max_workers=workers) if workers > 1 else None
        self.whole = budget or Budget()
        self._local = threading.local()
        self.evaluations = 0

    @cached_property
    def _thinned(self) -> Evidence:
        return thinned(self.evidence, settings.APPROACH_SAMPLES / max(len(self.evidence.series), 1))

    @property
    def thinner(self) -> Criterion:
        """The likelihood of part of the samples, for a quick approach to the maximum; `self` if samples are few."""
        if len(self.evidence.series) < settings.APPROACH_RATIO * settings.APPROACH_SAMPLES:
            return self
        return self.over(self._thinned)

    def over(self, part: Evidence) -> Criterion:
        """The likelihood of part of the samples, with the same threads and budget."""
        other, series = copy(self), part.series
        other.evidence, other.pace, other.halves = part, pace_of(series), _halves(series)
        other.share = len(series) / len(self.evidence.series)
        return other

    @property
    def budget(self) -> Budget:
        """The budget of this thread; inside `each` a share of it."""
        return getattr(self._local, "budget", self.whole)

    @contextmanager
    def charging(self, budget: Budget) -> Iterator[None]:
        """Let another budget pay for the runs inside the block."""
        before, self.whole = self.whole, budget
        try:
            yield
        finally:
            self.whole = before

    def free(self) -> AbstractContextManager[None]:
        """Make the runs inside the block free; for work with a fixed number of passes."""
        return self.charging(Budget())

    def pay(self, *thetas: Theta, reuse: Sequence[Reuse] = ()) -> None:
        """Pay for a run of each model; `reuse` as in `changes`.

        Raises:
            Spent: the budget is too small.
        """
        each = zip(thetas, reuse or [Reuse.NONE] * len(thetas), strict=True)
        self.budget.take(sum(self.pace.steps(theta.base(self.plant), theta.vector(), mode) for theta, mode in each))

    def close(self) -> None:
        """Stop the worker threads."""
        if self._climbers is not None:
            self._climbers.shutdown()  # first: a climb uses the other pool
        self._pool.shutdown()

    def each(self, work: Callable[[T], R], items: Sequence[T]) -> list[R]:
        """Do `work` on each item, several at once: a climb alone leaves a core idle between its derivatives.

        `work` may use this criterion, except `each`.

        Raises:
            Spent: the share of an item was too small.
        """
        shares = self.budget.shares(len(items))

        def paid(item: T, share: Budget) -> R | Spent:
            self._local.budget = share
            try:
                return work(item)
            except Spent as spent:
                return spent  # the other items finish: the steps spent must not depend on the order
            finally:
                del self._local.budget

        results = list((map if self._climbers is None else self._climbers.map)(paid, items, shares))
        self.budget.settle(shares)
        finished = [result for result in results if not isinstance(result, Spent)]
        if len(finished) < len(results):
            raise Spent
        return finished

    @cached_property
    def dead_time(self) -> tuple[float, float] | None:
        """Return `dead_time` of the recordings, which no model changes."""
        return dead_time(self.evidence.records)

    def outputs(self, theta: Theta) -> FloatArray:
        """Return the innovations and their covariance, shape (n, 5)."""
        return self._halved(theta).innovations

    def _outputs(self, theta: Theta) -> FloatArray:
        """Run the filter in this thread."""
        out = np.empty((len(self.evidence.series), OUT_COLUMNS))
        self._fill_all(theta, out)
        return out

    def _fill_all(self, theta: Theta, out: FloatArray, known: Steps = NO_STEPS) -> None:
        """Write the `outputs` to `out`, shape (n, 5); `known` as in `filtered`."""
        self._fill(theta, slice(0, len(out)), room_for(0, 0)._replace(innovations=out), known)
        self.evaluations += 1

    def _states(self, theta: Theta) -> int:
        return states_in(theta.vector(), theta.noise(self.tick_s))

    def _fill(self, theta: Theta, part: slice, results: Results, known: Steps = NO_STEPS) -> None:
        """Run whole recordings and write to their part of the results."""
        samples = theta.samples(self.evidence.samples, self.evidence.series.recording)
        fill(theta.system(self.plant, self.tick_s), samples.part(part), known.part(part), results.part(part))

    def run(self, theta: Theta) -> Results:
        """Return the innovations and the steps of the filter, which `changes` reuses."""
        return self._halved(theta, steps=True)

    def run_without_steps(self, theta: Theta) -> Results:
        """Return a run of which `changes` can reuse nothing."""
        return room_for(0, 0)._replace(innovations=self.outputs(theta))

    def _halved(self, theta: Theta, *, steps: bool = False) -> Results:
        """Run the filter over each half in a thread of its own."""
        self.pay(theta)
        results = room_for(len(self.evidence.series), self._states(theta), steps=steps)
        list(self._pool.map(lambda part: self._fill(theta, part, results), self.halves))
        self.evaluations += 1
        return results

    def changes(
        self, thetas: Sequence[Theta], scales: Sequence[float], at: Results, reuse: Sequence[Reuse] = ()
    ) -> FloatArray:
        """Return how far the `outputs` of models are from those of a run, over `scales`, shape (count, n, 5).

        Args:
            thetas: the models.
            scales: of each model.
            at: the run, of a model near them.
            reuse: for each model, what it reuses of the run; nothing by default.
        """
        reuse = reuse or [Reuse.NONE] * len(thetas)
        known, states, _ = at.steps.slopes.shape
        reuse = [
            mode if known and self._states(theta) == states else Reuse.NONE
            for theta, mode in zip(thetas, reuse, strict=True)
        ]
        self.pay(*thetas, reuse=reuse)
        steps = {mode: _reused(at.steps, mode) for mode in Reuse}
        change = np.empty((len(thetas), *at.innovations.shape))

        def fill_in(index: int) -> None:
            # In the worker: otherwise one thread would subtract for all while the others wait.
            self._fill_all(thetas[index], change[index], steps[reuse[index]])
            change[index] -= at.innovations
            change[index] /= scales[index]
            if reuse[index] is Reuse.GAINS:
                change[index, :, 2:] = 0.0  # the covariance is the same

        list(self._pool.map(fill_in, range(len(thetas))))
        return change

    def several(self, thetas: Sequence[Theta]) -> list[FloatArray]:
        """Return `outputs` of each point."""
        self.pay(*thetas)
        return list(self._pool.map(self._outputs, thetas))

    def value(self, theta: Theta) -> float:
        """Return the log-likelihood with the priors; -inf for impossible parameters."""
        return self.loglik(theta, self.outputs(theta))

    def loglik(self, theta: Theta, out: FloatArray) -> float:
        """Return the log-likelihood of a model and its innovations, shape (n, 5), with the priors."""
        return float(whiten(out, np.empty(len(out)), np.empty((len(out), 2)))) + self.outside.loglik(theta)

    def values(self, thetas: Sequence[Theta]) -> list[float]:
        """Return `value` of each point, -inf if it is not finite."""
        self.pay(*thetas)
        values = self._pool.map(lambda theta: self.loglik(theta, self._outputs(theta)), thetas)
        return [value if math.isfinite(value) else -math.inf for value in values]

    def white(self, theta: Theta) -> tuple[FloatArray, FloatArray]:
        """Return (log-likelihood of each sample, shape (n,); whitened innovations, shape (n, 2))."""
        out = self.outputs(theta)
        loglik, white = np.zeros(len(out)), np.full((len(out), 2), np.nan)
        whiten(out, loglik, white)
        return loglik, white

    @property
    def outside(self) -> Outside:
        """The evidence outside the series."""
        return Outside(statics=self.evidence.statics, plant=self.plant, share=self.share)

    def derivatives(
        self, theta: Theta, names: Sequence[str], at: Results | None = None, *, rough: bool = False
    ) -> tuple[FloatArray, FloatArray]:
        """Return (outputs, shape (n, 5); their derivatives by the coordinates, shape (count, n, 5)).

        Args:
            theta: the model.
            names: of the coordinates.
            at: a run of `theta`: models that differ in their noise reuse its steps.
            rough: reuse gains or slopes of the steps for all other models, for half the work or less.  If the
                innovations are about as large as the filter expects, this gives the direction of a step, but not the
                maximum.
        """
        # Differences of the filter, not analytic sensitivities. These would be a second set of equations, and each new
        # cause would extend it. The differences include the effect on the Kalman gains.
        steps = [derivative_step(theta, name, self.plant) for name in names]
        models = [moved(theta, name, step, self.plant) for name, step in zip(names, steps, strict=True)]
        if at is None:
            at, reuse = self.run_without_steps(theta), []
        else:
            reuse = _reusable(theta, names, rough)
        return at.innovations, self.changes(models, steps, at, reuse)

    def gradient(self, theta: Theta, names: Sequence[str]) -> tuple[float, FloatArray, FloatArray]:
        """Return (log-likelihood, score, Fisher information) in the coordinates `names`."""
        return self.slopes(theta, names, *self.derivatives(theta, names))

    def slopes(
        self, theta: Theta, names: Sequence[str], base: FloatArray, change: FloatArray
    ) -> tuple[float, FloatArray, FloatArray]:
        """Compute `gradient` from outputs and derivatives; those of a nearby point suffice at the end of a climb."""
        n, count = len(base), len(names)
        fisher, each = np.zeros((count, count)), np.empty((n, count))
        total = self.loglik(theta, base)
        information(base, change, each, fisher)
        steps = [derivative_step(theta, name, self.plant) for name in names]
        models = [moved(theta, name, step, self.plant) for name, step in zip(names, steps, strict=True)]
        score, curvature = self.outside.slopes(theta, models, steps)
        return total, each.sum(axis=0) + score, fisher + curvature


def _reused(steps: Steps, mode: Reuse) -> Steps:
    """Return the parts of a run's steps that a nearby model takes."""
    if mode is Reuse.NONE:
        return NO_STEPS
    if mode is Reuse.SLOPES:
        return NO_STEPS._replace(slopes=steps.slopes)
    return NO_STEPS._replace(gains=steps.gains) if mode is Reuse.GAINS else steps._replace(gains=NO_STEPS.gains)


def _reusable(theta: Theta, names: Sequence[str], rough: bool) -> list[Reuse]:
    """Return what the derivatives by these coordinates may reuse of a run; arguments as `Criterion.derivatives`."""
    present = {name.partition(".")[0] for name, value in theta.causes if value}
    # With dry friction the slopes are taken over the uncertainty of the state, which depends on the noise.
    smooth = () if present & with_trait("sticks") else NOISES + COLOURS
    # A stop is where a ball at rest is, and an inductance depends on that.
    steady = () if present & with_trait("of-the-gap") else STOPS
    # Otherwise noise levels and stops do not change the motion between two readings: its steps are reused.
    reuse = [Reuse.STEPS if name in NOISES + COLOURS + steady else nearby_reuse(name) for name in names]
    return [mode if rough or name in smooth + steady else Reuse.NONE for name, mode in zip(names, reuse, strict=True)]


def nearby_reuse(name: str) -> Reuse:
    """Return what a model that differs by this coordinate reuses of a run where a rough derivative suffices."""
    cause, _, parameter = name.partition(".")
    if not parameter:
        return Reuse.GAINS
    # The gains depend on how a sensor shows the state, and on what varies from tick to tick.
    return Reuse.SLOPES if BY_NAME[cause].family == "sensing" or parameter_of(name).random else Reuse.GAINS


def mean_square(out: FloatArray) -> float:
    """Return the mean square of the whitened innovations: 1 if their covariance is right, inf if there are none."""
    white = np.full((len(out), 2), np.nan)  # with impossible parameters, some rows are not filled in
    whiten(out, np.empty(len(out)), white)
    known = white[np.isfinite(white)]
    return float(np.mean(known**2)) if len(known) else math.inf


def _halves(series: Series) -> list[slice]:
    """Return two parts of about equal size for two workers; they meet where a recording begins."""
    # The filter starts anew with each recording, so its results do not depend on the cut.
    begins = np.flatnonzero(np.diff(series.recording, prepend=-1))
    n = len(series)
    middle = int(begins[np.argmin(np.abs(begins - n // 2))]) if len(begins) else 0
    return [piece for piece in (slice(0, middle), slice(middle, n)) if piece.stop > piece.start]
