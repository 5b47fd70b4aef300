"""Name the cause: programs of anybody answer the same hidden campaigns, and one table scores them.

docs/howto/benchmark.md has the format of cases and answers.
"""

from __future__ import annotations

import math
import shlex
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from protocol.errors import DataError, UsageError
from tests.harness.diagnose.trial import ROOT, TIMEOUT_S, clean_environment
from tests.harness.truth.answer import read_answer
from tests.harness.truth.draw import Truth, draw_set, load_truths
from tests.harness.truth.entries import ENTRIES
from tests.harness.truth.flights import error_m
from tests.harness.truth.residual import absent_pysindy
from tests.harness.truth.score import Score, score, table, unanswered

DEFAULT_RUNS = 4
BASE = "base"  # whose errors the others remove


def run(
    runs: int | None = None,
    seed: int | None = None,
    part: str | None = None,
    out: Path | None = None,
    entry: Sequence[str] | None = None,
    draw: bool | None = None,
    quick: bool | None = None,
    show: Callable[[str], None] | None = None,
) -> list[dict[str, Any]]:
    """The rows of the benchmark.

    Args:
        runs: Cases, of a set that is there the first ones; default: 4, or all of such a set.
        seed: Of the set; a contest takes a secret one.
        part: causes | forms | nulls | outside | composites; default: a mix.
        out: Folder of the set and the answers: drawn if it is empty, else used as it is; default: deleted.
        entry: Names of entries, or NAME=COMMAND; default: all of ours.
        draw: Only draw.
        quick: Short recordings.
        show: Takes the table.

    Raises:
        UsageError: an unknown entry or part.
        DataError: the set was changed.
    """
    with tempfile.TemporaryDirectory(prefix="truth-") as scratch:
        folder = out or Path(scratch)
        if draw or not (folder / "manifest.json").exists():
            draw_set(folder, seed=seed or 0, count=runs or DEFAULT_RUNS, part=part, quick=bool(quick))
        truths = load_truths(folder)[: runs or None]
        if draw:
            return []
        commands = _commands(entry or ENTRIES)
        why_not = absent_pysindy() if "pysindy" in commands else ""
        if why_not:
            del commands["pysindy"]
        scores = _scores(folder, truths, {BASE: _commands([BASE])[BASE]} | commands)
    if show is not None:
        show(f"\n{len(truths)} cases\n\n{table({name: scores[name] for name in commands})}")
        if why_not:
            show(f"pysindy left out: {why_not}")
    return [_row(name, scores) for name in commands]


def answer_case(command: Sequence[str], case: Path, answer_folder: Path) -> None:
    """Run an entry on a copy of the case, with nothing of the set beside it; its answer is kept.

    Raises:
        DataError: the program fails or takes more than 15 minutes of processor time.
    """
    with tempfile.TemporaryDirectory(prefix="case-") as scratch:
        copy, out = Path(scratch) / "case", Path(scratch) / "out"
        shutil.copytree(case, copy)
        out.mkdir()
        # A limit of processor time: a busy machine fails nobody.
        line = ["prlimit", f"--cpu={TIMEOUT_S:.0f}", *command, str(copy), str(out)]
        environment = clean_environment() | {"PYTHONPATH": str(ROOT)}
        process = subprocess.run(line, env=environment, capture_output=True, text=True, check=False)
        if process.returncode:
            last = process.stderr.strip().splitlines()[-1:] or [""]
            raise DataError(
                f"{shlex.join(command)} ended with {process.returncode}: {last[0]}", remedy="Run it by hand on a case"
            )
        shutil.copytree(out, answer_folder)


def _commands(entries: Sequence[str]) -> dict[str, list[str]]:
    """Command by name; an empty command: the answers are in the folder."""
    commands = {}
    for entry in entries:
        name, _, command = entry.partition("=")
        if not command and name in ENTRIES:
            commands[name] = [sys.executable, "-m", "tests.harness.truth.entries", name]
        elif name.replace("-", "").isalnum():
            commands[name] = shlex.split(command)
        else:
            raise UsageError(f"--entry {entry}: no name", remedy=f"Give NAME=COMMAND, or of {', '.join(ENTRIES)}")
    return commands


def _scores(folder: Path, truths: Sequence[Truth], commands: dict[str, list[str]]) -> dict[str, list[Score]]:
    """Scores by entry, each in the order of the cases."""
    scores: dict[str, list[Score]] = {name: [] for name in commands}
    for truth in truths:
        base_m = math.nan
        for name, command in commands.items():
            case, answer_folder = folder / truth.case, folder / "answers" / name / truth.case
            try:
                if command and not answer_folder.exists():
                    answer_case(command, case, answer_folder)
                answer, predicted = read_answer(answer_folder)
                error = error_m(case, predicted)
                base_m = error if name == BASE else base_m
                scores[name].append(score(truth, answer, base_m=base_m, error_m=error))
            except DataError as problem:
                print(f"{truth.case} {name}: {problem}", file=sys.stderr)
                scores[name].append(unanswered(truth, base_m=base_m))
    return scores


def _row(name: str, scores: dict[str, list[Score]]) -> dict[str, Any]:
    mine, base = (sum(s.log_score for s in scores[entry]) / len(scores[entry]) for entry in (name, BASE))
    return {
        "name": f"truth: {name}: log score",
        "value": mine,
        "unit": "nat",
        "baseline": base,
        "ratio": mine / base,
        "note": f"{sum(s.answered for s in scores[name])} of {len(scores[name])} cases answered",
    }
