"""The answers of a tree to one case, through the commands that a user types."""

from __future__ import annotations

import csv
import hashlib
import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

from tests.references.cases import Case, flown_log

TIMEOUT_S = 1800.0
Answers = dict[str, Any]  # by command


def answers(case: Case, tree: Path, folder: Path, data: Path) -> Answers:
    """Make the campaign, ask everything about it.

    Args:
        case: Which one.
        tree: Checkout whose commands answer.
        folder: Scratch, empty.
        data: The measurements.

    Raises:
        RuntimeError: A command ended as no command should (traceback, no file).
    """
    if case.make is not None:
        campaign = folder / "campaign"
        case.make(campaign)
        more = []
    else:
        campaign = tree / case.campaign
        more = ["--data", str(data)]
    results: Answers = {}

    def run(name: str, *arguments: str, result: Path | None = None) -> None:
        results[name] = _run_command(tree, [name, *arguments, *case.options.get(name, ())], result)

    model = folder / "model.json"
    run("identify", str(campaign), *more, "--quiet", "--out", str(model), result=model)
    if model.exists():
        out = folder / "validation"
        run("validate", str(campaign), *more, "--model", str(model), "--out", str(out), result=out / "validation.json")
        run("design", str(model), "--json")
    out = folder / "diagnosis"
    quick = ["--quick"] if case.quick else []
    threads = ["--workers", "1"]  # cases run side by side
    run("diagnose", str(campaign), *more, "--out", str(out), *quick, *threads, result=out / "diagnosis.json")
    extended = out / "extended_model.json"
    if extended.exists():
        results["extended_model"] = json.loads(extended.read_text(encoding="utf-8"))
        flight = campaign / "closed_loop_6.csv.gz"
        if flight.exists():
            rows = folder / "predicted.csv"
            common = (str(extended), str(flight), "--campaign", str(campaign), "--horizon", "10")
            run("predict", *common, "--out", str(rows), "--json")
            results["predict"]["rows"] = _rows(rows)
    return results


def twin_answers(tree: Path, folder: Path) -> Answers:
    """The twin over a log of two boards."""
    log = folder / "flown.mcap"
    flown_log(log)
    return {"twin": _run_command(tree, ["twin", "--log", str(log), "--json"], None)}


def _run_command(tree: Path, arguments: list[str], result: Path | None) -> dict[str, Any]:
    """Exit code, and the JSON that the command printed or wrote."""
    environment = {name: value for name, value in os.environ.items() if not name.startswith("BOARD51_")}
    # One thread in each library: the order of a sum must not depend on how busy the machine is.
    environment |= {name: "1" for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS")}
    environment |= {"PYTHONPATH": str(tree), "MPLBACKEND": "Agg"}
    process = subprocess.run(
        [sys.executable, "-m", "board51", *arguments],
        cwd=tree,
        env=environment,
        capture_output=True,
        text=True,
        timeout=TIMEOUT_S,
        check=False,
    )
    text = process.stdout if result is None else result.read_text(encoding="utf-8") if result.exists() else "null"
    if "Traceback" in process.stderr:
        raise RuntimeError(f"board51 {' '.join(arguments)}: {process.stderr.strip().splitlines()[-1]}")
    error = process.stderr.strip().splitlines()[-1] if process.returncode == 2 else ""
    return {"exit": process.returncode, "said": error, "json": json.loads(text or "null")}


def _rows(path: Path) -> dict[str, Any]:
    """A digest of all rows, and a few of them to see how far they are apart when it differs."""
    with path.open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    every = max(1, len(rows) // 20)
    return {
        "count": len(rows),
        "sha256": hashlib.sha256(path.read_bytes()).hexdigest(),
        "some": [{name: float(value) for name, value in row.items()} for row in rows[::every]],
    }
