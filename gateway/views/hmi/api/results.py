"""The results of jobs, from the folders of campaigns.  They are the JSON of the `board51` commands."""

from __future__ import annotations

from typing import Any

from gateway.views.hmi.gains import parse_gains
from gateway.views.hmi.model.campaigns import RESULT_FILES, CampaignFolder
from gateway.views.hmi.model.designs import newest_design
from protocol.bus import board51_pb2 as pb
from protocol.errors import DataError

RESULTS = (*RESULT_FILES, "design", "forecast")


def result_of(name: str, campaign: CampaignFolder, parameters: pb.Parameters | None) -> dict[str, Any]:
    """Return a result of a campaign, of designs the newest; empty if there is none.

    Args:
        name: one of RESULTS.
        campaign: whose result.
        parameters: of the board, for which gains must fit.
    """
    if name in RESULT_FILES:
        return campaign.result(name)
    design = newest_design(campaign)
    if design is None or name == "forecast":
        return {} if design is None else design.forecast
    if not design.analysis:
        return {}
    command, problem = None, ""
    try:
        gains = parse_gains(design.controller.read_bytes(), parameters)
        point = {name: getattr(gains, name) for name in ("i_0_a", "x_0_m", "u_0_v")}
        law = "pid" if gains.law == pb.LAW_PID else "lqi"
        command = {"command": "gains", "law": law, "gains": list(gains.gains), **point}
    except (DataError, OSError) as error:
        problem = str(error)
    return {"command": command, "problem": problem, "is_loaded": design.is_on(parameters), **design.analysis}
