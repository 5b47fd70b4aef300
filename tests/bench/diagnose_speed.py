"""The time that `diagnose` takes on a campaign of 90 s, full and quick, and the share of each stage.

Wall time is what a user waits for; processor time is what it costs where other programs have the cores.  Targets: 60 s
full and 10 s quick, on two free cores.  And what a filter step takes, of which a budget is made, on recordings of a rig
that the model does not fit; its baseline is what twin/diagnosis/matrix.md states.
"""

from __future__ import annotations

import tempfile
import time
from pathlib import Path
from typing import Any

from protocol.campaign import load
from tests.harness.diagnose.foreign import hall_campaign
from tests.harness.diagnose.hidden_campaign import make_campaign
from twin.diagnosis.options import Options
from twin.diagnosis.pipeline import diagnose
from twin.diagnosis.residuals.summary import summarise

EFFECT = {"quadratic-drag": 1.0}
SEED = 104
STEP_S = 1e-7  # of processor time, the whole diagnosis divided by its filter steps
TARGETS_S = {"full": 60.0, "quick": 10.0}


def run(quick: bool | None = None) -> list[dict[str, Any]]:
    """The rows of the benchmark.

    Args:
        quick: Only `--quick`.
    """
    rows: list[dict[str, Any]] = []
    with tempfile.TemporaryDirectory(prefix="speed-") as scratch:
        folder, short = Path(scratch) / "campaign", Path(scratch) / "short"
        make_campaign(folder, effects=EFFECT, seed=SEED, plant="independent")
        make_campaign(short, effects=EFFECT, seed=SEED, plant="independent", quick=True)
        diagnose(load(short), Options(quick=True))  # compiles, or loads the compiled kernels
        for mode in ("quick",) if quick else ("quick", "full"):
            rows += _rows(folder, mode)
        rows.append(_step(hall_campaign(Path(scratch) / "foreign")))
    return rows


def _step(foreign: Path) -> dict[str, Any]:
    cpu = time.process_time()
    diagnosis = diagnose(load(foreign), Options(quick=True))
    cpu_s = time.process_time() - cpu
    value = cpu_s / diagnosis.budget.spent
    return {
        "name": "diagnose quick, six foreign recordings: processor time of a filter step",
        "value": value,
        "unit": "s",
        "baseline": STEP_S,
        "ratio": STEP_S / value,
        "note": f"{cpu_s:.1f} s in all, {100.0 * diagnosis.budget.used:.0f} % of the budget; {diagnosis.verdict}",
    }


def _rows(folder: Path, mode: str) -> list[dict[str, Any]]:
    campaign = load(folder)
    wall, cpu = time.perf_counter(), time.process_time()
    diagnosis = diagnose(campaign, Options(quick=mode == "quick"))
    between = time.perf_counter()
    summarise(diagnosis, campaign.controller, quick=mode == "quick", seed=0)
    wall_s, cpu_s = time.perf_counter() - wall, time.process_time() - cpu
    stages = {**diagnosis.stages_s, "pictures": time.perf_counter() - between}
    target = TARGETS_S[mode]
    shares = ", ".join(f"{name} {100.0 * took / wall_s:.0f} %" for name, took in stages.items())
    named = ", ".join(cause.name for cause in diagnosis.causes) or diagnosis.verdict
    return [
        {
            "name": f"diagnose {mode}: {what}",
            "value": value,
            "unit": "s",
            "baseline": target,
            "ratio": target / value,
            "note": note,
        }
        for what, value, note in (
            ("wall time", wall_s, f"baseline is the target; {named}; {shares}"),
            ("processor time", cpu_s, "of all threads: half of it on two free cores, where the work is shared"),
        )
    ]


if __name__ == "__main__":
    for row in run():
        print(row)
