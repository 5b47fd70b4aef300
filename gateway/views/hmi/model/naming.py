"""Renames and deletes campaigns of the list, for those who may.

Blocking, as `Actions`, whose rules hold here.
"""

from __future__ import annotations

import logging
import shutil

from gateway.views.hmi.model.campaigns import TITLE, TITLE_LENGTH, CampaignFolder
from gateway.views.hmi.model.work import ModelWork
from gateway.views.hmi.refusals import RefusalError
from gateway.views.hmi.sessions import LoginSession
from gateway.views.hmi.texts import text_of
from protocol.bus import board51_pb2 as pb

_logger = logging.getLogger("gateway.hmi")


def rename(work: ModelWork, session: LoginSession, board: str, name: str, title: str) -> pb.CommandReply:
    """Give a campaign the name that people call it by; an empty one takes it away.  Its folder stays."""
    work.actions.check(session, "campaign")
    chosen = _find(work, board, name)
    title = " ".join(title.split())
    if len(title) > TITLE_LENGTH or not title.isprintable():
        raise RefusalError("bad-name", text_of("refusal.bad_name", limit=TITLE_LENGTH))
    try:
        (chosen.path / TITLE).write_text(title, encoding="utf-8")
    except OSError as error:
        raise RefusalError("failed", text_of("refusal.not_renamed", error=error.strerror)) from None
    return pb.CommandReply(accepted=True, text=text_of("campaigns.renamed", title=title or chosen.name))


def delete(work: ModelWork, session: LoginSession, board: str, name: str) -> pb.CommandReply:
    """Delete a campaign with its recordings, models and reports; never one that a job of its rig works on."""
    work.actions.check(session, "delete_log")
    chosen = _find(work, board, name)
    if any(job.running and job.title == name for job in work.actions.jobs.of(board)):
        raise RefusalError("in-use", text_of("refusal.campaign_in_use"))
    try:
        shutil.rmtree(chosen.path)
    except OSError as error:
        raise RefusalError("failed", text_of("refusal.no_delete", error=error.strerror)) from None
    _logger.info("%s deleted %s", session.name, chosen.path)
    return pb.CommandReply(accepted=True, text=text_of("refusal.deleted", log=name))


def _find(work: ModelWork, board: str, name: str) -> CampaignFolder:
    chosen = work.campaign(board, name) if name else None
    if chosen is None:
        raise RefusalError("no-campaign", text_of("refusal.no_campaign"))
    return chosen
