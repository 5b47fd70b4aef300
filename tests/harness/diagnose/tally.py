"""Many judged campaigns: rates with intervals against targets, the confusion matrix, reliability.  Pure."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from statistics import median

from tests.harness.diagnose.scoring import ADEQUATE, CAUSES_FOUND, NOT_IN_THE_DATA, UNKNOWN, Judgement, Outcome

Z95 = 1.959964
CONFIDENCE_EDGES = (0.0, 0.5, 0.7, 0.9, 0.95, 0.99, 1.0)
FOUR_FIFTHS = 0.8
_TARGET = {"strong": 0.95, "medium": 0.85}


@dataclass(frozen=True, slots=True, kw_only=True)
class Rate:
    """`hits` of `count`, with the 95 % interval; target: None, or what `hits / count` should reach or stay below."""

    name: str
    hits: int
    count: int
    target: float | None = None
    note: str = ""

    @property
    def value(self) -> float:
        """NaN of nothing."""
        return self.hits / self.count if self.count else math.nan

    @property
    def interval(self) -> tuple[float, float]:
        """Wilson's 95 % interval."""
        return wilson(self.hits, self.count)


def wilson(hits: int, count: int) -> tuple[float, float]:
    """95 % interval of a proportion p after Wilson (1927): |hits/count - p| <= z sqrt(p (1 - p) / count)."""
    if count == 0:
        return (0.0, 1.0)
    p, n, z = hits / count, count, Z95
    middle = (p + z * z / (2 * n)) / (1 + z * z / n)
    half = z / (1 + z * z / n) * math.sqrt(p * (1 - p) / n + z * z / (4 * n * n))
    return (max(0.0, middle - half), min(1.0, middle + half))


def _besides(uncounted: Sequence[Judgement]) -> str:
    absent = sum(j.column == NOT_IN_THE_DATA for j in uncounted)
    return f"besides: {len(uncounted) - absent} said to be not testable, {absent} not in the data"


def rates(outcomes: Iterable[Outcome]) -> list[Rate]:
    """All rates that the outcomes allow."""
    outcomes = list(outcomes)
    result: list[Rate] = []

    def part(name: str) -> list[tuple[Outcome, Judgement]]:
        return [(o, o.judgement) for o in outcomes if o.part == name and o.judgement is not None]

    causes = part("causes")
    for grade in ("strong", "medium", "weak"):
        graded = [(o, j) for o, j in causes if o.grade == grade]
        can = [(o, j) for o, j in graded if j.right is not None]
        if graded:
            result += [
                Rate(
                    name=f"{grade}: right (first, or in a class of at most 3)",
                    hits=sum(j.right is True for _, j in can),
                    count=len(can),
                    target=_TARGET.get(grade),
                    note=_besides([j for _, j in graded if j.right is None]),
                ),
                Rate(name=f"{grade}: first", hits=sum(j.first for _, j in can), count=len(can)),
            ]
    right = [(o, j) for o, j in causes if j.right is True]
    if right:
        besides = sum(j.false_names > 0 for _, j in right)
        reserved = sum(o.verdict == UNKNOWN for o, _ in right)
        result += [
            Rate(name="one cause, right: a false name besides", hits=besides, count=len(right)),
            Rate(name="one cause, right: unknown-cause all the same", hits=reserved, count=len(right)),
            Rate(
                name="one cause, right: another listed as too small to be named",
                hits=sum(bool(o.minor_effects) for o, _ in right),
                count=len(right),
            ),
        ]
    carried = [(o, j) for o, j in part("gateway") if j.right is not None]
    if carried:
        hits = sum(j.right is True for _, j in carried)
        result.append(Rate(name="through the gateway, strong: right", hits=hits, count=len(carried), target=0.95))
    nulls = part("nulls")
    if nulls:
        named = sum(o.verdict == CAUSES_FOUND for o, _ in nulls)
        result.append(
            Rate(
                name="nothing hidden: false alarm",
                hits=sum(j.right is not True for _, j in nulls),
                count=len(nulls),
                target=0.05,
                note=f"{named} with a name, {sum(o.verdict == UNKNOWN for o, _ in nulls)} unknown-cause",
            )
        )
    outside = part("outside")
    if outside:
        result += [
            Rate(name="outside: honest", hits=sum(j.right is True for _, j in outside), count=len(outside), target=0.9),
            Rate(
                name="outside: false name",
                hits=sum(o.verdict != UNKNOWN and j.false_names > 0 for o, j in outside),
                count=len(outside),
            ),
            Rate(
                name="outside: honest, with confounders listed",
                hits=sum(o.verdict == UNKNOWN and bool(o.named) for o, _ in outside),
                count=len(outside),
            ),
            Rate(
                name="outside: not noticed",
                hits=sum(o.verdict == ADEQUATE and j.right is not True for o, j in outside),
                count=len(outside),
            ),
        ]
    forms = [(o, j) for o, j in part("forms") if j.right is not None]
    if forms:
        wrong = sum(o.verdict == CAUSES_FOUND and (j.right is not True or j.false_names > 0) for o, j in forms)
        result += [
            Rate(name="another formula: right", hits=sum(j.right is True for _, j in forms), count=len(forms)),
            Rate(name="another formula: a false name", hits=wrong, count=len(forms), target=0.05),
        ]
    unknown = part("knock-out")
    if unknown:
        noticed = [(o, j) for o, j in unknown if o.verdict != ADEQUATE]
        removed = [j.removed for _, j in noticed if j.removed is not None]
        result += [
            Rate(
                name="not in the catalogue: a false name",
                hits=sum(j.right is not True for _, j in unknown),
                count=len(unknown),
                target=0.02,
            ),
            Rate(
                name="not in the catalogue: the right part of the loop",
                hits=sum(j.in_family is True for _, j in noticed),
                count=len(noticed),
                target=0.9,
                note=f"{len(unknown) - len(noticed)} not noticed, "
                f"{sum(j.in_family is None for _, j in noticed)} without",
            ),
            Rate(
                name="not in the catalogue: four fifths of the error above the noise removed",
                hits=sum(share >= FOUR_FIFTHS for share in removed),
                count=len(removed),
            ),
        ]
    listed = [(o, name) for o, _ in part("composites") for name, _ in o.minor_effects]
    if listed:
        present = sum(name in o.truths for o, name in listed)
        result.append(Rate(name="several causes: listed as too small, and there", hits=present, count=len(listed)))
    for number in (2, 3):
        several = [j for o, j in part("composites") if len(o.truths) == number]
        if several:
            result += [
                Rate(
                    name=f"{number} causes: truths found",
                    hits=sum(j.hits for j in several),
                    count=sum(j.truths for j in several),
                    note=f"{sum(j.false_names for j in several)} false names in {len(several)} campaigns",
                ),
                Rate(
                    name=f"{number} causes: all found", hits=sum(j.right is True for j in several), count=len(several)
                ),
            ]
    broken = [o for o in outcomes if o.status != "answered"]
    if broken:
        statuses = Counter(o.status for o in broken)
        result.append(
            Rate(
                name="campaigns without an answer",
                hits=len(broken),
                count=len(outcomes),
                target=0.0,
                note=", ".join(f"{status} {n}" for status, n in sorted(statuses.items())),
            )
        )
    return result


