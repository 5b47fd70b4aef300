"""The account of what the paper's model lacks and of what each cause explains: shares, rest and verdict.

The quantity is the log-likelihood of the recordings for fitting, against a model that leaves sensor noise alone:

    total = explained by all causes + left
    explained by all causes = sum over causes of the share that each explains + jointly explained

Rule 1: the floor of the final model counts for the paper's model, too: under two floors the parts would not add up.
Rule 2: a cause explains what is lost without it, with everything else fitted again.  That is at most the gain of all
        causes together.  If two causes mask each other, each explains nearly all of it; then they share the common
        gain in proportion.
Rule 3: a rest that is white and no larger than the uncertainty of the noise level counts as nothing.
Rule 4: on the judge recordings the quantity is the error of x 20 ms ahead compared with its noise floor.  It decides
        whether the answer holds there; it is not part of the shares.
Rule 5: names hold in part if they remove most of the error above the noise on the judge recordings.  Half of it is
        enough if the rest is smaller than the noise.  Otherwise they may imitate an unknown cause.  Those that imitated
        the spring of a wire left 2.4 times the noise and removed 9 % of the error above it.  A name that a curve of
        unknown origin surpasses does not hold, however much it removes (`remainder/rivals.py`).
Rule 6: names that hold in part need a leading cause.  Alone it explains at least as much as is left and as several
        explain jointly.  A cause that explains less may only correct the form of another, and is a candidate.  Three
        causes with two thirds of their gain in common imitated the spring of a wire.
Rule 7: several names hold only if they explain more apart than jointly.  Names that imitate one unknown effect are each
        like it, and so like each other; causes that act together are as alike only by chance.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import Literal

from twin.diagnosis.judge.prediction_gain import Gain
from twin.diagnosis.search.state import Selection
from twin.estimation.prediction_floor import TOLERANCE
from twin.settings import diagnosis as settings

Verdict = Literal["causes-found", "partly-explained", "model-adequate", "unknown-cause", "unfinished"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Account:
    """The shares of what the paper's model lacks.

    `cause_shares`, `jointly` and `unexplained` sum to 1 where it lacks anything.

    `explained`, `left` and `gains`, what is lost without each cause, are log-likelihoods.
    """

    explained: float
    left: float
    gains: Mapping[str, float]
    cause_shares: Mapping[str, float]
    jointly: float
    unexplained: float
    doubted: frozenset[str] = frozenset()  # names in whose place something unknown explains more

    def leads(self, cause: str) -> bool:
        """Tell whether a cause alone explains at least as much as is left and as several explain jointly."""
        return cause not in self.doubted and self.cause_shares.get(cause, 0.0) >= self.unexplained + self.jointly

    @property
    def overlaps(self) -> bool:
        """Tell whether the causes explain more jointly than apart, as names do that imitate one effect."""
        return self.jointly > sum(self.cause_shares.values())


def account_of(selection: Selection, lacks: float, is_adequate: bool, doubted: Collection[str] = ()) -> Account:
    """Account for the result of a search.

    Args:
        selection: its result.
        lacks: log-likelihood that its model lacks under its own floor.
        is_adequate: whether that is noise.
        doubted: causes in whose place something unknown explains more.
    """
    explained = max(selection.fit.loglik - selection.base.loglik, 0.0) if selection.causes else 0.0
    left = 0.0 if is_adequate else max(lacks, 0.0)
    total = explained + left
    gains = {cause: min(max(selection.gains.get(cause, 0.0), 0.0), explained) for cause in selection.causes}
    gain_sum = sum(gains.values())
    unexplained = float(not is_adequate) if total <= 0.0 else left / total
    total = total or 1.0  # of nothing every share is 0
    # In proportion, not in the order of the search: the first cause would get the whole of a gain in common.
    scale = min(1.0, explained / max(gain_sum, 1e-300)) / total
    return Account(
        explained=explained,
        left=left,
        gains=gains,
        cause_shares={cause: gain * scale for cause, gain in gains.items()},
        jointly=max(explained - gain_sum, 0.0) / total,
        unexplained=unexplained,
        doubted=frozenset(doubted),
    )


def exceeds_floor(gain: Gain | None) -> bool:
    """Tell whether the error on the judge recordings lies significantly above the noise floor and its tolerance."""
    # The lower end of the interval, so that a right model fails by chance in 2.5 % of campaigns at most.
    return gain is not None and gain.ci95_floor[0] > TOLERANCE


def verdict_of(
    *,
    named: bool,
    is_adequate: bool,
    gain: Gain | None,
    finished: bool = True,
    leading: bool = False,
    worse: bool = False,
) -> Verdict:
    """Return the verdict.

    Args:
        named: whether anything is named.
        is_adequate: whether what is left of the recordings for fitting is noise.
        gain: on the judge recordings, 20 ms ahead.
        finished: whether the search examined every question.
        leading: whether a cause leads the account.
        worse: whether the named causes make the prediction of the judge recordings worse; then none of them holds.
    """
    if not finished:
        return "unfinished"
    # Noise in the recordings for fitting is not enough: process noise may hide there what a longer prediction shows.
    if is_adequate and not exceeds_floor(gain) and not (named and worse):
        return "causes-found" if named else "model-adequate"
    return "partly-explained" if named and leading and _holds(gain) and not worse else "unknown-cause"


def _holds(gain: Gain | None) -> bool:
    if gain is None:
        return False
    # The upper end of the interval, against the noise: a wide interval must not count as a small rest.
    is_small = gain.ci95_floor[1] < settings.PARTLY_ERROR and gain.removed >= settings.PARTLY_SHARE
    return is_small or gain.removed >= settings.LARGE_SHARE


def confidence_of(selection: Selection, cause: str, verdict: Verdict) -> float:
    """Return the probability that the truth is `cause` or in its class, less where another candidate is near.

    The lead of a cause is the difference of log-likelihood to the best candidate outside its class.  `board51 bench
    diagnosis` measures how often a name is right at each figure (`twin/diagnosis/matrix.md`).

    Args:
        selection: result of the search.
        cause: one of its causes.
        verdict: of the answer; while more than noise is left, a name may imitate an unknown cause.
    """
    # The lead over the best name outside the class.  The gain itself says that a cause is needed, not which.
    lead = selection.runner_up.get(cause, selection.gains.get(cause, 0.0))
    # With no lead either of two names is as likely.  With a threshold instead, a little noise would decide between two
    # confidences.
    sure = 1.0 - 0.5 * math.exp(-max(lead, 0.0) / settings.CONFIDENCE_LEAD)
    return round(settings.MAX_CONFIDENCE[verdict] * sure, 3)
