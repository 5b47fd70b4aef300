"""A pair of causes that explains together what neither explains alone.

Two strong causes mask each other.  A limited rate looks like a long T_A, and beside a long T_A a delay explains
nothing: alone the two removed 2 and 5 % of what a model lacked, together 88 %.  So where no candidate explains a fair
share, each is fitted a little, and any two are tried with the values that they have alone.

Rule 1: a pair must explain nearly all.  Two names that explain less may imitate an unknown cause.
Rule 2: pairs are tried while more is missing than is explained.  A smaller rest does not hide strong causes.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from itertools import combinations

from twin.diagnosis.search import periodic
from twin.diagnosis.search.candidate_fits import Trial, refine, same_as, start_trial, within_range
from twin.diagnosis.search.state import Selection
from twin.diagnosis.search.task import Search
from twin.inference.fisher_scoring import approach
from twin.inference.theta import Theta, coordinates_of
from twin.settings import diagnosis as settings


def join(search: Search, selection: Selection) -> Selection:
    """Add the best pair after a refused step; returns `selection` if no pair explains nearly all that is left."""
    criterion, current, refused = search.criterion, selection.fit, selection.rounds[-1]
    floor = search.floor.under(criterion, current.theta)
    excess = floor.excess(current.loglik)
    # Rule 2.  Pairs at every refusal would cost up to 182 runs each time, and a small rest hides no strong cause.
    if not floor.material(current.loglik) or excess < current.loglik - selection.base.loglik:
        return selection
    fitted = {trial.cause for trial in refused.trials}
    scores = [score for score in refused.scores if score.testable and score.gain > settings.MIN_GAIN]
    # No periodic force: it needs phases in each recording, and merged values carry none.
    scores = [score for score in scores if score.cause not in fitted and score.cause != periodic.CAUSE.name]
    scores = scores[: max(settings.PAIR_CANDIDATES - len(fitted), 0)]
    trials = [*refused.trials, *criterion.each(partial(start_trial, criterion, current), scores)]
    pairs = [(first, second) for first, second in combinations(trials, 2) if second.cause not in same_as(first.cause)]
    # Both ways round, as K_A, T_A and the noise are those of the first, and either of the two may have bent them.
    starts = [start for first, second in pairs for start in (_merged(first, second), _merged(second, first))]
    # One run over part of the samples ranks a pair.  Fits of all pairs would be some ninety instead of three.
    values = criterion.thinner.values(starts)
    order = sorted(range(len(pairs)), key=lambda n: -max(values[2 * n : 2 * n + 2]))[: settings.PAIRS_FITTED]

    def short_fit(n: int) -> tuple[Trial, Trial]:
        first, second = pairs[n]
        start = starts[2 * n] if values[2 * n] >= values[2 * n + 1] else starts[2 * n + 1]
        fit = approach(criterion, start, current.free + coordinates_of(first.cause) + coordinates_of(second.cause))
        return first, Trial(cause=second.cause, fit=fit, gain=fit.loglik - current.loglik)

    best = max(criterion.each(short_fit, order), key=lambda pair: pair[1].gain, default=None)
    # A short fit that explains less than a fifth is not carried on: it would have to end four times as high.
    if best is None or best[1].gain < settings.PAIR_PROMISE * excess:
        return selection
    first, second = best[0], refine(criterion, best[1])
    possible = within_range(second) and within_range(replace(second, cause=first.cause))
    if not possible or second.gain < settings.PAIR_SHARE * excess:
        return selection
    search.report(f"selected together: {first.cause} and {second.cause} (log-likelihood +{second.gain:.0f})")
    steps = [
        replace(
            refused,
            trials=(first, *refused.trials),
            selected=first.cause,
            best=second,
            refusal="",
            partner=second.cause,
        ),
        replace(
            refused, scores=(), trials=(second,), selected=second.cause, best=second, refusal="", partner=first.cause
        ),
    ]
    return replace(
        selection,
        causes=(*selection.causes, first.cause, second.cause),
        fit=second.fit,
        gains={**selection.gains, first.cause: second.gain, second.cause: second.gain},
        rounds=(*selection.rounds[:-1], *steps),
    ).with_fits([second.fit])


def _merged(first: Trial, second: Trial) -> Theta:
    """Return the model of `first` with the cause of `second`."""
    theta = first.fit.theta
    for name in coordinates_of(second.cause):
        theta = theta.having(name, second.fit.theta.value(name))
    return theta
