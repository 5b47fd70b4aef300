"""`board51 diagnose` on a campaign of points of rest alone: read, diagnose, write."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

from protocol.campaign import Campaign
from protocol.errors import DataError
from twin.diagnose.equilibria.diagnosis import diagnose_points
from twin.diagnose.equilibria.page import page
from twin.diagnose.equilibria.to_json import sentence_of, to_json
from twin.model.parameters import Model, model_to_dict
from twin.readers.campaign import read_campaign


def rests_alone(campaign: Campaign) -> bool:
    """Whether every recording for fitting is of kind `equilibria`."""
    kinds = {recording.kind for recording in campaign.recordings if recording.use == "fit"}
    return kinds == {"equilibria"}


def run_static(
    campaign: Campaign,
    *,
    data: Path | None,
    model: Model | None,
    out: Path | None,
    as_json: bool,
    say: Callable[[str], None],
) -> tuple[int, str]:
    """Diagnose, write diagnosis.json, report.html and extended_model.json into `out`; (exit code, what to print).

    Raises:
        DataError: recordings that cannot be used, a folder that cannot be written.
    """
    records = read_campaign(campaign, data=data)
    judges = read_campaign(campaign, use="judge", data=data)
    found = diagnose_points(campaign, records, judges, model=model, say=say)
    text = json.dumps(to_json(found), indent=2, allow_nan=False)
    if out is not None:
        title = f"What the model of {campaign.plant.name} gets wrong at rest"
        files = {
            "diagnosis.json": text + "\n",
            "report.html": page(found, title),
            "extended_model.json": json.dumps(model_to_dict(found.extended), indent=2, allow_nan=False) + "\n",
        }
        try:
            out.mkdir(parents=True, exist_ok=True)
            for name, content in files.items():
                (out / name).write_text(content, encoding="utf-8")
        except OSError as error:
            raise DataError(f"{out} cannot be written ({error.strerror})", remedy="Give a writable folder") from None
    code = 1 if found.verdict == "unknown-cause" else 0
    if as_json:
        return code, text
    lines = [sentence_of(found), *(f"  ! {warning}" for warning in found.warnings)]
    if out is not None:
        lines += [f"report   {out / 'report.html'}", f"model    {out / 'extended_model.json'}"]
    return code, "\n".join(lines)
