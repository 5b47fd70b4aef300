"""A verdict: one line of the self-test, with the measured value, its bound, and what to do."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import StrEnum

Range = tuple[float, float]


class Result(StrEnum):
    """The outcome of one measurement."""

    OK = "ok"
    WARNING = "warning"
    FAULT = "FAULT"
    SKIPPED = "skipped"


@dataclass(frozen=True, slots=True, kw_only=True)
class Verdict:
    """A line.

    `name` is kebab-case and stable, for programs; the other texts are for people.  `value` and `bound` have their
    units.  `remedy` says what to do, or why it was skipped.
    """

    name: str
    result: Result
    what: str
    value: str = ""
    bound: str = ""
    remedy: str = ""
    check: str = ""  # the check that found it; the runner fills it in


def judge(
    name: str, what: str, value: float, unit: str, *, good: Range, possible: Range | None = None, remedy: str = ""
) -> Verdict:
    """Judge a number in `unit`: ok within `good`, a warning within `possible`, else a fault.

    Not a number is a fault.  An infinite end of `good` is no bound.  Without `possible` each value outside `good` is a
    fault.
    """
    low, high = possible or good
    if good[0] <= value <= good[1]:
        result = Result.OK
    else:
        result = Result.WARNING if possible and low <= value <= high else Result.FAULT
    return Verdict(
        name=name, result=result, what=what, value=quantity(value, unit), bound=_bound(good, unit),
        remedy="" if result == Result.OK else remedy,
    )  # fmt: skip


def passed(name: str, what: str, value: str, bound: str = "") -> Verdict:
    """Return an ok whose value is a text."""
    return Verdict(name=name, result=Result.OK, what=what, value=value, bound=bound)


def fault(name: str, what: str, value: str, *, bound: str = "", remedy: str) -> Verdict:
    """Return a fault whose value is a text."""
    return Verdict(name=name, result=Result.FAULT, what=what, value=value, bound=bound, remedy=remedy)


def warning(name: str, what: str, value: str, *, bound: str = "", remedy: str) -> Verdict:
    """Return a warning whose value is a text."""
    return Verdict(name=name, result=Result.WARNING, what=what, value=value, bound=bound, remedy=remedy)


def skipped(name: str, what: str, reason: str) -> Verdict:
    """Return what was not measured, and why."""
    return Verdict(name=name, result=Result.SKIPPED, what=what, remedy=reason)


def quantity(value: float, unit: str) -> str:
    """Return a value of three digits with its unit: never 1e+03, never -0."""
    digits = 0 if value == 0.0 or not math.isfinite(value) else max(0, 2 - math.floor(math.log10(abs(value))))
    text = f"{value:.{min(digits, 6)}f}"
    if "." in text:
        text = text.rstrip("0").rstrip(".")
    return f"{'0' if text == '-0' else text} {unit}".rstrip()


def _bound(good: Range, unit: str) -> str:
    low, high = good
    if low == high:
        return quantity(low, unit)
    if math.isinf(high):
        return f"at least {quantity(low, unit)}"
    if low in (-math.inf, 0.0):
        return f"at most {quantity(high, unit)}"
    if low == -high:
        return f"within ±{quantity(high, unit)}"
    return f"{quantity(low, '')} to {quantity(high, unit)}"


def line(verdict: Verdict) -> str:
    """Return the verdict as one line of text."""
    words = f"{verdict.result:<8} {verdict.check:<12} {verdict.what}"
    if verdict.value:
        words += f" {verdict.value}"
    if verdict.bound:
        words += f" ({verdict.bound})"
    return f"{words}: {verdict.remedy}" if verdict.remedy else words
