"""Gains designed for a model, and one flight before and after them: three jobs of `board51`.

Rule 1: nothing here sends gains.  The page shows what `gains.py` makes of the file, and a press of its own sends it.
Rule 2: a flight is recorded under the designed gains only: while the board has others, it is refused.
"""

from __future__ import annotations

import json
import math
import shutil
import time
from collections.abc import Mapping
from pathlib import Path

from gateway.board.reference import SLACK, reference_range
from gateway.views.hmi.actions import Order
from gateway.views.hmi.gains import LAW_OF_NAME
from gateway.views.hmi.model.campaigns import CampaignFolder
from gateway.views.hmi.model.designs import DESIGNS, EXPERIMENT, FLIGHT, DesignFolder, flight_before, newest_design
from gateway.views.hmi.model.work import ModelWork
from gateway.views.hmi.refusals import RefusalError
from gateway.views.hmi.texts import text_of
from protocol.bus import board51_pb2 as pb


def design(work: ModelWork, order: Order) -> pb.CommandReply:
    """Start `board51 design` for a model of the list.

    Args:
        work: starts the job.
        order: its rig gives T_s, converters and input range; its keys are campaign, model, law, x_mm, and settling_ms
            or none for the usual one.
    """
    work.actions.check_order(order)  # before anything is written
    chosen = work.recorded(order)
    model = next((file for file in work.models(order.board) if file.name == order.table.get("model")), None)
    if model is None:
        raise RefusalError("no-model", text_of("refusal.no_model_chosen"))
    parameters = work.feed.latest(order.board, pb.Parameters)
    if parameters is None:
        raise RefusalError("no-parameters", text_of("refusal.no_parameters"))
    law, x_m, settling_s = order.word("law"), _number(order.table, "x_mm"), _number(order.table, "settling_ms")
    low, high = reference_range(parameters)
    if law not in LAW_OF_NAME:
        raise RefusalError("no-law", text_of("refusal.no_law"))
    if x_m is None or not low - SLACK <= x_m <= high + SLACK:
        ends = {"low": f"{low * 1e3:.4g}", "high": f"{high * 1e3:.4g}"}
        raise RefusalError("out-of-range", text_of("refusal.height_out_of_range", **ends))
    if settling_s is not None and not 0.0 < settling_s < math.inf:
        raise RefusalError("out-of-range", text_of("refusal.settling_out_of_range"))
    folder = chosen.path / DESIGNS / time.strftime("%Y%m%d-%H%M%S")
    try:
        _prepare(folder, model.path, parameters)
    except OSError as error:
        raise RefusalError("failed", text_of("job.no_start", error=error.strerror)) from None
    words = ["design", str(folder / "model.json"), "--law", law, "--operating-point", f"{x_m:.9g}"]
    words += [] if settling_s is None else ["--settling-time", f"{settling_s:.9g}"]
    words += [*_of_board(parameters), "--before", str(folder / "before.json")]
    words += ["--out", str(folder / "controller.json"), "--analysis", str(folder / "analysis.json")]
    try:
        return work.start(order, words, chosen.path, text_of("campaigns.designed", model=model.kind))
    except RefusalError:
        shutil.rmtree(folder, ignore_errors=True)  # it must not stand before the design that is there
        raise


def fly(work: ModelWork, order: Order) -> pb.CommandReply:
    """Record the experiment of the comparison under the newest design, which must be on the board."""
    chosen, newest = _newest(work, order)
    if not newest.is_on(work.feed.latest(order.board, pb.Parameters)):
        raise RefusalError("not-loaded", text_of("refusal.not_loaded"))
    return work.fly(order, chosen, newest.path / FLIGHT, EXPERIMENT)


def forecast(work: ModelWork, order: Order) -> pb.CommandReply:
    """Start `board51 what-if` of the newest design: a recorded flight under its gains, and the flight that followed."""
    chosen, newest = _newest(work, order)
    before = flight_before(chosen, newest)
    if before is None:
        raise RefusalError("no-flight", text_of("refusal.no_flight", experiment=EXPERIMENT))
    words = ["what-if", str(before), "--model", str(newest.path / "model.json"), "--gains", str(newest.controller)]
    words += ["--board", order.board, "--out", str(newest.path)]
    words += [] if newest.flown is None else ["--then", str(newest.flown)]
    return work.start(order, words, chosen.path, text_of("campaigns.forecast"))


def _newest(work: ModelWork, order: Order) -> tuple[CampaignFolder, DesignFolder]:
    """Return the campaign of an order, and its newest design."""
    name = order.word("campaign")
    chosen = work.campaign(order.board, name) if name else None
    newest = newest_design(chosen)
    if chosen is None or newest is None or not newest.analysis:
        raise RefusalError("no-design", text_of("refusal.no_design"))
    return chosen, newest


def _number(table: Mapping[str, object], name: str) -> float | None:
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
