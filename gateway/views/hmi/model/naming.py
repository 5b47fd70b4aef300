"""Renames and deletes campaigns of the list, for those who may.

Blocking, as `Actions`, whose rules hold here.
"""

from __future__ import annotations

import logging
import shutil

from gateway.views.hmi.actions import Actions, refusal
from gateway.views.hmi.model.campaigns import TITLE, TITLE_LENGTH, CampaignFolder
from gateway.views.hmi.model.work import ModelWork
from gateway.views.hmi.sessions import LoginSession
from gateway.views.hmi.texts import text_of
from protocol.bus import board51_pb2 as pb

_logger = logging.getLogger("gateway.hmi")


def rename(
    actions: Actions, work: ModelWork, session: LoginSession, board: str, name: str, title: str
) -> pb.CommandReply:
    """Give a campaign the name that people call it by; an empty one takes it away.  Its folder stays."""
    if (refused := actions.refused(session, "campaign")) is not None:
        return refused
    chosen = _find(work, board, name)
    if chosen is None:
        return refusal("no-campaign", text_of("refusal.no_campaign"))
    title = " ".join(title.split())
    if len(title) > TITLE_LENGTH or not title.isprintable():
        return refusal("bad-name", text_of("refusal.bad_name", limit=TITLE_LENGTH))
    try:
        (chosen.path / TITLE).write_text(title, encoding="utf-8")
    except OSError as error:
        return refusal("failed", text_of("refusal.not_renamed", error=error.strerror))
    return pb.CommandReply(accepted=True, text=text_of("campaigns.renamed", title=title or chosen.name))


def delete(actions: Actions, work: ModelWork, session: LoginSession, board: str, name: str) -> pb.CommandReply:
    """Delete a campaign with its recordings, models and reports; never one that a job of its rig works on."""
    if (refused := actions.refused(session, "delete_log")) is not None:
        return refused
    chosen = _find(work, board, name)
    if chosen is None:
        return refusal("no-campaign", text_of("refusal.no_campaign"))
    if any(job.running and job.title == name for job in actions.jobs.of(board)):
        return refusal("in-use", text_of("refusal.campaign_in_use"))
    try:
        shutil.rmtree(chosen.path)
    except OSError as error:
        return refusal("failed", text_of("refusal.no_delete", error=error.strerror))
    _logger.info("%s deleted %s", session.name, chosen.path)
    return pb.CommandReply(accepted=True, text=text_of("refusal.deleted", log=name))


def _find(work: ModelWork, board: str, name: str) -> CampaignFolder | None:
    return work.campaign(board, name) if name else None
