"""What the paper's model lacks, and who takes how much of it: one account behind shares, rest, verdict and sentences.

The quantity is the log-likelihood of the recordings for fitting, against a model that leaves sensor noise alone:

    total = what the causes explain together + what is left
    what they explain together = sum of what each takes + what they take jointly

Rule 1: the floor is that of the final model, for what the paper's model lacks and for what is left: under two floors
        the parts would not add up.
Rule 2: a cause takes what is lost without it, everything else fitted again; that is no more than all of them gain, as
        the model without it holds the paper's (a fit that is worse has not got to its end).  Where two hide each
        other, each takes nearly all of it; they then share in proportion what both gain.
Rule 3: what is no larger than the error of the noise level, and white, is not left: nothing measurable is.
Rule 4: on the judge recordings the quantity is another, the error of x 20 ms ahead against its noise floor.  It says
        whether the answer holds there; no share is made of it.
Rule 5: names hold in part where what is left on the judges is less than noise makes there, and half of what was above
        it is gone; else they may only stand in for what nobody knows: those of a wire's spring left 2.4 times the
        noise, and 9 % of what was above it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

from twin.diagnose import settings
from twin.diagnose.judge.prediction_gain import Gain
from twin.diagnose.search.state import Selection
from twin.estimation.prediction_floor import TOLERANCE

Verdict = Literal["causes-found", "partly-explained", "model-adequate", "unknown-cause", "unfinished"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Account:
    """Shares of what the paper's model lacks; `by_cause`, `jointly` and `unexplained` sum to 1 where it lacks anything.

    `explained`, `left` and `gains`, what is lost without each cause, are log-likelihoods.
    """

    explained: float
    left: float
    gains: Mapping[str, float]
    by_cause: Mapping[str, float]
    jointly: float
    unexplained: float


def account_of(found: Selection, lacks: float, fine: bool) -> Account:
    """The account of a search.

    Args:
        found: what it ended with.
        lacks: log-likelihood that its model lacks under its own floor.
        fine: whether that is noise.
    """
    explained = max(found.fit.loglik - found.base.loglik, 0.0) if found.causes else 0.0
    left = 0.0 if fine else max(lacks, 0.0)
    total = explained + left
    gains = {cause: min(max(found.gains.get(cause, 0.0), 0.0), explained) for cause in found.causes}
    if total <= 0.0:
        return Account(
            explained=0.0,
            left=0.0,
            gains=gains,
            by_cause=dict.fromkeys(found.causes, 0.0),
            jointly=0.0,
            unexplained=0.0 if fine else 1.0,
        )
    taken = sum(gains.values())
    scale = min(1.0, explained / max(taken, 1e-300)) / total
    return Account(
        explained=explained,
        left=left,
        gains=gains,
        by_cause={cause: gain * scale for cause, gain in gains.items()},
        jointly=max(explained - taken, 0.0) / total,
        unexplained=left / total,
    )


def beyond_floor(gain: Gain | None) -> bool:
    """Whether the judge recordings show surely more than noise: their error lies above the floor and its tolerance."""
    return gain is not None and gain.ci95_floor[0] > TOLERANCE


def verdict_of(*, named: bool, fine: bool, gain: Gain | None, finished: bool = True) -> Verdict:
    """The verdict.

    Args:
        named: whether anything is named.
        fine: whether what is left of the recordings for fitting is noise.
        gain: on the judge recordings, 20 ms ahead.
        finished: whether the search examined all that it was asked for.
    """
    if not finished:
        return "unfinished"
    if fine and not beyond_floor(gain):
        return "causes-found" if named else "model-adequate"
    # Names that leave more than noise where they were chosen may only stand in for what nobody knows, too.
    return "partly-explained" if named and fine and _holds(gain) else "unknown-cause"


def _holds(gain: Gain | None) -> bool:
    return gain is not None and gain.ci95_floor[1] < settings.PARTLY_ERROR and gain.removed >= settings.PARTLY_SHARE
