"""The confidence of a name: a figure that grows with its lead over other candidates.  It is not calibrated yet.

The lead of a cause is the difference of log-likelihood to the best candidate outside its class.  `board51 bench
diagnosis` measures how often a name is right at each figure.  The map below was not fitted to that, except for names
beside `unknown-cause`.
"""

from __future__ import annotations

import math

from twin.diagnose import settings
from twin.diagnose.judge.account import Verdict
from twin.diagnose.search.state import Selection

# At most, by verdict.  Of the names that stood beside `unknown-cause` in two draws of the whole matrix 6 of 21 were
# right; none was counted yet beside `partly-explained`.
MOST: dict[Verdict, float] = {
    "causes-found": 0.98,
    "partly-explained": 0.98 * settings.CONFIDENCE_UNCALIBRATED,
    "unknown-cause": 0.294,
    "unfinished": 0.294,
}


def confidence_of(found: Selection, cause: str, verdict: Verdict, quick: bool) -> float:
    """Probability that the truth is `cause` or in its class.

    Args:
        found: the selection.
        cause: one of its causes.
        verdict: of the answer; while more than noise is left, a name may imitate an unknown cause.
        quick: without classes, not calibrated.
    """
    lead = found.runner_up.get(cause, found.gains.get(cause, 0.0))
    sure = 1.0 - 0.5 * math.exp(-max(lead, 0.0) / settings.CONFIDENCE_LEAD)
    return round(MOST[verdict] * sure * (settings.CONFIDENCE_UNCALIBRATED if quick else 1.0), 3)
