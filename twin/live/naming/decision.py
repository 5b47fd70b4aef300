"""The decision over windows: since when, and as which cause, the rig differs from the twin's model.  Pure.

The parameters are fitted to each window alone, so evidence adds up.  For an effect of constant size that began with
window k, with slopes g and information F of the windows since, (S 8) of docs/theory/statistics.md:

    gain = max over k of (sum of g)^2 / (2 sum of F)        (E. S. Page, 1954; G. Lorden, 1971: unknown size and onset)

where the sums leave out the best window.  An effect that begins within a window makes its evidence point anywhere, and
a tap on the table is in one window.  So a name takes two.

Rule 1: under a right model twice a gain is chi-square with one degree for each cause, probe and k.  The threshold is
        that at which all of them, in all windows of a week, exceed it FALSE_NAMES_PER_WEEK times at most (Bonferroni).
        They are correlated, so the true rate is lower.
Rule 2: a gain is linear in the size, and wrong by up to a quarter for an effect of medium size.  So causes within
        SAME_SHARE of the best are one class, and none of them is certain.
Rule 3: a name stays while it is in the class: what these samples do not tell apart would change with each window.
        Within the class a cause of a possible size goes first.
        Its onset stays when the window of the onset leaves the memory.
Rule 4: evidence has gone where the newest windows contradict the size by GONE of log-likelihood.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from twin.diagnosis.search.score_test import two_sided
from twin.distributions import chi2_exceeded
from twin.estimation.record import FloatArray
from twin.live.naming.evidence import Signature, WindowEvidence
from twin.live.naming.windows import Window
from twin.model.causes.catalogue import BY_NAME
from twin.settings.naming import (
    CONFIDENCE,
    FALSE_NAMES_PER_WEEK,
    FORGOTTEN_S,
    GONE,
    MIN_INFORMATION,
    SAME_SHARE,
    WINDOW_S,
    WINDOWS,
)

WEEK_S = 7 * 86400.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Proposal:
    """A cause by which the rig may differ from the twin's model."""

    cause: str
    strength: float  # in the unit of the cause's first parameter
    probability: float  # of this cause among those of the class, and of none
    others: tuple[str, ...]  # the rest of its class, best first
    gain: float  # log-likelihood
    since: Window  # the first with the effect
    until: Window  # the newest


def min_gain(probes: int) -> float:
    """Return the threshold of rule 1."""
    tests = WEEK_S / WINDOW_S * WINDOWS * max(probes, 1)
    return 0.5 * chi2_exceeded(FALSE_NAMES_PER_WEEK / tests, 1)


