"""The confidence of a name: how often such names were right, less where another candidate is near.

The lead of a cause is the difference of log-likelihood to the best candidate outside its class.  `board51 bench
diagnosis` measures how often a name is right at each figure (`twin/diagnosis/matrix.md`).
"""

from __future__ import annotations

import math

from twin.diagnosis.judge.account import Verdict
from twin.diagnosis.search.state import Selection
from twin.settings import diagnosis as settings

# Upper limit by verdict: the share of names that were right.  With `causes-found` 133 of 135, with `partly-explained`
# 8 of 12, and 6 of 21 candidates with `unknown-cause`.
MAX_CONFIDENCE: dict[Verdict, float] = {
    "causes-found": 0.98,
    "partly-explained": 0.64,
    "unknown-cause": 0.294,
    "unfinished": 0.294,
}


def confidence_of(selection: Selection, cause: str, verdict: Verdict) -> float:
    """Return the probability that the truth is `cause` or in its class.

    Args:
        selection: result of the search.
        cause: one of its causes.
        verdict: of the answer; while more than noise is left, a name may imitate an unknown cause.
    """
    lead = selection.runner_up.get(cause, selection.gains.get(cause, 0.0))
    sure = 1.0 - 0.5 * math.exp(-max(lead, 0.0) / settings.CONFIDENCE_LEAD)
    return round(MAX_CONFIDENCE[verdict] * sure, 3)
