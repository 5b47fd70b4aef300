"""The acts that a request may start, by the kind of the job."""

from __future__ import annotations

from collections.abc import Callable

from gateway.views.hmi.actions import Actions
from gateway.views.hmi.model.comparison import compare
from gateway.views.hmi.model.design_work import design, fly, forecast
from gateway.views.hmi.model.work import ModelWork
from gateway.views.hmi.sessions import LoginSession
from protocol.bus import board51_pb2 as pb

Start = Callable[[LoginSession, str, dict[str, object]], pb.CommandReply]


def starts(actions: Actions, work: ModelWork) -> dict[str, Start]:
    """Return the functions that start a job, by its kind: (session, board, the request) -> answer."""

    def word(table: dict[str, object], name: str) -> str:
        return str(table.get(name) or "")

    def campaign(session: LoginSession, board: str, table: dict[str, object]) -> pb.CommandReply:
        if table.get("resume") is True:
            return work.resume_campaign(session, board, word(table, "campaign"))
        if table.get("fly") is True:
            return fly(work, session, board, word(table, "campaign"))
        if "experiment" in table:
            prepared = table.get("prepared") is True
            return work.add_experiment(
                session, board, word(table, "campaign"), word(table, "experiment"), prepared=prepared
            )
        wishes = {name: table.get(name) is True for name in ("quick", "investigate", "park")}
        return work.start_campaign(session, board, **wishes)

    def diagnose(session: LoginSession, board: str, table: dict[str, object]) -> pb.CommandReply:
        if table.get("live") is True:
            return work.diagnose_live(session, board)
        return work.diagnose(session, board, word(table, "campaign"), quick=table.get("quick") is True)

    return {
        "record": lambda session, board, table: actions.start_recording(session, board, word(table, "title")),
        "campaign": campaign,
        "identify": lambda session, board, table: work.identify(session, board, word(table, "campaign")),
        "validate": lambda session, board, table: work.validate(session, board, word(table, "campaign")),
        "diagnose": diagnose,
        "compare": lambda session, board, table: compare(
            work, session, board, word(table, "campaign"), (word(table, "first"), word(table, "second"))
        ),
        "design": lambda session, board, table: design(work, session, board, table),
        "forecast": lambda session, board, table: forecast(work, session, board, word(table, "campaign")),
        "bode": lambda session, board, table: work.bode(session, board, word(table, "campaign")),
        "hand-over": lambda session, board, table: work.hand_over(session, board, word(table, "model")),
        "replay": lambda session, _board, table: actions.start_replay(session, word(table, "log"), 1.0),
    }
