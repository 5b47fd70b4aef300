"""The whole matrix: does `board51 diagnose` name what was hidden?  Rates against the targets, confusion, reliability.

Trials run in two processes; each recorded campaign goes to `board51 diagnose` as a folder and is then deleted.
Results are lines of JSON: a run that was stopped goes on where it was; those of another state of the code are not
counted.
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor, as_completed
from multiprocessing import get_context
from pathlib import Path
from typing import Any

from protocol.errors import DataError, UsageError
from tests.harness.diagnose.draws import PARTS, Part, draw_hidden
from tests.harness.diagnose.scoring import Outcome
from tests.harness.diagnose.tally import page, rates, removed_median, seconds
from tests.harness.diagnose.trial import program_digest, run_trial

WORKERS = 2
DEFAULT_RUNS = 2  # per part: what a benchmark among others may take
# --runs 0: each cause twice at each strength, each effect outside three times
WHOLE = {"causes": 156, "nulls": 60, "composites": 30, "outside": 36, "gateway": 26, "forms": 54, "knock-out": 48}


def run(
    runs: int | None = None,
    seed: int | None = None,
    part: str | None = None,
    results: Path | None = None,
    quick: bool | None = None,
    show: Callable[[str], None] | None = None,
) -> list[dict[str, Any]]:
    """The rows of the benchmark.

    Args:
        runs: Trials per part; 0: the whole matrix; default 2.
        seed: Of the first trial; the next has the next number.
        part: causes | nulls | composites | outside | gateway | forms | knock-out; default all but `gateway`.
        results: File of JSON lines, made or continued; default: not kept.
        quick: Short campaigns and `diagnose --quick`.
        show: Takes the page of results.

    Raises:
        UsageError: an unknown part, a negative number.
        DataError: the results cannot be read or written.
    """
    if part is not None and part not in PARTS:
        raise UsageError(f"There is no part {part!r}", remedy=f"Choose from {', '.join(PARTS)}")
    if (runs or 0) < 0 or (seed or 0) < 0:
        raise UsageError(f"--runs {runs}, --seed {seed}: a negative number", remedy="Give whole numbers from 0")
    first = seed or 0
    program = program_digest()
    trials = [
        (each, first + n)
        for each in PARTS
        if part == each or (part is None and each != "gateway")
        for n in range((WHOLE[each] if runs == 0 else runs) if runs is not None else DEFAULT_RUNS)
    ]
    outcomes = play(trials, program=program, quick=bool(quick), results=results)
    if show is not None:
        show(f"\nprogram {program}, seeds {first} on{', quick' if quick else ''}\n\n{page(outcomes)}")
    return _rows(outcomes)


def play(
    trials: list[tuple[Part, int]], *, program: str, quick: bool = False, results: Path | None = None
) -> list[Outcome]:
    """The outcomes of these (part, seed), in this order; those in `results` are not run again."""
    known = {
        (o.part, o.seed): o
        for o in _read(results)
        if o.program == program and o.quick == quick and o.status != "failed"
    }
    missing = [key for key in trials if key not in known]
    began = time.monotonic()
    with ProcessPoolExecutor(WORKERS, mp_context=get_context("spawn")) as pool:
        running = {
            pool.submit(run_trial, draw_hidden(seed, part), program=program, quick=quick) for part, seed in missing
        }
        for n, future in enumerate(as_completed(running), 1):
            outcome = future.result()
            known[(outcome.part, outcome.seed)] = outcome
            _append(results, outcome)
            print(
                f"[{time.monotonic() - began:6.0f} s] {n}/{len(missing)} {_line(outcome)}", file=sys.stderr, flush=True
            )
    return [known[key] for key in trials]


def _line(o: Outcome) -> str:
    truth = " + ".join(f"{name}={value:.3g}" for name, value in zip(o.truths, o.strengths, strict=True)) or "nothing"
    small = "".join(f", too small {name}" for name, _ in o.minor_effects)
    answer = o.message if o.status != "answered" else f"{o.verdict}: {', '.join(o.named) or '-'}{small}"
    mark = "?" if o.judgement is None or o.judgement.right is None else "+" if o.judgement.right else "-"
    return f"{mark} {o.part} {o.seed} {o.plant}: {truth} -> {answer} ({o.diagnose_s:.0f} s)"


def _rows(outcomes: list[Outcome]) -> list[dict[str, Any]]:
    rows: list[dict[str, Any]] = []
    for rate in rates(outcomes):
        low, high = rate.interval
        rows.append(
            {
                "name": f"diagnosis: {rate.name}",
                "value": rate.value if rate.count else None,
                "unit": "1",
                "baseline": rate.target,
                "ratio": rate.value / rate.target if rate.count and rate.target else None,
                "note": f"{rate.hits} of {rate.count}, 95 % {low:.2f} .. {high:.2f}"
                + (f"; {rate.note}" * bool(rate.note)),
            }
        )
    share, count = removed_median(outcomes)
    middle, longest, _ = seconds(outcomes)
    for name, value, unit, target, note in (
        ("excess removed on judge data, median", share, "1", 0.9, f"{count} campaigns named rightly"),
        ("time of a diagnosis, median", middle, "s", 60.0, f"longest {longest:.1f} s; one thread each, two at a time"),
    ):
        if value == value:  # there was something to take the median of
            rows.append(
                {
                    "name": f"diagnosis: {name}",
                    "value": value,
                    "unit": unit,
                    "baseline": target,
                    "ratio": value / target,
                    "note": note,
                }
            )
    return rows


def _read(results: Path | None) -> list[Outcome]:
    if results is None or not results.exists():
        return []
    try:
        lines = results.read_text(encoding="utf-8").splitlines()
        return [Outcome.from_json(json.loads(line)) for line in lines if line.endswith("}")]
    except (OSError, ValueError, TypeError, KeyError) as problem:
        raise DataError(f"{results} is not a file of results ({problem})", remedy="Name another file") from None


def _append(results: Path | None, outcome: Outcome) -> None:
    if results is None:
        return
    try:
        # A run that was killed may have left half a line.
        torn = results.exists() and not results.read_bytes().endswith(b"\n") and results.stat().st_size > 0
        with results.open("a", encoding="utf-8") as file:
            file.write("\n" * torn + json.dumps(outcome.to_json()) + "\n")
    except OSError as error:
        raise DataError(f"{results} cannot be written ({error.strerror})", remedy="Give a writable path") from None
