"""The influence of each number of `twin/settings/diagnosis.py` on the answers: halved and doubled, one at a time.

    python -m tests.harness.diagnose.sensitivity --results sensitivity.jsonl --minutes 50    made or continued
    python -m tests.harness.diagnose.sensitivity --results sensitivity.jsonl --minutes 0     the table of what is there

The campaigns are a frozen draw (seeds from FIRST on, `tests/harness/diagnose/draws.py`) that nothing was tuned on.
Whoever tunes on it takes another FIRST.  They are short ones, diagnosed with `--quick` unless `--full` is given.
"""

from __future__ import annotations

import argparse
import json
import tempfile
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from protocol.campaign import load
from tests.harness.diagnose.draws import Hidden, Part, draw_hidden, record_hidden
from tests.harness.diagnose.hidden_campaign import Grounded, Refused
from tests.harness.diagnose.outside import OUTSIDE
from tests.harness.diagnose.remembered import remembered
from tests.harness.diagnose.scoring import UNKNOWN, Answer, judge, read_answer
from tests.harness.diagnose.tally import wilson
from tests.harness.diagnose.trial import program_digest
from twin.diagnosis.options import Options
from twin.diagnosis.pipeline import diagnose_records
from twin.diagnosis.result import to_json
from twin.readers.campaign import read_campaign
from twin.settings import diagnosis as settings

FIRST = 20_000
AS_IT_IS = "as it is"
# Of each turn: how many campaigns of which part.
TURN: tuple[tuple[Part, int], ...] = (("causes", 4), ("nulls", 5), ("outside", 1), ("composites", 1))
VARIED = (
    "NOISE_TOLERANCE",
    "NOISE_ERRORS",
    "AUTOCORRELATION_ERRORS",
    "MAX_AUTOCORRELATION",
    "MISPLACED_STOP_M",
    "VISIBLE",
    "MIN_INFORMATION",
    "MIN_GAIN",
    "MIN_SHARE",
    "MIN_BENEFIT",
    "MINOR_SHARE",
    "MINOR_SHARE_AT_NOISE",
    "EQUIVALENT_GAIN",
    "OUT_OF_CLASS_GAIN",
    "COMPARABLE_SCORE",
    "SIMILAR_SCORE",
    "PARTLY_ERROR",
    "PARTLY_SHARE",
)
# Nothing that is asked with --quick.
VARIED_FULL = ("PAIR_SHARE", "PAIR_PROMISE", "CHANGE_GAIN", "OUTLIER_GAIN")


@contextmanager
def varied(name: str, factor: float) -> Iterator[None]:
    """Multiply one setting by a factor."""
    before = getattr(settings, name)
    setattr(settings, name, factor * before)
    try:
        yield
    finally:
        setattr(settings, name, before)


def variants(full: bool) -> list[tuple[str, str, float]]:
    """(label, setting, factor); the first is the program as it is."""
    names = VARIED + (VARIED_FULL if full else ())
    return [(AS_IT_IS, names[0], 1.0)] + [
        (f"{name} {word}", name, factor) for name in names for word, factor in (("halved", 0.5), ("doubled", 2.0))
    ]


def play(hidden: Hidden, *, full: bool) -> dict[str, Any]:
    """The answers to one campaign, by variant."""
    row: dict[str, Any] = {"part": hidden.part, "seed": hidden.seed, "grade": hidden.grade, "full": full}
    row |= {"truths": {**hidden.effects, **hidden.outside}, "program": program_digest(), "answers": {}}
    with tempfile.TemporaryDirectory(prefix="sensitivity-") as scratch:
        try:
            record_hidden(Path(scratch), hidden, quick=True)
        except (Grounded, Refused) as reason:
            return row | {"refused": str(reason)}
        campaign = load(Path(scratch))
        records, judges = read_campaign(campaign), read_campaign(campaign, use="judge")
        with remembered():
            for label, name, factor in variants(full):
                with varied(name, factor):
                    options = Options(quick=not full, share=settings.MIN_SHARE, workers=1)
                    result = diagnose_records(campaign, records, judges, options)
                row["answers"][label] = _judgement(hidden, read_answer(json.loads(json.dumps(to_json(result)))))
    return row


def _judgement(hidden: Hidden, answer: Answer) -> dict[str, Any]:
    lenient = any(OUTSIDE[name].may_be_adequate for name in hidden.outside)
    truths = (*hidden.effects, *(OUTSIDE[name].cause or name for name in hidden.outside))
    judgement = judge(hidden.part, truths, answer, may_be_adequate=lenient)
    return {
        "verdict": answer.verdict,
        "named": [cause.name for cause in answer.causes],
        "right": judgement.right,
        "found": judgement.hits,
        "truths": judgement.truths,
        "false_names": judgement.false_names,
    }


