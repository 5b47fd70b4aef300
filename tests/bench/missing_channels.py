"""The cost of each missing channel or experiment, on recordings of a rig with a known cause, less and less of them.

The campaign of `hidden_campaign.py` is recorded once for each hidden cause, on the second plant; each variant leaves
something out, and `identify` and `diagnose --quick` get what is left.  It makes the table of docs/howto/foreign.md.
"""

from __future__ import annotations

import csv
import gzip
import shutil
import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

from gateway.emulator.plant.effects import EFFECTS
from protocol.campaign import Campaign, Recording, load
from protocol.errors import DataError
from tests.harness.diagnose.hidden_campaign import make_campaign
from twin.diagnosis.options import Options
from twin.diagnosis.pipeline import diagnose
from twin.diagnosis.result import Diagnosis
from twin.identification.pipeline import identify

SEED = 104
HIDDEN = ("amplifier-dead-zone", "position-sensor-lag", "quadratic-drag", "air-gap-offset")  # strong; "": nothing
Rows = list[dict[str, str]]


class Variant(NamedTuple):
    """The part of a campaign that a variant keeps."""

    name: str
    keeps: Callable[[Recording], bool] = lambda recording: True
    edits: Callable[[Rows, Recording], Rows] = lambda rows, recording: rows


def _flight(recording: Recording) -> bool:
    return recording.kind == "closed-loop"


def _every_second(rows: Rows, recording: Recording) -> Rows:
    return rows if recording.kind == "amplifier-step" else rows[::2]


def _current_from_input(rows: Rows, recording: Recording) -> Rows:
    return [{**row, "i_c": row["u_c"]} for row in rows]  # the user's guess of K_A: 1 A/V


def _held_input(rows: Rows, recording: Recording) -> Rows:
    """The logger stores u_c at every fifth sample only."""
    return [{**row, "u_c": rows[n - n % 5]["u_c"]} for n, row in enumerate(rows)]


VARIANTS = (
    Variant("everything"),
    Variant("without amplifier steps", lambda recording: recording.kind != "amplifier-step"),
    Variant("without lift-offs", lambda recording: recording.kind != "sawtooth"),
    Variant("without the coil at rest", lambda recording: recording.kind != "free"),
    Variant("flights only", _flight),
    Variant("flights only, every second sample", _flight, _every_second),
    Variant("flights only, u_c held for five samples", _flight, _held_input),
    Variant("flights only, i_c computed from u_c", _flight, _current_from_input),
    Variant("two flights to fit", lambda r: not _flight(r) or r.use == "judge" or r.file[12] in "12"),
    Variant("no flight to judge", lambda r: not (_flight(r) and r.use == "judge")),
)


def run(
    part: str | None = None, results: Path | None = None, show: Callable[[str], None] | None = None
) -> list[dict[str, Any]]:
    """The rows of the benchmark, one for each variant and hidden cause.

    Args:
        part: Only this hidden cause; default all.
        results: Takes the table in Markdown.
        show: Takes each line of it.
    """
    lines = ["| left | hidden | found | K_A | T_A | K_c | b | s |", "|---|---|---|---|---|---|---|---|"]
    rows: list[dict[str, Any]] = []
    with tempfile.TemporaryDirectory(prefix="missing-") as scratch:
        for hidden in ("", *HIDDEN) if part is None else (part,):
            whole = Path(scratch) / (hidden or "nothing")
            effects = {hidden: EFFECTS[hidden].strong} if hidden else {}
            make_campaign(whole, effects=effects, seed=SEED, plant="independent", quick=True)
            for variant in VARIANTS:
                campaign = reduced(load(whole), variant, Path(scratch) / "left")
                began = time.perf_counter()
                answer, widths = _answer(campaign), _widths(campaign)
                took = time.perf_counter() - began
                lines.append(f"| {variant.name} | {hidden or '-'} | {answer} | {' | '.join(widths)} | {took:.0f} |")
                if show is not None:
                    show(lines[-1])
                rows.append(
                    {
                        "name": f"{variant.name}, {hidden or 'nothing'} hidden",
                        "value": took,
                        "unit": "s",
                        "baseline": None,
                        "ratio": None,
                        "note": f"{answer}; 95 % interval of K_A, T_A, K_c, b: {', '.join(widths)}",
                    }
                )
    if results is not None:
        results.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return rows


def reduced(campaign: Campaign, variant: Variant, folder: Path) -> Campaign:
    """The campaign as its user would have it without what the variant leaves out; `folder` is made anew."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    recordings = tuple(recording for recording in campaign.recordings if variant.keeps(recording))
    for recording in recordings:
        with gzip.open(campaign.path_of(recording), "rt", encoding="utf-8") as text:
            rows = variant.edits(list(csv.DictReader(text)), recording)
        with gzip.open(folder / recording.file, "wt", encoding="utf-8", newline="") as text:
            writer = csv.DictWriter(text, rows[0])
            writer.writeheader()
            writer.writerows(rows)
    return replace(campaign, folder=folder, recordings=recordings)


def _answer(campaign: Campaign) -> str:
    try:
        diagnosis = diagnose(campaign, Options(quick=True))
    except DataError as error:
        return f"refused: {error}"
    names = ", ".join(_class(diagnosis)) or "-"
    return f"{diagnosis.verdict}: {names}"


def _class(diagnosis: Diagnosis) -> list[str]:
    return [
        f"{cause.name} ({cause.confidence:.2f})"
        + (
            f" or {' or '.join(other.name for other in cause.indistinguishable_from)}"
            if cause.indistinguishable_from
            else ""
        )
        for cause in diagnosis.causes
    ]


def _widths(campaign: Campaign) -> list[str]:
    """Half the 95 % interval of each parameter, as a part of its value."""
    try:
        model = identify(campaign).model
    except DataError as error:
        return [f"refused: {error}", "", "", ""]
    widths = []
    for name in ("K_A", "T_A", "K_c", "b"):
        parameter = model.parameters[name]
        known = parameter.ci95 is not None and parameter.value and parameter.verdict != "not-identifiable"
        widths.append(
            f"{50.0 * (parameter.ci95[1] - parameter.ci95[0]) / abs(parameter.value):.2g} %"
            if known and parameter.ci95
            else "unknown"
        )
    return widths