def without_best(slopes: FloatArray, information: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the sums since each window, without the window that says most in favour of the probe.

    Args:
        slopes: of each window and probe, shape (windows, probes).
        information: the same.
    """
    own = slopes**2 / np.maximum(information, 1e-300)
    sums = [np.cumsum(values[::-1], axis=0)[::-1] for values in (slopes, information)]
    probes, best = np.arange(slopes.shape[1]), np.full(slopes.shape[1], len(slopes) - 1)
    for window in range(len(slopes) - 1, -1, -1):
        # From the newest window backwards: one pass finds the best of the windows since each onset.
        best = np.where(own[window] > own[best, probes], window, best)
        for total, values in zip(sums, (slopes, information), strict=True):
            total[window] -= values[best, probes]
    return sums[0], np.maximum(sums[1], 0.0)


class Decision:
    """Adds up the evidence of one board under one model."""

    def __init__(self) -> None:
        self._windows: deque[WindowEvidence] = deque(maxlen=WINDOWS)
        self.proposal: Proposal | None = None

    def forget(self) -> None:
        """Begin anew: another model, another session, or another flight."""
        self._windows.clear()
        self.proposal = None

    def expire(self, session: int, now_s: float) -> None:
        """Forget evidence of another session, or of a flight that ended FORGOTTEN_S ago by the board's clock."""
        if self._windows:
            newest = self._windows[-1].window
            if session != newest.session or not 0.0 <= now_s - newest.to_s <= FORGOTTEN_S:
                self.forget()

    def add(self, evidence: WindowEvidence) -> Proposal | None:
        """Take the evidence of the next window; what it amounts to with those before."""
        self.expire(evidence.window.session, evidence.window.to_s)
        if self._windows and self._keys(self._windows[-1]) != self._keys(evidence):
            self.forget()
        self._windows.append(evidence)
        self.proposal = self._decided()
        return self.proposal

    @staticmethod
    def _keys(evidence: WindowEvidence) -> list[str]:
        return [signature.cause for signature in evidence.signatures]

    def _decided(self) -> Proposal | None:
        signatures = self._windows[-1].signatures
        slopes, information = without_best(
            *(
                np.array([[getattr(one, name) for one in each.signatures] for each in self._windows])
                for name in ("slope", "information")
            )
        )
        known = information > MIN_INFORMATION
        gains = np.where(known, 0.5 * slopes**2 / np.where(known, information, 1.0), 0.0)
        one_sided = np.array([not two_sided(BY_NAME[one.cause]) for one in signatures], np.bool_)
        # A friction below 0 is none: a strength without a sign counts in one direction only.
        gains[one_sided & (slopes < 0.0)] = 0.0
        if not gains.size or gains.max() <= min_gain(len(signatures)):
            return None
        # One onset for all, that of the best: so causes are compared over the same windows.
        first = int(np.unravel_index(np.argmax(gains), gains.shape)[0])
        ranking = _ranking(signatures, gains[first])
        top = max(float(gains[first, probe]) for probe in ranking.values())
        same = [cause for cause, probe in ranking.items() if gains[first, probe] >= SAME_SHARE * top]
        sizes = slopes[first] / np.maximum(information[first], MIN_INFORMATION)
        strengths = {cause: _strength(signatures[ranking[cause]], float(sizes[ranking[cause]])) for cause in same}
        possible = [cause for cause in same if _is_possible(cause, strengths[cause])] or same
        before = self.proposal.cause if self.proposal is not None else ""
        named = before if before in possible else possible[0]
        probe = ranking[named]
        size = float(sizes[probe])
        since = slice(first, None)
        # Log-likelihood of that size since each window, s g - s^2 F / 2 to second order.
        contradiction = size * slopes[since, probe] - 0.5 * size**2 * information[since, probe]
        if contradiction.min() < -GONE:
            # Only the windows before the contradiction go: those after it may show what holds now.
            for _ in range(first + int(np.argmin(contradiction))):
                self._windows.popleft()
            return None
        # Gains that are wrong by a share of the largest tell causes apart no better than that.
        scale = max(1.0, (1.0 - SAME_SHARE) * top / 3.0)
        weights = {cause: math.exp((float(gains[first, at]) - top) / scale) for cause, at in ranking.items()}
        return Proposal(
            cause=named,
            strength=strengths[named],
            probability=CONFIDENCE * weights[named] / sum(weights.values()),
            others=tuple(cause for cause in same if cause != named),
            gain=float(gains[first, probe]),
            since=self.proposal.since if self.proposal is not None and first == 0 else self._windows[first].window,
            until=self._windows[-1].window,
        )


def _strength(signature: Signature, size: float) -> float:
    strength = BY_NAME[signature.cause].strength
    return strength.value(size * strength.coordinate(signature.probe))


def _is_possible(cause: str, value: float) -> bool:
    """Tell whether a strength is within the physical range: at its end, this cause would have to be larger still."""
    strength = BY_NAME[cause].strength
    return strength.low < value < strength.high


def _ranking(signatures: Sequence[Signature], gains: FloatArray) -> dict[str, int]:
    """Return the probe with the largest gain of each cause, the best cause first."""
    best: dict[str, int] = {}
    for probe in np.argsort(-gains).tolist():
        best.setdefault(signatures[probe].cause, probe)
    return best