def removed_median(outcomes: Iterable[Outcome]) -> tuple[float, int]:
    """(median share of the excess removed on judge data, number) over single causes that were named rightly."""
    shares = [
        o.judgement.removed
        for o in outcomes
        if o.part == "causes" and o.judgement is not None and o.judgement.right and o.judgement.removed is not None
    ]
    return (median(shares), len(shares)) if shares else (math.nan, 0)


def reliability(outcomes: Iterable[Outcome]) -> list[tuple[float, float, Rate]]:
    """(mean stated confidence, upper edge, right of count) by bin, over single causes with a stated confidence."""
    stated = [
        (j.confidence, j.right is True)
        for o in outcomes
        if o.part == "causes" and (j := o.judgement) is not None and j.confidence is not None and j.right is not None
    ]
    table = []
    for low, high in pairwise(CONFIDENCE_EDGES):
        members = [(c, right) for c, right in stated if low <= c < high or (high == 1.0 and c >= 1.0)]
        if members:
            mean = sum(c for c, _ in members) / len(members)
            rate = Rate(name=f"{low:g} to {high:g}", hits=sum(right for _, right in members), count=len(members))
            table.append((mean, high, rate))
    return table


def confusion(outcomes: Iterable[Outcome]) -> dict[str, tuple[int, Counter[str]]]:
    """Count, for each hidden single effect (`none` for a null), the right answers and the answers of each column."""
    table: dict[str, tuple[int, Counter[str]]] = {}
    for o in outcomes:
        if o.part == "composites" or o.judgement is None:
            continue
        truth = o.grade if o.part == "forms" else o.truths[0] if o.truths else "none"
        right, columns = table.get(truth, (0, Counter()))
        columns[o.judgement.column] += 1
        table[truth] = (right + (o.judgement.right is True), columns)
    return dict(sorted(table.items()))


def seconds(outcomes: Sequence[Outcome]) -> tuple[float, float, float]:
    """(median, largest time of a diagnosis, median time of a recording), s; NaN of nothing."""
    answered = [o for o in outcomes if o.status == "answered"]
    if not answered:
        return (math.nan, math.nan, math.nan)
    times = [o.diagnose_s for o in answered]
    return (median(times), max(times), median(o.record_s for o in answered))


def page(outcomes: Sequence[Outcome]) -> str:
    """Everything as Markdown."""
    lines = ["| | of | rate | 95 % interval | target | |", "|---|---|---|---|---|---|"]
    for rate in rates(outcomes):
        low, high = rate.interval
        target = "" if rate.target is None else f"{100 * rate.target:.0f} %"
        lines.append(
            f"| {rate.name} | {rate.hits} of {rate.count} | {100 * rate.value:.0f} % | "
            f"{100 * low:.0f} .. {100 * high:.0f} % | {target} | {rate.note} |"
        )
    share, count = removed_median(outcomes)
    middle, longest, recording = seconds(outcomes)
    if count:
        lines += [
            "",
            f"Error above the noise floor removed on judge data when right: median {100 * share:.0f} % "
            f"of {count} campaigns (target 90 %).",
        ]
    if middle == middle:
        lines += [
            "",
            f"Time of a diagnosis: median {middle:.1f} s, longest {longest:.1f} s, one thread each, two at a time; "
            f"a campaign is recorded in {recording:.1f} s.",
        ]
    table = reliability(outcomes)
    if table:
        lines += ["", "| stated confidence | mean | right | 95 % interval |", "|---|---|---|---|"]
        for mean, _, rate in table:
            low, high = rate.interval
            lines.append(
                f"| {rate.name} | {mean:.3f} | {rate.hits} of {rate.count} ({100 * rate.value:.0f} %) | "
                f"{100 * low:.0f} .. {100 * high:.0f} % |"
            )
    matrix = confusion(outcomes)
    if matrix:
        lines += ["", "| hidden | right | what was said first, in its class or as verdict |", "|---|---|---|"]
        for truth, (right, columns) in matrix.items():
            listed = ", ".join(f"{name} {n}" for name, n in columns.most_common())
            lines.append(f"| {truth} | {right} of {columns.total()} | {listed} |")
    return "\n".join(lines) + "\n"
