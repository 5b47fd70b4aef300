"""Scores of answers against the truths, and the table.  Pure.

Rule 1: with several causes hidden, the probability on the truth is the sum of theirs.
Rule 2: the share removed is (base^2 - error^2) / (base^2 - floor^2) of x 20 ms ahead on the judge recordings.  `base`
        is the paper's model at its best (entry `base`); `floor` is what the true numbers of the rig leave under sensor
        noise.  No share where base is within 5 % of the floor.
Rule 3: no answer counts as probability 0 on the truth and nothing removed.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from statistics import fmean, median

import numpy as np

from tests.harness.truth.answer import Answer
from tests.harness.truth.draw import NO_CAUSE, OTHER, Truth

MIN_PROBABILITY = 1e-3  # probability below which the log score falls no further
BINS = 5
DRAWS = 2000
WITHIN_FLOOR = 1.05
_NO_ANSWER = Answer(
    verdict="nothing", probabilities={NO_CAUSE: 1.0}, place="", names=(), predictions="none", seconds=0.0
)
TITLES = (
    "p(truth)",
    "log score",
    "- first (95 %)",
    "false alarms",
    "false names",
    "place",
    "class",
    "ECE",
    "removed",
    "s",
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Score:
    """The scores of one answer; None where the question does not arise."""

    case: str
    p_truth: float
    top: float  # the largest probability
    is_top: bool  # whether that is on the truth
    false_alarm: bool | None  # nothing was hidden, and the verdict is another
    false_name: bool  # a cause is named, and its class holds no truth
    place: bool | None
    class_size: int | None  # of a named cause
    removed: float | None
    seconds: float | None
    answered: bool = True

    @property
    def log_score(self) -> float:
        """Natural logarithm of the probability on the truth."""
        return math.log(max(self.p_truth, MIN_PROBABILITY))


def removed_share(base_m: float, error_m: float, floor_m: float) -> float | None:
    """Rule 2, at most 1."""
    if not base_m > WITHIN_FLOOR * floor_m:
        return None
    return min((base_m**2 - error_m**2) / (base_m**2 - floor_m**2), 1.0)


def score(truth: Truth, answer: Answer, *, base_m: float, error_m: float) -> Score:
    """Judge one answer."""
    top = max(answer.probabilities, key=lambda name: answer.probabilities[name])
    is_null = truth.names == (NO_CAUSE,)
    named = answer.verdict == "cause"
    return Score(
        case=truth.case,
        p_truth=math.fsum(answer.probabilities.get(name, 0.0) for name in truth.names),
        top=answer.probabilities[top],
        is_top=top in truth.names,
        false_alarm=answer.verdict != NO_CAUSE if is_null else None,
        false_name=named and not set(answer.names) & set(truth.names) - {NO_CAUSE, OTHER},
        place=None if is_null else answer.place in truth.places,
        class_size=len(answer.names) if named else None,
        removed=removed_share(base_m, error_m, truth.floor_m),
        seconds=answer.seconds,
    )


def unanswered(truth: Truth, *, base_m: float) -> Score:
    """Rule 3."""
    result = score(truth, _NO_ANSWER, base_m=base_m, error_m=base_m)
    return replace(result, p_truth=0.0, top=0.0, is_top=False, false_alarm=None, seconds=None, answered=False)


def calibration_error(scores: Sequence[Score]) -> float:
    """ECE: mean distance of the largest probability from how often it is on the truth, over bins of equal width."""
    bins: dict[int, list[Score]] = {}
    for result in scores:
        bins.setdefault(min(int(result.top * BINS), BINS - 1), []).append(result)
    gaps = [len(b) * abs(fmean(s.top for s in b) - fmean(s.is_top for s in b)) for b in bins.values()]
    return math.fsum(gaps) / len(scores)


def paired_interval(first: Sequence[float], second: Sequence[float]) -> tuple[float, float, float]:
    """Mean of second - first over the same cases, with its 95 % interval by bootstrap."""
    difference = np.subtract(second, first)
    drawn = np.random.default_rng(0).integers(len(difference), size=(DRAWS, len(difference)))
    low, high = np.quantile(difference[drawn].mean(axis=1), (0.025, 0.975))
    return float(difference.mean()), float(low), float(high)


def table(entries: Mapping[str, Sequence[Score]]) -> str:
    """The scores as Markdown, a row per entry, all of the same cases in the same order."""
    first = next(iter(entries.values()))
    lines = [f"| entry | {' | '.join(TITLES)} |", "|---" * (len(TITLES) + 1) + "|"]
    for name, scores in entries.items():
        mean, low, high = paired_interval([s.log_score for s in first], [s.log_score for s in scores])
        cells = (
            _mean([s.p_truth for s in scores], "{:.2f}"),
            _mean([s.log_score for s in scores], "{:.2f}"),
            "" if scores is first else f"{mean:+.2f} ({low:+.2f} .. {high:+.2f})",
            _of([s.false_alarm for s in scores]),
            _of([s.false_name for s in scores if s.answered]),
            _of([s.place for s in scores]),
            _mean([s.class_size for s in scores], "{:.1f}"),
            f"{calibration_error(scores):.2f}",
            _mean([s.removed for s in scores], "{:.0%}", median),
            _mean([s.seconds for s in scores], "{:.1f}", median),
        )
        missing = sum(not s.answered for s in scores)
        lines.append(f"| {name}{f' ({missing} unanswered)' * bool(missing)} | {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"


def _mean(values: Sequence[float | None], form: str, middle: Callable[[Sequence[float]], float] = fmean) -> str:
    present = [value for value in values if value is not None]
    return form.format(middle(present)) if present else "-"


def _of(values: Sequence[bool | None]) -> str:
    present = [value for value in values if value is not None]
    return f"{sum(present)} of {len(present)}" if present else "-"
