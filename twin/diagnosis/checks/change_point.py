"""Change points: an effect that begins or ends between two recordings of a campaign.

A change is searched for only if no cause that acts in all recordings leaves just noise.

Rule 1: one set of the paper's parameters holds for the whole campaign; a cause acts on one side of the change alone.
Rule 2: a change is reported only if it leaves just noise, and if the same cause in all recordings, fitted again, is
        much worse.  A cause that the earlier recordings do not show passes the first test and fails the second.
Rule 3: the change lies between recordings; `consistency.beginnings` looks within a recording.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from twin.diagnosis.search.equivalence import find_classes
from twin.diagnosis.search.probes import probes_of
from twin.diagnosis.search.score_test import probed
from twin.diagnosis.search.state import Selection
from twin.diagnosis.search.stepwise import select
from twin.diagnosis.search.task import Search
from twin.estimation.innovations import information
from twin.estimation.record import BoolArray, FloatArray, Record, runs
from twin.estimation.structures import NO_STEPS, Results, Steps, room_for
from twin.inference.adequacy import adequate
from twin.inference.budget import Spent
from twin.inference.fisher_scoring import climb
from twin.inference.likelihood import Criterion
from twin.inference.optimiser import inverse
from twin.inference.theta import Theta, derivative_step, moved
from twin.model.causes.cause import Cause
from twin.model.extended import STATES
from twin.settings import diagnosis as settings

_NO_STATE = np.empty((0, STATES))


@dataclass(frozen=True, slots=True, kw_only=True)
class Change:
    """A change: its place and its causes."""

    before: str  # the last recording before it
    after: str  # the first recording after it
    begins: bool  # otherwise it ends there
    recordings: tuple[str, ...]  # those in which the causes hold
    gain: float  # of log-likelihood over the same causes all the time
    selection: Selection
    criterion: Criterion

    def of(self, other_records: Sequence[Record]) -> list[Record]:
        """Return those of other recordings that are on its side of the change; all of them without a common clock."""
        records = self.criterion.evidence.records
        if not share_clock([*records, *other_records]):
            return list(other_records)
        edge = next(float(record.t[0]) for record in records if record.name == self.after)
        return [record for record in other_records if (float(record.t[0]) >= edge) == self.begins]


class Switched(Criterion):
    """The likelihood with causes that hold in some recordings only.

    Args:
        of: whose evidence it is.
        holds: of each recording, whether the causes hold there.
        workers: threads.
    """

    def __init__(self, of: Criterion, holds: Sequence[bool], *, workers: int = 2) -> None:
        super().__init__(of.evidence, of.plant, of.tick_s, workers=workers, budget=of.budget)
        # One likelihood whose causes end at a cut.  Two fits would have two noise levels and two sets of the paper's
        # parameters.
        held = np.asarray(holds, np.bool_)[of.evidence.series.recording]
        cuts = [0, *(np.flatnonzero(np.diff(held)) + 1).tolist(), len(held)]
        self._pieces = [(slice(a, b), bool(held[a])) for a, b in itertools.pairwise(cuts) if b > a]

    def _fill_all(self, theta: Theta, out: FloatArray, known: Steps = NO_STEPS) -> None:
        """Write the outputs of both models; the filter restarts at each recording, so pieces do not mix."""
        results, absent = room_for(0, 0)._replace(innovations=out), replace(theta, causes=())
        for piece, holds in self._pieces:
            self._fill(theta if holds else absent, piece, results)
        self.evaluations += 1

    def outputs(self, theta: Theta) -> FloatArray:
        """Return the outputs of both models, each where it holds."""
        self.pay(theta)
        return self._outputs(theta)

    def run(self, theta: Theta) -> Results:
        """Return a run without steps for other models, because two models share it."""
        return self.run_without_steps(theta)


def find_change(search: Search, selection: Selection, *, workers: int = 2) -> Change | None:
    """Find the change between two recordings that leaves only noise; None if there is none.

    Args:
        search: the search without a change.
        selection: its result.
        workers: threads.

    Raises:
        Spent: the budget ended before the answer.
    """
    criterion = search.criterion
    records = criterion.evidence.records
    # Points of rest do not belong to a recording, so they cannot be divided at a change.
    if criterion.evidence.statics or len(records) < 2:
        return None
    order = in_time(records)
    # A periodic force has a phase in each recording anyway.
    candidates = [cause for cause in search.candidates if "line" not in cause.detector]
    # Only cuts between recordings: within one, `consistency.beginnings` looks.  A fit for each cause and cut would be
    # far too many; the score sums of the recordings give the promising ones from one set of derivatives.
    for cut, begins in _promising_cuts(criterion, selection, candidates, order):
        first, second = order[:cut], order[cut:]
        names = records[first[-1]].name, records[second[0]].name
        side = second if begins else first
        search.report(f"did something change between {names[0]} and {names[1]}?")
        switched = Switched(criterion, [n in side for n in range(len(records))], workers=workers)
        # A higher share than usual: a change has more freedom than a cause, so it must explain more.
        one_sided = replace(search, criterion=switched, candidates=candidates, min_share=settings.CHANGE_SHARE)
        chosen = select(one_sided, selection.base, classes=False)
        if criterion.budget.closed:
            raise Spent
        if chosen.causes and adequate(switched, chosen.fit, search.floor.under(switched, chosen.fit.theta))[0]:
            chosen = find_classes(replace(one_sided, quick=True), chosen)
            # The rival is the same cause all the time, fitted anew.  Without it a cause that was merely missed by the
            # search would count as a change.
            always = climb(criterion, chosen.fit.theta, chosen.fit.free, passes=settings.PASSES)
            gain = chosen.fit.loglik - max(always.loglik, selection.fit.loglik)
            if gain > settings.CHANGE_GAIN:
                return Change(
                    before=names[0],
                    after=names[1],
                    begins=begins,
                    recordings=tuple(records[n].name for n in side),
                    gain=gain,
                    selection=chosen,
                    criterion=switched,
                )
        switched.close()
    return None


def in_time(records: Sequence[Record]) -> list[int]:
    """Return the recordings in the order of a common clock if they have one, otherwise in that of the campaign."""
    places = range(len(records))
    return sorted(places, key=lambda n: float(records[n].t[0])) if share_clock(records) else list(places)


def share_clock(records: Sequence[Record]) -> bool:
    """Tell whether the recordings share a clock: none begins before another has ended."""
    if any(not len(record.t) or not np.isfinite(record.t).all() for record in records):
        return False
    # The order in the campaign file may be any.  Clocks that start anew with each recording overlap, so times that do
    # not are of one clock.
    spans = sorted((float(record.t.min()), float(record.t.max())) for record in records)
    return all(a[1] < b[0] for a, b in itertools.pairwise(spans))


def _promising_cuts(
    criterion: Criterion, selection: Selection, candidates: Sequence[Cause], order: Sequence[int]
) -> list[tuple[int, bool]]:
    """The most promising (place in the order, whether the effect is after it), by the score test of every cause there.

    The sums over each recording are computed once: a change selects the recordings that count.
    """
    theta, free = selection.base.theta, selection.base.free
    trials = [(cause, probe) for cause in candidates for probe in probes_of(cause, criterion.evidence.series)]
    steps = [derivative_step(theta, name, criterion.plant) for name in free]
    models = [moved(theta, name, step, criterion.plant) for name, step in zip(free, steps, strict=True)]
    models += [probed(theta, cause, probe) for cause, probe in trials]
    scales = [*steps, *(1.0 for _ in trials)]
    at = criterion.run_without_steps(theta)
    base, change = at.innovations, criterion.changes(models, scales, at)
    number, count, k = criterion.evidence.series.recording, len(scales), len(free)
    scores, fishers = np.zeros((len(order), count)), np.zeros((len(order), count, count))
    for cut, recording in enumerate(order):
        for piece in runs(np.asarray(number == recording)):
            each = np.empty((piece.stop - piece.start, count))
            information(base[piece], np.ascontiguousarray(change[:, piece]), each, fishers[cut])
            scores[cut] += each.sum(axis=0)
    # The paper's parameters are common to all recordings, so their information is that of the whole campaign.
    inner = inverse(fishers[:, :k, :k].sum(axis=0))
    whole = _best_gain(scores, fishers, np.ones(len(order), np.bool_), inner, k)
    gains = []
    for cut in range(1, len(order)):
        for begins in (True, False):
            side = (np.arange(len(order)) >= cut) == begins
            gains.append((_best_gain(scores, fishers, np.asarray(side), inner, k), cut, begins))
    gains.sort(key=lambda entry: -entry[0])
    chosen: list[tuple[float, int, bool]] = []
    for gain, cut, begins in gains:
        # Recordings that show no cause have the same gain on either side of a change, and would give the same answer.
        other = all(abs(gain - known) > settings.CHANGE_SAME * gain or begins != side for known, _, side in chosen)
        if (
            gain > settings.CHANGE_AHEAD * whole + settings.CHANGE_GAIN
            and other
            and len(chosen) < settings.CHANGE_POSITIONS
        ):
            chosen.append((gain, cut, begins))
    return [(cut, begins) for _, cut, begins in chosen]


def _best_gain(scores: FloatArray, fishers: FloatArray, side: BoolArray, inner: FloatArray, k: int) -> float:
    total = scores[:, :k].sum(axis=0)
    best = 0.0
    score, fisher = scores[side].sum(axis=0), fishers[side].sum(axis=0)
    for index in range(k, scores.shape[1]):
        cross, diagonal = fisher[:k, index], float(fisher[index, index])
        # (S 8), with the free numbers those of the whole campaign and the cause that of one side.
        left = diagonal - float(cross @ inner @ cross)
        if (
            diagonal > 0.0
            and math.isfinite(diagonal)
            and left > settings.VISIBLE * diagonal
            and left > settings.MIN_INFORMATION
        ):
            slope = float(score[index] - cross @ inner @ total)
            best = max(best, 0.5 * slope * slope / left)
    return best
