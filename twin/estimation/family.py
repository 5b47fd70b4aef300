"""Many tests of one question: the one place that decides which of them say that a model is wrong.

A report shows some fifty groups of errors, four horizons and three figures of a step.  At 5 % each a right model would
fail in one of them on nearly every page, and the page would contradict its own verdict.  So the tests of a question are
one family, and FAMILY_LEVEL is the chance that a right model fails in any of them.

Holm's method: S. Holm, A simple sequentially rejective multiple test procedure, Scandinavian Journal of Statistics 6
(1979), 65-70.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from twin.distributions import normal_above
from twin.estimation.record import FloatArray

# Level.  The chance that a report finds a right model wrong in any test of one family.
FAMILY_LEVEL = 0.05


def holm(chances: Sequence[float], level: float = FAMILY_LEVEL) -> list[bool]:
    """Return which tests of a family are significant together (Holm, 1979).

    Args:
        chances: p value of each test; NaN: there is no test.
        level: chance of one or more wrong answers in the whole family.
    """
    ordered = sorted((chance, index) for index, chance in enumerate(chances) if math.isfinite(chance))
    significant = [False] * len(chances)
    # Holm's levels, not Bonferroni's: they keep the same chance for the family and never reject less.
    for rejected, (chance, index) in enumerate(ordered):
        if chance > level / (len(ordered) - rejected):
            break
        significant[index] = True
    return significant


def chance_of_worse(ratio: float, draws: FloatArray) -> float:
    """Return the one-sided p value of a ratio of errors above 1, from its bootstrap; NaN without a spread.

    A normal distribution of the logarithm: quantiles of 400 draws end at 0.25 %, and a family of fifty needs 0.1 %.

    Args:
        ratio: the errors of one model over those of the other.
        draws: the same ratio in each draw of the bootstrap, shape (DRAWS,).
    """
    known = draws[np.isfinite(draws) & (draws > 0.0)]
    if len(known) < 2 or not (math.isfinite(ratio) and ratio > 0.0):
        return math.nan
    spread = float(np.log(known).std(ddof=1))
    return normal_above(math.log(ratio) / spread) if spread > 0.0 else math.nan
