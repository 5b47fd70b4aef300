"""Time on the rig to the answer: `board51 investigate` against `campaign run` and `diagnose`, on the same hidden rigs.

Each rig is an emulated board with one strong effect behind a real gateway; both ways are commands as a user types them,
and end with a thorough diagnosis.  Time is the board's, from the first command to the last.
"""

from __future__ import annotations

import json
import os
import statistics
import subprocess
import sys
import tempfile
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from tests.harness.diagnose.draws import draw_hidden
from tests.harness.gateway.campaign_line import ROOT, emulated_line

DEFAULT_RUNS = 3
SPEED = 3.0  # times real time
TIMEOUT_S = 3600.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Way:
    """The rig time and the recordings that one way took, and its answer."""

    rig_s: float
    recordings: int
    verdict: str
    named: list[list[str]]  # each with those that cannot be told from it

    def has(self, truth: str) -> bool:
        """Return whether that name, or a class that holds it, was named and nothing else was."""
        return len(self.named) == 1 and truth in self.named[0]


def run(
    runs: int | None = None,
    seed: int | None = None,
    results: Path | None = None,
    quick: bool | None = None,
    show: Callable[[str], None] = lambda line: None,
) -> list[dict[str, Any]]:
    """The rows of the benchmark.

    Args:
        runs: rigs; default 3.
        seed: of the first.
        results: file to which each rig adds a line of JSON.
        quick: short recordings, and no thorough diagnosis.
        show: takes a line for each rig.
    """
    investigations, whole = [], []
    truths = []
    for number in range(seed or 0, (seed or 0) + (runs or DEFAULT_RUNS)):
        ((truth, strength),) = draw_hidden(number, "gateway").effects.items()
        first, other = _investigated({truth: strength}, quick=bool(quick)), _whole({truth: strength}, quick=bool(quick))
        truths.append(truth)
        investigations.append(first)
        whole.append(other)
        show(f"{truth}={strength:.3g}: {_words(first)}; campaign and diagnosis: {_words(other)}")
        if results is not None:
            with results.open("a", encoding="utf-8") as file:
                file.write(json.dumps({"truth": truth, "investigate": asdict(first), "campaign": asdict(other)}) + "\n")
    return [
        _row("time on the rig, median", "s", [way.rig_s for way in investigations], [way.rig_s for way in whole]),
        _row("recordings, median", "1", [way.recordings for way in investigations], [way.recordings for way in whole]),
        _row(
            "named rightly, of all",
            "1",
            [float(way.has(truth)) for way, truth in zip(investigations, truths, strict=True)],
            [float(way.has(truth)) for way, truth in zip(whole, truths, strict=True)],
            of=statistics.fmean,
        ),
    ]


def _row(
    name: str,
    unit: str,
    values: list[float],
    baselines: list[float],
    of: Callable[[list[float]], float] = statistics.median,
) -> dict[str, Any]:
    value, baseline = of(values), of(baselines)
    return {
        "name": f"investigate: {name}",
        "value": value,
        "unit": unit,
        "baseline": baseline,
        "ratio": value / baseline if baseline else None,
        "note": f"{len(values)} hidden rigs; baseline: campaign run and diagnose",
    }


def _words(way: Way) -> str:
    named = ", ".join(" or ".join(names) for names in way.named) or "nothing"
    return f"{way.rig_s:.0f} s, {way.recordings} recordings, {way.verdict}: {named}"


def _investigated(effects: Mapping[str, float], *, quick: bool) -> Way:
    with (
        tempfile.TemporaryDirectory(prefix="rig-") as scratch,
        emulated_line(Path(scratch), speed=SPEED, effects=effects) as line,
    ):
        folder, bus = Path(scratch) / "i", ["--connect", line.endpoint, "--plant", str(line.plant)]
        table = _call("investigate", "rig", "--out", str(folder), *bus, "--json", *["--quick"] * quick)
        return _way(table["rig_s"], table["answer"], folder)


def _whole(effects: Mapping[str, float], *, quick: bool) -> Way:
    with tempfile.TemporaryDirectory(prefix="rig-") as scratch:
        folder = Path(scratch) / "c"
        with emulated_line(Path(scratch), speed=SPEED, effects=effects) as line:
            bus = ["--connect", line.endpoint, "--plant", str(line.plant)]
            table = _call("campaign", "run", str(folder), "--board", "rig", *bus, "--json", *["--quick"] * quick)
        out = str(Path(scratch) / "answer")
        return _way(
            table["rig_s"], _call("diagnose", str(folder), "--out", out, "--json", *["--quick"] * quick), folder
        )


def _way(rig_s: float, diagnosis: Mapping[str, Any], folder: Path) -> Way:
    return Way(
        rig_s=rig_s,
        recordings=len(list(folder.glob("*.mcap"))),
        verdict=diagnosis["verdict"],
        named=[[cause["name"], *cause["indistinguishable_from"]] for cause in diagnosis["causes"]],
    )


def _call(*words: str) -> dict[str, Any]:
    """Return the JSON that a command prints, whatever its exit code says of the answer."""
    process = subprocess.run(
        [sys.executable, "-m", "board51", *words],
        cwd=ROOT, env={**os.environ, "PYTHONPATH": str(ROOT)}, capture_output=True, text=True, timeout=TIMEOUT_S,
        check=False,
    )  # fmt: skip
    try:
        table: dict[str, Any] = json.loads(process.stdout)
    except ValueError:
        raise RuntimeError(
            f"board51 {' '.join(words)} ended with {process.returncode}: {process.stderr[-500:]}"
        ) from None
    return table
