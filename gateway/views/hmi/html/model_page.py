"""The values that the page of a model shows: the chosen campaign with its results, and the models."""

from __future__ import annotations

from pathlib import Path

from google.protobuf.json_format import MessageToDict

from gateway.views.hmi.gains import parse_gains, rows
from gateway.views.hmi.html.bode import bode_card
from gateway.views.hmi.html.figure import errors_figure
from gateway.views.hmi.library import Library
from gateway.views.hmi.model.campaigns import BODE, VALIDATION, CampaignFolder, choose, parse_table, read_table
from gateway.views.hmi.model.designs import newest_design
from gateway.views.hmi.model.exports import FORMATS
from gateway.views.hmi.model.models import parameter_rows, summary
from gateway.views.hmi.model.plant import plant_card
from gateway.views.hmi.model.work import LIVE_MIN, ModelWork
from gateway.views.hmi.texts import text_of
from protocol.bus import board51_pb2 as pb
from protocol.diagnosis import load_diagnosis
from protocol.errors import DataError
from protocol.experiments import EXPERIMENT_OF_NAME


def shown(work: ModelWork, reports: Library, board: str, name: str) -> dict[str, object]:
    """Return the values of the template.

    Args:
        work: what lies in the folders.
        reports: that may be shown.
        board: of the rig.
        name: of the campaign; empty: the newest finished one.
    """
    campaigns, running = work.campaigns(board), work.running(board)
    chosen = choose(campaigns, name)
    now = parse_table(running.model_json, where="the twin's model") if running is not None else {}
    return {
        "script": "model.js",
        "plant": plant_card(work.card(board), board),
        "campaigns": campaigns,
        "chosen": chosen,
        "running": running,
        "running_summary": summary(now),
        "models": work.models(board),
        "formats": FORMATS,
        "experiments": EXPERIMENT_OF_NAME,
        "live_min": f"{LIVE_MIN:g}",
        "bode": bode_card(chosen.bode) if chosen is not None else None,
        "bode_report": _report(reports, chosen.path / BODE / "bode.html") if chosen is not None else "",
        **_identified(chosen, reports),
        **_diagnosed(chosen, reports),
        **_compared(chosen, reports),
        **_designed(chosen, work.parameters(board), reports),
    }


def _identified(chosen: CampaignFolder | None, reports: Library) -> dict[str, object]:
    if chosen is None or chosen.model is None:
        return {"parameters": [], "validation": {}, "validation_report": ""}
    return {
        "parameters": parameter_rows(read_table(chosen.model)),
        "validation": chosen.validation,
        "validation_report": _report(reports, chosen.path / VALIDATION / "report.html"),
    }


def _diagnosed(chosen: CampaignFolder | None, reports: Library) -> dict[str, object]:
    diagnosis, problem, report = None, "", ""
    if chosen is not None and chosen.diagnosis is not None:
        try:
            diagnosis = load_diagnosis(chosen.diagnosis)
        except DataError as error:
            problem = str(error)
        report = _report(reports, chosen.diagnosis.parent / "report.html")
    figure = errors_figure(diagnosis.ahead) if diagnosis is not None else None
    return {"diagnosis": diagnosis, "problem": problem, "report": report, "figure": figure}


def _compared(chosen: CampaignFolder | None, reports: Library) -> dict[str, object]:
    if chosen is None or chosen.comparison is None:
        return {"comparison": None, "compare_report": ""}
    table = read_table(chosen.comparison)
    whole = {"answer", "names", "notes"} <= set(table)  # else it is damaged
    return {
        "comparison": table if whole else None,
        "compare_report": _report(reports, chosen.comparison.parent / "compare.html"),
    }


def _designed(chosen: CampaignFolder | None, parameters: pb.Parameters | None, reports: Library) -> dict[str, object]:
    """Return the newest design, what would be sent to the board, and whether the board has it."""
    design = newest_design(chosen)
    values: dict[str, object] = {"design": design, "load": None, "rows": [], "load_problem": "", "loaded": False,
                                 "forecast_report": "",
                                 "x_mm": f"{parameters.x_0_m * 1e3:.4g}" if parameters is not None else ""}  # fmt: skip
    if chosen is None or design is None or not design.analysis:
        return values
    try:
        gains = parse_gains(design.controller.read_bytes(), parameters)
        sent = MessageToDict(gains, preserving_proto_field_name=True, always_print_fields_with_no_presence=True)
        values |= {"load": {"set_gains": sent}, "rows": rows(gains, parameters)}
    except DataError as error:
        values["load_problem"] = str(error)
    except OSError as error:
        values["load_problem"] = text_of("design.no_file", error=error.strerror)
    return values | {
        "design_model": summary(design.model),
        "loaded": design.is_on(parameters),
        "forecast_report": _report(reports, design.report) if design.forecast else "",
    }


def _report(reports: Library, path: Path) -> str:
    """Return the name of a report, by which a page may show it; empty if there is none."""
    page = path.resolve()
    return next((entry.name for entry in reports.entries() if entry.path == page), "")