def draw() -> Iterator[tuple[Part, int]]:
    """(part, seed) without end."""
    counts = dict.fromkeys((part for part, _ in TURN), 0)
    while True:
        for part, count in TURN:
            for _ in range(count):
                yield part, FIRST + counts[part]
                counts[part] += 1


def table(rows: list[Mapping[str, Any]], full: bool) -> str:
    """Markdown: each variant that changes an answer, with 95 % intervals after Wilson for the program as it is."""
    rows = [row for row in rows if row["full"] == full and row.get("answers")]
    rows_of = {part: [row for row in rows if row["part"] == part] for part, _ in TURN}
    lines, same = [], []
    head = [
        "| setting | one cause: right | its false names | nothing hidden: false names | unknown-cause "
        "| outside: false names | composites: truths found | its false names |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for label, _, _ in variants(full):
        if label != AS_IT_IS and all(_same(row["answers"][label], row["answers"][AS_IT_IS]) for row in rows):
            same.append(label)
            continue
        answers = {part: [row["answers"][label] for row in rows_of[part]] for part in rows_of}
        tested = [answer for answer in answers["causes"] if answer["right"] is not None]
        nulls, outside, several = answers["nulls"], answers["outside"], answers["composites"]
        cells = (
            (sum(answer["right"] for answer in tested), len(tested)),
            (sum(answer["false_names"] > 0 for answer in tested), len(tested)),
            (sum(bool(answer["named"]) for answer in nulls), len(nulls)),
            (sum(answer["verdict"] == UNKNOWN for answer in nulls), len(nulls)),
            (sum(answer["false_names"] > 0 and answer["verdict"] != UNKNOWN for answer in outside), len(outside)),
            (sum(answer["found"] for answer in several), sum(answer["truths"] for answer in several)),
            (sum(answer["false_names"] > 0 for answer in several), len(several)),
        )
        lines.append(f"| {label} | " + " | ".join(_cell(*cell, wide=label == AS_IT_IS) for cell in cells) + " |")
    played = ", ".join(f"{len(rows_of[part])} {part}" for part in rows_of)
    both = [
        label.split()[0] for label in same if label.endswith("halved") and label.replace("halved", "doubled") in same
    ]
    same = both + [label for label in same if label.split()[0] not in both]
    return "\n".join([played, "", *head, *lines, "", f"No answer changes: {', '.join(same)}."])


def _same(first: Mapping[str, Any], other: Mapping[str, Any]) -> bool:
    return bool(first["verdict"] == other["verdict"] and first["named"] == other["named"])


def _cell(hits: int, count: int, *, wide: bool) -> str:
    low, high = wilson(hits, count)
    return f"{hits} of {count}" + f" ({100 * low:.0f} .. {100 * high:.0f} %)" * wide


def changes(rows: list[Mapping[str, Any]], full: bool) -> str:
    """Each campaign whose answer differs from that of the program as it is."""
    lines = []
    for row in rows:
        if row["full"] != full or not row.get("answers"):
            continue
        base = row["answers"][AS_IT_IS]
        for label, answer in row["answers"].items():
            if not _same(answer, base):
                lines.append(
                    f"{row['part']} {row['seed']} ({', '.join(row['truths']) or 'nothing'}): "
                    f"{base['verdict']} {base['named']} -> {label}: {answer['verdict']} {answer['named']}"
                )
    return "\n".join(lines)


def main() -> None:
    """Play what fits into the time, then print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--results", type=Path, required=True, metavar="FILE", help="JSON lines, made or continued")
    parser.add_argument("--minutes", type=float, default=0.0, metavar="M", help="begin no campaign after M minutes (0)")
    parser.add_argument("--full", action="store_true", help="diagnose without --quick")
    parser.add_argument("--changes", action="store_true", help="print each answer that a variant changes")
    args = parser.parse_args()
    rows = [json.loads(line) for line in args.results.read_text().splitlines()] if args.results.exists() else []
    known = {(row["part"], row["seed"]) for row in rows if row["full"] == args.full}
    until = time.monotonic() + 60.0 * args.minutes
    for part, seed in draw():
        if time.monotonic() >= until:
            break
        if (part, seed) in known:
            continue
        began = time.monotonic()
        row = play(draw_hidden(seed, part), full=args.full)
        rows.append(row)
        with args.results.open("a", encoding="utf-8") as file:
            file.write(json.dumps(row) + "\n")
        answer = row["answers"].get(AS_IT_IS, {})
        took = time.monotonic() - began
        print(f"{part} {seed}: {answer.get('verdict')} {answer.get('named')} ({took:.0f} s)", flush=True)
    print(table(rows, args.full))
    if args.changes:
        print(changes(rows, args.full))


if __name__ == "__main__":
    main()
