"""The values that the page of a model shows: the chosen campaign with its results, and the models."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from gateway.views.hmi.gains import command_of, parse_gains, rows
from gateway.views.hmi.html.bode import bode_card
from gateway.views.hmi.html.figure import errors_figure
from gateway.views.hmi.library import Library
from gateway.views.hmi.model import campaigns as folders
from gateway.views.hmi.model.campaigns import CampaignFolder, parse_table, read_table
from gateway.views.hmi.model.designs import newest_design
from gateway.views.hmi.model.models import parameter_rows, summary
from gateway.views.hmi.model.plant import plant_card
from gateway.views.hmi.model.work import LIVE_MIN, ModelWork
from gateway.views.hmi.texts import text_of
from gateway.views.hmi.turns import FORMATS
from protocol.bus import board51_pb2 as pb
from protocol.diagnosis import load_diagnosis
from protocol.errors import DataError
from protocol.experiments import EXPERIMENT_OF_NAME


def shown(work: ModelWork, reports: Library, board: str, name: str) -> dict[str, object]:
    """Return the values of the template.

    Args:
        work: the folders of the campaigns and models.
        reports: the reports that the page may show.
        board: name of the rig.
        name: name of the campaign; empty: the newest finished one.
    """
    campaigns, running = work.campaigns(board), work.feed.latest(board, pb.TwinModel)
    chosen = folders.choose(campaigns, name)
    now = parse_table(running.model_json, where="the twin's model") if running is not None else {}
    names = {entry.path: entry.name for entry in reports.entries()}

    def report(result: str) -> str:
        """Return the name of the report of a result, by which the page may show it; empty if there is none."""
        return "" if chosen is None else names.get((chosen.path / folders.RESULT_PAGES[result]).resolve(), "")

    comparison = _result(chosen, "comparison")
    return {
        "script": "model.js",
        "plant": plant_card(work.feed.latest(board, pb.PlantCard), board),
        "campaigns": campaigns,
        "chosen": chosen,
        "running": running,
        "running_summary": summary(now),
        "models": work.models(board),
        "formats": FORMATS,
        "experiments": EXPERIMENT_OF_NAME,
        "live_min": f"{LIVE_MIN:g}",
        "parameters": parameter_rows(read_table(chosen.path / folders.MODEL)) if chosen is not None else [],
        "validation": _result(chosen, "validation"),
        "validation_report": report("validation"),
        "report": report("diagnosis"),
        **_diagnosed(chosen),
        "bode": bode_card(_result(chosen, "bode")),
        "bode_report": report("bode"),
        "comparison": comparison if {"answer", "names", "notes"} <= set(comparison) else None,  # else it is damaged
        "compare_report": report("comparison"),
        **_designed(chosen, work.feed.latest(board, pb.Parameters), names),
    }


def _result(chosen: CampaignFolder | None, name: str) -> dict[str, Any]:
    return chosen.result(name) if chosen is not None else {}


def _diagnosed(chosen: CampaignFolder | None) -> dict[str, object]:
    diagnosis, problem = None, ""
    file = chosen.file(folders.RESULT_FILES["diagnosis"]) if chosen is not None else None
    try:
        diagnosis = load_diagnosis(file) if file is not None else None
    except DataError as error:
        problem = str(error)
    figure = errors_figure(diagnosis.ahead) if diagnosis is not None else None
    return {"diagnosis": diagnosis, "problem": problem, "figure": figure}


def _designed(
    chosen: CampaignFolder | None, parameters: pb.Parameters | None, names: Mapping[Path, str]
) -> dict[str, object]:
    """Return the newest design, what would be sent to the board, and whether the board has it."""
    design = newest_design(chosen)
    x_mm = f"{parameters.x_0_m * 1e3:.4g}" if parameters is not None else ""
    values: dict[str, object] = {"design": design, "x_mm": x_mm, "loaded": False, "forecast_report": ""}
    values |= {"load": None, "rows": [], "load_problem": ""}
    if design is None or not design.analysis:
        return values
    try:
        gains = parse_gains(design.controller.read_bytes(), parameters)
        values |= {"load": command_of(gains), "rows": rows(gains, parameters)}
    except DataError as error:
        values["load_problem"] = str(error)
    except OSError as error:
        values["load_problem"] = text_of("design.no_file", error=error.strerror)
    return values | {
        "design_model": summary(design.model),
        "loaded": design.is_on(parameters),
        "forecast_report": names.get(design.report.resolve(), "") if design.forecast else "",
    }
