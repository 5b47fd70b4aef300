"""The comparison of two models on the flights of a campaign that judge models."""

from __future__ import annotations

from gateway.views.hmi.actions import refusal
from gateway.views.hmi.model.campaigns import COMPARISON, CampaignFolder
from gateway.views.hmi.model.work import ModelWork
from gateway.views.hmi.sessions import LoginSession
from gateway.views.hmi.texts import text_of
from protocol.bus import board51_pb2 as pb
from protocol.campaign import load
from protocol.errors import Board51Error

FLIES = ("closed-loop", "prbs", "free")


def compare(
    work: ModelWork, session: LoginSession, board: str, campaign: str, models: tuple[str, str]
) -> pb.CommandReply:
    """Start `board51 compare` of two models of the list.

    Args:
        work: starts the job.
        session: of the user.
        board: of the rig.
        campaign: whose flights judge.
        models: their names.
    """
    files = {file.name: file for file in work.models(board)}
    if not set(models) <= set(files):
        return refusal("no-model", text_of("refusal.no_model_chosen"))
    if models[0] == models[1]:
        return refusal("same-model", text_of("refusal.same_model"))
    chosen = work.campaign(board, campaign)
    if chosen is None or chosen.toml is None:
        return refusal("no-campaign", text_of("refusal.campaign_empty"))
    try:
        flights = judging(chosen)
    except Board51Error as error:
        return refusal("bad-campaign", str(error))
    if not flights:
        return refusal("no-flight", text_of("refusal.no_judging_flight"))
    sides = [str(files[name].path) for name in models]
    words = [
        "compare",
        *sides,
        "--on",
        *flights,
        "--campaign",
        str(chosen.toml),
        "--out",
        str(chosen.path / COMPARISON),
    ]
    return work.start(session, "diagnose", "compare", board, words, chosen.path, text_of("campaigns.compared"))


def judging(campaign: CampaignFolder) -> list[str]:
    """Return the paths of the flights that judge models.

    Raises:
        DataError: campaign.toml is absent or not text.
        ConfigError: a key or a value of it is wrong.
    """
    assert campaign.toml is not None
    listed = load(campaign.toml)
    return [str(listed.path_of(r)) for r in listed.recordings if r.use == "judge" and r.kind in FLIES]
