"""Starts what a page asks for: campaigns, identification, diagnosis, hand-overs.  Each is a `board51` command.

Blocking, as `Actions`, whose rules hold here: rights are checked for each act, a refusal is a value.
"""

from __future__ import annotations

import logging
import time
from pathlib import Path

from gateway.views.hmi.actions import Actions, Routes, refusal
from gateway.views.hmi.model.campaigns import (
    BODE,
    DIAGNOSIS,
    MODEL,
    VALIDATION,
    CampaignFolder,
    campaigns_of,
    find_campaign,
    write_act,
)
from gateway.views.hmi.model.models import ModelFile, keep, models_of
from gateway.views.hmi.sessions import LoginSession
from gateway.views.hmi.texts import text_of
from protocol.bus import board51_pb2 as pb
from protocol.experiments import EXPERIMENT_OF_NAME

LIVE_MIN = 2.0  # of flight that a diagnosis without a campaign takes
_logger = logging.getLogger("gateway.hmi")


class ModelWork:
    """The work on the models of all rigs.

    Args:
        actions: checks rights and starts jobs.
        logs: folder of the gateway's logs.
        routes: how jobs reach the bus, and where they write.
    """

    def __init__(self, actions: Actions, *, logs: Path, routes: Routes) -> None:
        self._actions, self._logs, self._routes = actions, logs, routes

    @property
    def _root(self) -> Path:
        return self._routes.data / "campaigns"

    def campaign(self, board: str, name: str) -> CampaignFolder | None:
        """Return the campaign of that name, or the newest for an empty name; None if there is none."""
        return find_campaign(self._root, board, name)

    def campaigns(self, board: str) -> list[CampaignFolder]:
        """Return the campaigns of a board, the newest first."""
        return campaigns_of(self._root, board)

    def running(self, board: str) -> pb.TwinModel | None:
        """Return the model on which the twin runs, as the twin reports it."""
        feed = self._actions.feed.board(board)
        return None if feed is None else feed.latest(pb.TwinModel)

    def parameters(self, board: str) -> pb.Parameters | None:
        """Return what a board has stated of itself."""
        feed = self._actions.feed.board(board)
        return None if feed is None else feed.latest(pb.Parameters)

    def card(self, board: str) -> pb.PlantCard | None:
        """Return the plant card of a rig as its gateway has sent it."""
        feed = self._actions.feed.board(board)
        return None if feed is None else feed.latest(pb.PlantCard)

    def refused(self, session: LoginSession, act: str) -> pb.CommandReply | None:
        """Return the refusal of an act, or None if it is allowed."""
        return self._actions.refused(session, act)

    def models(self, board: str) -> list[ModelFile]:
        """Return the models of a board, those of the newest campaign first."""
        return models_of(self._routes.data, board, self.campaigns(board), self.running(board))

    def start_campaign(
        self, session: LoginSession, board: str, *, quick: bool = False, investigate: bool = False, park: bool = False
    ) -> pb.CommandReply:
        """Start a campaign of the paper's experiments, or an investigation, in a new folder.

        `park`: the person has seen that the ball flies, and that it is landed first.
        """
        folder = self._new(board)
        if investigate:
            what = ["investigate", board, "--out", str(folder)]
        else:
            what = [*self._run(folder, board), *["--park"] * park]
        words = [*what, *["--quick"] * quick, *self._as_person(session)]
        if investigate:
            entry = text_of("campaigns.started_investigation")
        else:
            entry = text_of("campaigns.started_quick") if quick else text_of("campaigns.started")
        return self.start(session, "campaign", "campaign", board, words, folder, entry)

    def resume_campaign(self, session: LoginSession, board: str, campaign: str) -> pb.CommandReply:
        """Continue an interrupted campaign or investigation in its folder."""
        chosen = find_campaign(self._root, board, campaign) if campaign else None
        if chosen is None or not chosen.interrupted:
            return refusal("no-campaign", text_of("refusal.campaign_complete"))
        if chosen.investigation:
            what = ["investigate", board, "--out", str(chosen.path)]
        else:
            what = self._run(chosen.path, board)
            what += [word for name in chosen.left for word in ("--experiment", name)]
        words = [*what, *["--quick"] * chosen.quick, *self._as_person(session)]
        return self.start(session, "campaign", "campaign", board, words, chosen.path, text_of("campaigns.continued"))

    def add_experiment(
        self, session: LoginSession, board: str, campaign: str, experiment: str, *, prepared: bool = False
    ) -> pb.CommandReply:
        """Add an experiment to a campaign; `prepared`: a person has made the manual preparation."""
        chosen = find_campaign(self._root, board, campaign)
        if chosen is None or chosen.toml != chosen.path / "campaign.toml":
            return refusal("no-campaign", text_of("refusal.campaign_closed"))
        if experiment not in EXPERIMENT_OF_NAME:
            return refusal("no-experiment", text_of("refusal.no_experiment"))
        if EXPERIMENT_OF_NAME[experiment].person and not prepared:
            return refusal("person-needed", EXPERIMENT_OF_NAME[experiment].person)
        words = [*self._run(chosen.path, board), "--experiment", experiment]
        words += [*["--yes"] * prepared, *self._as_person(session)]
        entry = text_of("campaigns.added", experiment=experiment)
        return self.start(session, "campaign", "campaign", board, words, chosen.path, entry)

    def fly(
        self, session: LoginSession, board: str, chosen: CampaignFolder, folder: Path, experiment: str
    ) -> pb.CommandReply:
        """Record one experiment in a folder of its own, as long as in the campaign."""
        words = [*self._run(folder, board), "--experiment", experiment, *["--quick"] * chosen.quick]
        entry = text_of("campaigns.flown", experiment=experiment)
        return self.start(
            session, "campaign", "campaign", board, [*words, *self._as_person(session)], chosen.path, entry
        )

    def identify(self, session: LoginSession, board: str, campaign: str) -> pb.CommandReply:
        """Identify K_A, T_A, K_c and b from a campaign."""
        chosen = find_campaign(self._root, board, campaign)
        if chosen is None or chosen.toml is None:
            return refusal("no-campaign", text_of("refusal.campaign_empty"))
        words = ["identify", str(chosen.toml), "--out", str(chosen.path / MODEL)]
        return self.start(
            session, "diagnose", "identify", board, words, chosen.path, text_of("campaigns.was_identified")
        )

    def validate(self, session: LoginSession, board: str, campaign: str) -> pb.CommandReply:
        """Compare the identified model of a campaign with its judge recordings."""
        chosen = find_campaign(self._root, board, campaign)
        if chosen is None or chosen.toml is None:
            return refusal("no-campaign", text_of("refusal.campaign_empty"))
        if chosen.model is None:
            return refusal("no-model", text_of("refusal.not_identified"))
        words = ["validate", str(chosen.toml), "--model", str(chosen.model), "--out", str(chosen.path / VALIDATION)]
        entry = text_of("campaigns.was_validated")
        return self.start(session, "diagnose", "validate", board, words, chosen.path, entry)

    def diagnose(self, session: LoginSession, board: str, campaign: str, *, quick: bool) -> pb.CommandReply:
        """Diagnose the causes of the model's errors in a campaign."""
        chosen = find_campaign(self._root, board, campaign)
        if chosen is None or chosen.toml is None:
            return refusal("no-campaign", text_of("refusal.campaign_empty"))
        words = ["diagnose", str(chosen.toml), "--out", str(chosen.path / DIAGNOSIS), "--next-experiment",
                 *["--quick"] * quick]  # fmt: skip
        entry = text_of("campaigns.was_diagnosed_quick") if quick else text_of("campaigns.was_diagnosed")
        return self.start(session, "diagnose", "diagnose", board, words, chosen.path, entry)

    def diagnose_live(self, session: LoginSession, board: str) -> pb.CommandReply:
        """Diagnose the causes of the model's errors in the last minutes of flight."""
        folder = self._new(board)
        words = ["diagnose", "--live", f"{LIVE_MIN:g}", "--board", board, "--logs", str(self._logs), "--quick",
                 "--next-experiment", "--out", str(folder / DIAGNOSIS), *self._routes.live(session.name)]  # fmt: skip
        entry = text_of("campaigns.was_diagnosed_live", minutes=f"{LIVE_MIN:g}")
        return self.start(session, "diagnose", "diagnose", board, words, folder, entry)

    def bode(self, session: LoginSession, board: str, campaign: str) -> pb.CommandReply:
        """Compare the frequency responses of a campaign with its extended model, or else with its identified one."""
        chosen = find_campaign(self._root, board, campaign)
        if chosen is None or chosen.toml is None:
            return refusal("no-campaign", text_of("refusal.campaign_empty"))
        model = next((file for file in self.models(board) if file.path.is_relative_to(chosen.path)), None)
        if model is None:
            return refusal("no-model", text_of("refusal.not_identified"))
        words = ["bode", str(model.path), str(chosen.toml), "--out", str(chosen.path / BODE)]
        entry = text_of("campaigns.was_bode", model=model.kind)
        return self.start(session, "diagnose", "bode", board, words, chosen.path, entry)

    def hand_over(self, session: LoginSession, board: str, model: str) -> pb.CommandReply:
        """Give a model of the list to the running twin; what it replaces is kept."""
        refused = self.refused(session, "use_model")  # before anything is written
        if refused is not None:
            return refused
        chosen = next((file for file in self.models(board) if file.name == model), None)
        if chosen is None:
            return refusal("no-model", text_of("refusal.no_model"))
        running = self.running(board)
        try:
            if running is not None and not any(file.in_use for file in self.models(board)):
                keep(self._routes.data, running, board)
        except OSError as error:
            return refusal("failed", text_of("refusal.model_not_kept", error=error.strerror))
        words = ["twin", "--hand-over", str(chosen.path), "--board", board, *self._as_person(session)]
        folder = chosen.path.parent if chosen.path.name == MODEL else chosen.path.parent.parent
        folder = folder if folder.parent == self._root else self._routes.data / "models" / board
        entry = text_of("campaigns.handed_over", model=chosen.kind)
        return self.start(session, "use_model", "hand-over", board, words, folder, entry)

    def _new(self, board: str) -> Path:
        return self._root / f"{board}-{time.strftime('%Y%m%d-%H%M%S')}"

    def _as_person(self, session: LoginSession) -> list[str]:
        return ["--who", session.name, *self._routes.live(session.name)]

    def _run(self, folder: Path, board: str) -> list[str]:
        return ["campaign", "run", str(folder), "--board", board]

    def start(
        self, session: LoginSession, act: str, kind: str, board: str, words: list[str], folder: Path, entry: str
    ) -> pb.CommandReply:
        """Start a job, and record it as an act in a campaign's folder.

        Args:
            session: of the user, who must be allowed to do `act`.
            act: of the table of rights.
            kind: of the job.
            board: of the rig.
            words: the command, without `board51`.
            folder: of the campaign.
            entry: the act, for people.
        """
        if kind == "campaign":  # a STOP ends it that comes from elsewhere before the process listens
            words = [*words, "--issued", str(time.time_ns())]
        reply = self._actions.start_job(session, act, kind, board, words, title=folder.name)
        if reply.accepted:
            try:
                write_act(folder, who=session.name, what=entry)
            except OSError as error:
                _logger.warning("%s: the act cannot be recorded (%s)", folder, error.strerror)
        return reply
