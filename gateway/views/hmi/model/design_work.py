"""Gains designed for a model, and one flight before and after them: three jobs of `board51`.

Rule 1: nothing here sends gains.  The page shows what `gains.py` makes of the file, and a press of its own sends it.
Rule 2: a flight is recorded under the designed gains only: while the board has others, it is refused.
"""

from __future__ import annotations

import json
import math
import shutil
import time
from pathlib import Path

from gateway.board.reference import SLACK, reference_range
from gateway.views.hmi.actions import refusal
from gateway.views.hmi.gains import LAW_OF_NAME
from gateway.views.hmi.model.campaigns import CampaignFolder
from gateway.views.hmi.model.designs import DESIGNS, EXPERIMENT, FLIGHT, DesignFolder, flight_before, newest_design
from gateway.views.hmi.model.work import ModelWork
from gateway.views.hmi.sessions import LoginSession
from gateway.views.hmi.texts import text_of
from protocol.bus import board51_pb2 as pb


def design(work: ModelWork, session: LoginSession, board: str, table: dict[str, object]) -> pb.CommandReply:
    """Start `board51 design` for a model of the list.

    Args:
        work: starts the job.
        session: of the user.
        board: of the rig, whose T_s, converters and input range the design gets.
        table: campaign, model, law, x_mm, and settling_ms or none for the usual one.
    """
    refused = work.refused(session, "diagnose")  # before anything is written
    if refused is not None:
        return refused
    chosen = work.campaign(board, str(table.get("campaign") or ""))
    if chosen is None or chosen.toml is None:
        return refusal("no-campaign", text_of("refusal.campaign_empty"))
    model = next((file for file in work.models(board) if file.name == table.get("model")), None)
    if model is None:
        return refusal("no-model", text_of("refusal.no_model_chosen"))
    parameters = work.parameters(board)
    if parameters is None:
        return refusal("no-parameters", text_of("refusal.no_parameters"))
    law, x_m, settling_s = str(table.get("law")), _number(table, "x_mm"), _number(table, "settling_ms")
    low, high = reference_range(parameters)
    if law not in LAW_OF_NAME:
        return refusal("no-law", text_of("refusal.no_law"))
    if x_m is None or not low - SLACK <= x_m <= high + SLACK:
        ends = {"low": f"{low * 1e3:.4g}", "high": f"{high * 1e3:.4g}"}
        return refusal("out-of-range", text_of("refusal.height_out_of_range", **ends))
    if settling_s is not None and not 0.0 < settling_s < math.inf:
        return refusal("out-of-range", text_of("refusal.settling_out_of_range"))
    folder = chosen.path / DESIGNS / time.strftime("%Y%m%d-%H%M%S")
    try:
        _prepare(folder, model.path, parameters)
    except OSError as error:
        return refusal("failed", text_of("job.no_start", error=error.strerror))
    words = ["design", str(folder / "model.json"), "--law", law, "--operating-point", f"{x_m:.9g}"]
    words += [] if settling_s is None else ["--settling-time", f"{settling_s:.9g}"]
    words += [*_of_board(parameters), "--before", str(folder / "before.json")]
    words += ["--out", str(folder / "controller.json"), "--analysis", str(folder / "analysis.json")]
    entry = text_of("campaigns.designed", model=model.kind)
    reply = work.start(session, "diagnose", "design", board, words, chosen.path, entry)
    if not reply.accepted:
        shutil.rmtree(folder, ignore_errors=True)  # it must not stand before the design that is there
    return reply


def fly(work: ModelWork, session: LoginSession, board: str, campaign: str) -> pb.CommandReply:
    """Record the experiment of the comparison under the newest design, which must be on the board."""
    chosen, newest = _newest(work, board, campaign)
    if chosen is None or newest is None:
        return refusal("no-design", text_of("refusal.no_design"))
    if not newest.is_on(work.parameters(board)):
        return refusal("not-loaded", text_of("refusal.not_loaded"))
    return work.fly(session, board, chosen, newest.path / FLIGHT, EXPERIMENT)


def forecast(work: ModelWork, session: LoginSession, board: str, campaign: str) -> pb.CommandReply:
    """Start `board51 what-if` of the newest design: a recorded flight under its gains, and the flight that followed."""
    chosen, newest = _newest(work, board, campaign)
    if chosen is None or newest is None:
        return refusal("no-design", text_of("refusal.no_design"))
    before = flight_before(chosen, newest)
    if before is None:
        return refusal("no-flight", text_of("refusal.no_flight", experiment=EXPERIMENT))
    words = ["what-if", str(before), "--model", str(newest.path / "model.json"), "--gains", str(newest.controller)]
    words += ["--board", board, "--out", str(newest.path)]
    words += [] if newest.flown is None else ["--then", str(newest.flown)]
    return work.start(session, "diagnose", "forecast", board, words, chosen.path, text_of("campaigns.forecast"))


def _newest(work: ModelWork, board: str, campaign: str) -> tuple[CampaignFolder | None, DesignFolder | None]:
    chosen = work.campaign(board, campaign) if campaign else None
    newest = newest_design(chosen)
    return chosen, newest if newest is not None and newest.analysis else None


def _number(table: dict[str, object], name: str) -> float | None:
    """Return a number of a form in SI units, which has thousandths; None for an empty field, NaN for another text."""
    text = table.get(name)
    if text in (None, ""):
        return None
    try:
        return float(str(text)) / 1e3
    except ValueError:
        return math.nan


def _prepare(folder: Path, model: Path, parameters: pb.Parameters) -> None:
    """Write the model and the gains on the board.  Raises OSError."""
    folder.mkdir(parents=True)
    shutil.copyfile(model, folder / "model.json")
    names = {number: name for name, number in LAW_OF_NAME.items()}
    point = {"i_0_a": parameters.i_0_a, "x_0_m": parameters.x_0_m, "u_0_v": parameters.u_0_v}
    before = {
        "law": names.get(parameters.law, ""),
        "gains": list(parameters.gains),
        "operating_point": point,
        "sample_time_s": parameters.sample_time_s,
    }
    (folder / "before.json").write_text(json.dumps(before), encoding="utf-8")


def _of_board(parameters: pb.Parameters) -> list[str]:
    words = ["--sample-time", f"{parameters.sample_time_s:.9g}"]
    for option, value in (
        ("--u-max", parameters.u_max_v),
        ("--i-lsb", parameters.i_lsb_a),
        ("--x-lsb", parameters.x_lsb_m),
        ("--u-lsb", parameters.u_lsb_v),
    ):
        words += [option, f"{abs(value):.9g}"] if value else []
    return words
