"""Change points: an effect that begins or ends between two recordings of a campaign.

A change is looked for only if no cause that acts in all recordings leaves just noise.

Rule 1: one set of the paper's parameters for the whole campaign; a cause counts on one side of the change alone.
Rule 2: a change is reported only if what is left with it is noise, and if the same cause in all recordings, fitted
        again, is much worse.  A cause that the earlier recordings merely do not show passes the first and fails the
        second test.
Rule 3: the change lies between recordings; `consistency.beginnings` looks within a recording.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from twin.diagnose import settings
from twin.diagnose.inference.adequacy import adequate
from twin.diagnose.inference.budget import Spent
from twin.diagnose.inference.fisher_scoring import climb
from twin.diagnose.inference.likelihood import Criterion
from twin.diagnose.inference.noise_floor import Floor
from twin.diagnose.inference.theta import Theta, derivative_step, moved
from twin.diagnose.search.equivalence import find_classes
from twin.diagnose.search.probes import probes_of
from twin.diagnose.search.score_test import probed
from twin.diagnose.search.state import Selection
from twin.diagnose.search.stepwise import select
from twin.estimation.innovations import information
from twin.estimation.optimiser import inverse
from twin.estimation.record import BoolArray, FloatArray, Record, runs
from twin.estimation.structures import NO_STEPS, Results, Steps, room_for
from twin.model.causes.cause import Cause
from twin.model.extended import STATES

_NO_STATE = np.empty((0, STATES))


@dataclass(frozen=True, slots=True, kw_only=True)
class Change:
    """A change: its place and its causes."""

    before: str  # the last recording before it
    after: str  # the first recording after it
    begins: bool  # else it ends there
    recordings: tuple[str, ...]  # those in which the causes hold
    gain: float  # of log-likelihood over the same causes all the time
    selection: Selection
    criterion: Criterion

    def of(self, others: Sequence[Record]) -> list[Record]:
        """Those of other recordings that were taken on its side of the change; all where no common clock says it."""
        records = self.criterion.evidence.records
        if not apart([*records, *others]):
            return list(others)
        edge = next(float(record.t[0]) for record in records if record.name == self.after)
        return [record for record in others if (float(record.t[0]) >= edge) == self.begins]


class Switched(Criterion):
    """The likelihood with causes that hold in some recordings only.

    Args:
        of: whose evidence it is.
        holds: of each recording, whether the causes hold there.
        workers: threads.
    """

    def __init__(self, of: Criterion, holds: Sequence[bool], *, workers: int = 2) -> None:
        super().__init__(of.evidence, of.plant, of.tick_s, workers=workers, budget=of.budget)
        held = np.asarray(holds, np.bool_)[of.evidence.series.recording]
        cuts = [0, *(np.flatnonzero(np.diff(held)) + 1).tolist(), len(held)]
        self._pieces = [(slice(a, b), bool(held[a])) for a, b in itertools.pairwise(cuts) if b > a]

    def _outputs(self, theta: Theta, known: Steps = NO_STEPS) -> FloatArray:
        """As `Criterion._outputs`; the filter begins anew at each recording, so the pieces do not touch."""
        if not theta.causes:
            return super()._outputs(theta)
        results, absent = room_for(len(self.evidence.series), 3), replace(theta, causes=())
        for piece, holds in self._pieces:
            self._fill(theta if holds else absent, piece, results)
        self.evaluations += 1
        return results.innovations

    def run(self, theta: Theta) -> Results:
        """Without steps that others would take over: two models share it."""
        return room_for(0, 0)._replace(innovations=self.outputs(theta))


def find_change(
    criterion: Criterion,
    found: Selection,
    floor: Floor,
    *,
    candidates: Sequence[Cause],
    few: int,
    workers: int = 2,
    say: Callable[[str], None] = lambda line: None,
) -> Change | None:
    """Find the change between two recordings that leaves only noise; None if there is none.

    Args:
        criterion: of the recordings for fitting.
        found: result of the search without a change.
        floor: what sensor noise alone leaves.
        candidates: the causes to try.
        few: candidates that are fitted in a round.
        workers: threads.
        say: takes lines of progress.

    Raises:
        Spent: the budget ended before the answer.
    """
    records = criterion.evidence.records
    # A point of rest does not know its recording: what is (8)'s before is not after.
    if criterion.evidence.statics or len(records) < 2:
        return None
    order = in_time(records)
    # The phase of a periodic force is each recording's own anyway.
    candidates = [cause for cause in candidates if cause.detector != "spectral-line"]
    for place, begins in _places(criterion, found, candidates, order):
        first, second = order[:place], order[place:]
        names = records[first[-1]].name, records[second[0]].name
        side = second if begins else first
        say(f"did something change between {names[0]} and {names[1]}?")
        switched = Switched(criterion, [n in side for n in range(len(records))], workers=workers)
        chosen = select(
            switched,
            found.base,
            floor,
            candidates=candidates,
            few=few,
            share=settings.CHANGE_SHARE,
            classes=False,
            say=say,
        )
        if criterion.budget.closed:
            raise Spent
        if chosen.causes and adequate(switched, chosen.fit, floor.under(switched, chosen.fit.theta))[0]:
            chosen = find_classes(switched, chosen, candidates=candidates, few=few, quick=True, say=say)
            always = climb(criterion, chosen.fit.theta, chosen.fit.free, passes=settings.PASSES)
            gain = chosen.fit.loglik - max(always.loglik, found.fit.loglik)
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
    """The recordings in the order of one clock, where they have one; else as the campaign lists them."""
    places = range(len(records))
    return sorted(places, key=lambda n: float(records[n].t[0])) if apart(records) else list(places)


def apart(records: Sequence[Record]) -> bool:
    """Whether the times of the recordings are those of one clock: none begins before another has ended."""
    if any(not len(record.t) or not np.isfinite(record.t).all() for record in records):
        return False
    spans = sorted((float(record.t.min()), float(record.t.max())) for record in records)
    return all(a[1] < b[0] for a, b in itertools.pairwise(spans))


def _places(
    criterion: Criterion, found: Selection, candidates: Sequence[Cause], order: Sequence[int]
) -> list[tuple[int, bool]]:
    """The most promising (place in the order, whether the effect is after it), by the score test of every cause there.

    Sums over recordings are taken once: a change only says which of them a cause's signature keeps.
    """
    theta, free = found.base.theta, found.base.free
    trials = [(cause, probe) for cause in candidates for probe in probes_of(cause, criterion.evidence.series)]
    steps = [derivative_step(theta, name, criterion.plant) for name in free]
    thetas = [theta, *(moved(theta, name, by, criterion.plant) for name, by in zip(free, steps, strict=True))]
    base, *outs = criterion.several([*thetas, *(probed(theta, cause, probe) for cause, probe in trials)])
    scales = [*steps, *(1.0 for _ in trials)]
    change = np.stack([(out - base) / by for out, by in zip(outs, scales, strict=True)])
    del outs
    number, count, k = criterion.evidence.series.recording, len(scales), len(free)
    scores, fishers = np.zeros((len(order), count)), np.zeros((len(order), count, count))
    for place, recording in enumerate(order):
        for piece in runs(np.asarray(number == recording)):
            each = np.empty((piece.stop - piece.start, count))
            information(base[piece], np.ascontiguousarray(change[:, piece]), each, fishers[place])
            scores[place] += each.sum(axis=0)
    inner = inverse(fishers[:, :k, :k].sum(axis=0))
    whole = _best_gain(scores, fishers, np.ones(len(order), np.bool_), inner, k)
    gains = []
    for place in range(1, len(order)):
        for begins in (True, False):
            side = (np.arange(len(order)) >= place) == begins
            gains.append((_best_gain(scores, fishers, np.asarray(side), inner, k), place, begins))
    gains.sort(key=lambda entry: -entry[0])
    chosen: list[tuple[float, int, bool]] = []
    for gain, place, begins in gains:
        # Recordings that no cause shows in lie on either side with the same gain, and would have the same answer.
        other = all(abs(gain - known) > settings.CHANGE_SAME * gain or begins != side for known, _, side in chosen)
        if (
            gain > settings.CHANGE_AHEAD * whole + settings.CHANGE_GAIN
            and other
            and len(chosen) < settings.CHANGE_PLACES
        ):
            chosen.append((gain, place, begins))
    return [(place, begins) for _, place, begins in chosen]


def _best_gain(scores: FloatArray, fishers: FloatArray, side: BoolArray, inner: FloatArray, k: int) -> float:
    total = scores[:, :k].sum(axis=0)
    best = 0.0
    score, fisher = scores[side].sum(axis=0), fishers[side].sum(axis=0)
    for place in range(k, scores.shape[1]):
        cross, own = fisher[:k, place], float(fisher[place, place])
        left = own - float(cross @ inner @ cross)
        if own > 0.0 and math.isfinite(own) and left > settings.VISIBLE * own and left > settings.LEAST_INFORMATION:
            slope = float(score[place] - cross @ inner @ total)
            best = max(best, 0.5 * slope * slope / left)
    return best
