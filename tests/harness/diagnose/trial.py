"""A trial: hide an effect in a folder, give `board51 diagnose` that folder and nothing else, judge the answer."""

from __future__ import annotations

import hashlib
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

from tests.harness.diagnose.agreement import disagreements
from tests.harness.diagnose.draws import Hidden, in_the_data, record_hidden
from tests.harness.diagnose.hidden_campaign import Grounded, Refused
from tests.harness.diagnose.outside import OUTSIDE
from tests.harness.diagnose.scoring import ADEQUATE, Outcome, judge, read_answer

ROOT = Path(__file__).parents[3]
TIMEOUT_S = 900.0


def program_digest() -> str:
    """Return a digest of the code that decides; results of different programs are never counted together."""
    digest = hashlib.sha256()
    for folder in ("diagnosis", "estimation", "evidence", "identification", "inference", "model", "settings"):
        for path in sorted((ROOT / "twin" / folder).rglob("*.py")):
            digest.update(path.relative_to(ROOT).as_posix().encode() + b"\0" + path.read_bytes())
    return digest.hexdigest()[:12]


def diagnose_command(campaign: Path, out: Path, *, quick: bool = False, without: Sequence[str] = ()) -> list[str]:
    """Return the command that a user would type; one thread, because trials run side by side."""
    return [
        *(sys.executable, "-m", "board51", "diagnose", str(campaign), "--out", str(out), "--workers", "1"),
        *(["--quick"] if quick else []),
        *(f"--without={name}" for name in without),
    ]


def clean_environment() -> dict[str, str]:
    """Return the environment without the variables that point at other data; the libraries' own threads are off."""
    retained = {name: value for name, value in os.environ.items() if not name.startswith("BOARD51_")}
    return retained | {
        "OMP_NUM_THREADS": "1",
        "OPENBLAS_NUM_THREADS": "1",
        "NUMBA_NUM_THREADS": "1",
        "MPLBACKEND": "Agg",
    }


def run_trial(hidden: Hidden, *, program: str, quick: bool = False, keep: Path | None = None) -> Outcome:
    """Record, diagnose, judge.

    Args:
        hidden: What to hide.
        program: Digest of the code that answers, for the results.
        quick: A short campaign and `diagnose --quick`.
        keep: Folder in which campaign and answer stay; default: deleted.
    """
    with tempfile.TemporaryDirectory(prefix="trial-") as scratch:
        folder = keep or Path(scratch)
        return _run(hidden, folder, program=program, quick=quick)


def _run(hidden: Hidden, folder: Path, *, program: str, quick: bool) -> Outcome:
    effects = {**hidden.effects, **hidden.outside}

    def outcome(status: str, **more: object) -> Outcome:
        fields: dict[str, object] = {
            "part": hidden.part,
            "seed": hidden.seed,
            "program": program,
            "quick": quick,
            "plant": hidden.plant,
            "grade": hidden.grade,
            "truths": tuple(effects),
            "strengths": tuple(effects.values()),
            "status": status,
        }
        return Outcome(**(fields | more))  # type: ignore[arg-type]  # one list of fields for four endings

    began = time.monotonic()
    campaign, out = folder / "campaign", folder / "out"
    try:
        record_hidden(campaign, hidden, quick=quick)
    except Grounded as reason:
        return outcome("grounded", message=str(reason))
    except Refused as reason:
        return outcome("refused", message=str(reason))
    recorded = time.monotonic()
    try:
        process = subprocess.run(
            diagnose_command(campaign, out, quick=quick, without=hidden.without),
            cwd=ROOT,
            env=clean_environment(),
            capture_output=True,
            text=True,
            timeout=TIMEOUT_S,
            check=False,
        )
    except subprocess.TimeoutExpired:
        return outcome("failed", record_s=recorded - began, message=f"no answer within {TIMEOUT_S:g} s")
    took = {"record_s": recorded - began, "diagnose_s": time.monotonic() - recorded}
    try:
        data = json.loads((out / "diagnosis.json").read_text(encoding="utf-8"))
        answer, contradictions = read_answer(data), disagreements(data)
    except (OSError, ValueError, KeyError, TypeError) as problem:
        last = process.stderr.strip().splitlines()[-1:] or [""]
        return outcome("failed", **took, message=f"exit {process.returncode}: {last[0]} ({type(problem).__name__})")
    if contradictions:
        return outcome("failed", **took, message=f"the answer contradicts itself: {'; '.join(contradictions)}")
    # Asked only of an answer that finds nothing: a limit beyond every recorded current is no effect on the data.
    is_tested = hidden.part == "causes" and answer.verdict == ADEQUATE and not answer.causes
    present = not is_tested or in_the_data(hidden, folder / "again")
    lenient = any(OUTSIDE[name].may_be_adequate for name in hidden.outside)
    truths = tuple(OUTSIDE[name].cause or name if name in OUTSIDE else name for name in effects)
    return outcome(
        "answered",
        **took,
        verdict=answer.verdict,
        named=tuple(cause.name for cause in answer.causes),
        not_testable=answer.not_testable,
        minor_effects=answer.minor_effects,
        judgement=judge(hidden.part, truths, answer, may_be_adequate=lenient, in_the_data=present),
    )
