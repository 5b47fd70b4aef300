"""Starts what a page asks for: campaigns, identification, diagnosis, hand-overs.  Each is a `board51` command.

It renames and deletes campaigns, too.

Blocking, as `Actions`, whose rules hold here: rights are checked for each act, a refusal is raised.
"""

from __future__ import annotations

import logging
import shutil
import time
from pathlib import Path

from gateway.views.hmi.actions import Actions, Order
from gateway.views.hmi.model import campaigns as folders
from gateway.views.hmi.model.models import ModelFile, keep, models_of
from gateway.views.hmi.refusals import RefusalError
from gateway.views.hmi.sessions import LoginSession
from gateway.views.hmi.texts import text_of
from protocol.bus import board51_pb2 as pb
from protocol.campaign import load
from protocol.errors import Board51Error
from protocol.experiments import EXPERIMENT_OF_NAME

FLIES = ("closed-loop", "prbs", "free")
LIVE_MIN = 2.0  # of flight that a diagnosis without a campaign takes
_logger = logging.getLogger("gateway.hmi")


class ModelWork:
    """The work on the models of all rigs."""

    def __init__(self, actions: Actions) -> None:
        self.actions, self.feed, self._routes = actions, actions.feed, actions.routes

    @property
    def _root(self) -> Path:
        return self._routes.data / "campaigns"

    def campaign(self, board: str, name: str) -> folders.CampaignFolder | None:
        """Return the campaign of that name, or the newest for an empty name; None if there is none."""
        return folders.find_campaign(self._root, board, name)

    def campaigns(self, board: str) -> list[folders.CampaignFolder]:
        """Return the campaigns of a board, the newest first."""
        return folders.campaigns_of(self._root, board)

    def models(self, board: str) -> list[ModelFile]:
        """Return the models of a board, those of the newest campaign first."""
        return models_of(self._routes.data, board, self.campaigns(board), self.feed.latest(board, pb.TwinModel))

    def recorded(self, order: Order) -> folders.CampaignFolder:
        """Return the campaign of an order, which has recordings.

        Raises:
            RefusalError: there is none.
        """
        chosen = self.campaign(order.board, order.word("campaign"))
        if chosen is None or chosen.toml is None:
            raise RefusalError("no-campaign", text_of("refusal.campaign_empty"))
        return chosen

    def model(self, board: str, name: object) -> ModelFile:
        """Return the model of that name.

        Raises:
            RefusalError: there is none.
        """
        for file in self.models(board):
            if file.name == name:
                return file
        raise RefusalError("no-model", text_of("refusal.no_model"), status=404)

    def start_campaign(self, order: Order) -> pb.CommandReply:
        """Start a campaign of the paper's experiments, or an investigation, in a new folder.

        `park`: the person has seen that the ball flies, and that it is landed first.
        """
        folder, quick = self._new(order.board), order.flag("quick")
        if order.flag("investigate"):
            what = ["investigate", order.board, "--out", str(folder)]
            entry = text_of("campaigns.started_investigation")
        else:
            what = [*self._run(folder, order.board), *["--park"] * order.flag("park")]
            entry = text_of("campaigns.started_quick") if quick else text_of("campaigns.started")
        words = [*what, *["--quick"] * quick, *self._as_person(order.session)]
        return self.start(order, words, folder, entry)

    def resume_campaign(self, order: Order) -> pb.CommandReply:
        """Continue an interrupted campaign or investigation in its folder."""
        name = order.word("campaign")
        chosen = self.campaign(order.board, name) if name else None
        if chosen is None or not chosen.interrupted:
            raise RefusalError("no-campaign", text_of("refusal.campaign_complete"))
        if chosen.investigation:
            what = ["investigate", order.board, "--out", str(chosen.path)]
        else:
            what = self._run(chosen.path, order.board)
            what += [word for name in chosen.left for word in ("--experiment", name)]
        words = [*what, *["--quick"] * chosen.quick, *self._as_person(order.session)]
        return self.start(order, words, chosen.path, text_of("campaigns.continued"))

    def add_experiment(self, order: Order) -> pb.CommandReply:
        """Add an experiment to a campaign; `prepared`: a person has made the manual preparation."""
        chosen = self.campaign(order.board, order.word("campaign"))
        experiment, prepared = order.word("experiment"), order.flag("prepared")
        if chosen is None or chosen.toml != chosen.path / "campaign.toml":
            raise RefusalError("no-campaign", text_of("refusal.campaign_closed"))
        if experiment not in EXPERIMENT_OF_NAME:
            raise RefusalError("no-experiment", text_of("refusal.no_experiment"))
        if EXPERIMENT_OF_NAME[experiment].person and not prepared:
            raise RefusalError("person-needed", EXPERIMENT_OF_NAME[experiment].person)
        words = [*self._run(chosen.path, order.board), "--experiment", experiment]
        words += [*["--yes"] * prepared, *self._as_person(order.session)]
        return self.start(order, words, chosen.path, text_of("campaigns.added", experiment=experiment))

    def fly(self, order: Order, chosen: folders.CampaignFolder, folder: Path, experiment: str) -> pb.CommandReply:
        """Record one experiment in a folder of its own, as long as in the campaign."""
        words = [*self._run(folder, order.board), "--experiment", experiment, *["--quick"] * chosen.quick]
        words += self._as_person(order.session)
        return self.start(order, words, chosen.path, text_of("campaigns.flown", experiment=experiment))

    def identify(self, order: Order) -> pb.CommandReply:
        """Identify K_A, T_A, K_c and b from a campaign."""
        chosen = self.recorded(order)
        words = ["identify", str(chosen.toml), "--out", str(chosen.path / folders.MODEL)]
        return self.start(order, words, chosen.path, text_of("campaigns.was_identified"))

    def validate(self, order: Order) -> pb.CommandReply:
        """Compare the identified model of a campaign with its judge recordings."""
        chosen = self.recorded(order)
        model = chosen.file(folders.MODEL)
        if model is None:
            raise RefusalError("no-model", text_of("refusal.not_identified"))
        words = ["validate", str(chosen.toml), "--model", str(model), "--out", str(chosen.path / folders.VALIDATION)]
        return self.start(order, words, chosen.path, text_of("campaigns.was_validated"))

    def diagnose(self, order: Order) -> pb.CommandReply:
        """Diagnose the causes of the model's errors in a campaign."""
        chosen, quick = self.recorded(order), order.flag("quick")
        words = ["diagnose", str(chosen.toml), "--out", str(chosen.path / folders.DIAGNOSIS), "--next-experiment"]
        words += ["--quick"] * quick
        entry = text_of("campaigns.was_diagnosed_quick") if quick else text_of("campaigns.was_diagnosed")
        return self.start(order, words, chosen.path, entry)

    def diagnose_live(self, order: Order) -> pb.CommandReply:
        """Diagnose the causes of the model's errors in the last minutes of flight."""
        folder = self._new(order.board)
        words = ["diagnose", "--live", f"{LIVE_MIN:g}", "--board", order.board, "--logs", str(self._routes.logs)]
        words += ["--quick", "--next-experiment", "--out", str(folder / folders.DIAGNOSIS)]
        words += self._routes.live(order.session.name)
        return self.start(order, words, folder, text_of("campaigns.was_diagnosed_live", minutes=f"{LIVE_MIN:g}"))

    def compare(self, order: Order) -> pb.CommandReply:
        """Compare two models of the list, `first` and `second`, on the flights of a campaign that judge models."""
        names = order.word("first"), order.word("second")
        files = {file.name: file for file in self.models(order.board)}
        if not set(names) <= set(files):
            raise RefusalError("no-model", text_of("refusal.no_model_chosen"))
        if names[0] == names[1]:
            raise RefusalError("same-model", text_of("refusal.same_model"))
        chosen = self.recorded(order)
        try:
            flights = _judging(chosen)
        except Board51Error as error:
            raise RefusalError("bad-campaign", str(error)) from None
        if not flights:
            raise RefusalError("no-flight", text_of("refusal.no_judging_flight"))
        words = ["compare", *(str(files[name].path) for name in names), "--on", *flights]
        words += ["--campaign", str(chosen.toml), "--out", str(chosen.path / folders.COMPARISON)]
        return self.start(order, words, chosen.path, text_of("campaigns.compared"))

    def bode(self, order: Order) -> pb.CommandReply:
        """Compare the frequency responses of a campaign with its extended model, or else with its identified one."""
        chosen = self.recorded(order)
        model = next((file for file in self.models(order.board) if file.path.is_relative_to(chosen.path)), None)
        if model is None:
            raise RefusalError("no-model", text_of("refusal.not_identified"))
        words = ["bode", str(model.path), str(chosen.toml), "--out", str(chosen.path / folders.BODE)]
        return self.start(order, words, chosen.path, text_of("campaigns.was_bode", model=model.kind))

    def hand_over(self, order: Order) -> pb.CommandReply:
        """Give a model of the list to the running twin; what it replaces is kept."""
        self.actions.check_order(order)  # before anything is written
        chosen, running = self.model(order.board, order.word("model")), self.feed.latest(order.board, pb.TwinModel)
        try:
            if running is not None and not any(file.in_use for file in self.models(order.board)):
                keep(self._routes.data, running, order.board)
        except OSError as error:
            raise RefusalError("failed", text_of("refusal.model_not_kept", error=error.strerror)) from None
        words = ["twin", "--hand-over", str(chosen.path), "--board", order.board, *self._as_person(order.session)]
        folder = chosen.path.parent if chosen.path.name == folders.MODEL else chosen.path.parent.parent
        folder = folder if folder.parent == self._root else self._routes.data / "models" / order.board
        return self.start(order, words, folder, text_of("campaigns.handed_over", model=chosen.kind))

    def rename(self, session: LoginSession, board: str, name: str, title: str) -> pb.CommandReply:
        """Give a campaign the name that people call it by; an empty one takes it away.  Its folder stays."""
        self.actions.check(session, "campaign")
        chosen, title = self._named(board, name), " ".join(title.split())
        if len(title) > folders.TITLE_LENGTH or not title.isprintable():
            raise RefusalError("bad-name", text_of("refusal.bad_name", limit=folders.TITLE_LENGTH))
        try:
            (chosen.path / folders.TITLE).write_text(title, encoding="utf-8")
        except OSError as error:
            raise RefusalError("failed", text_of("refusal.not_renamed", error=error.strerror)) from None
        return pb.CommandReply(accepted=True, text=text_of("campaigns.renamed", title=title or chosen.name))

    def delete(self, session: LoginSession, board: str, name: str) -> pb.CommandReply:
        """Delete a campaign with its recordings, models and reports; never one that a job of its rig works on."""
        self.actions.check(session, "delete_log")
        chosen = self._named(board, name)
        if any(job.running and job.title == name for job in self.actions.jobs.of(board)):
            raise RefusalError("in-use", text_of("refusal.campaign_in_use"))
        try:
            shutil.rmtree(chosen.path)
        except OSError as error:
            raise RefusalError("failed", text_of("refusal.no_delete", error=error.strerror)) from None
        _logger.info("%s deleted %s", session.name, chosen.path)
        return pb.CommandReply(accepted=True, text=text_of("refusal.deleted", log=name))

    def start(self, order: Order, words: list[str], folder: Path, entry: str) -> pb.CommandReply:
        """Start a job, and record it as an act in a campaign's folder.

        Args:
            order: of the user.
            words: the command, without `board51`.
            folder: of the campaign.
            entry: the act, for people.
        """
        if order.kind == "campaign":  # a STOP ends it that comes from elsewhere before the process listens
            words = [*words, "--issued", str(time.time_ns())]
        reply = self.actions.start_job(order, words, title=folder.name)
        try:
            folders.write_act(folder, who=order.session.name, what=entry)
        except OSError as error:
            _logger.warning("%s: the act cannot be recorded (%s)", folder, error.strerror)
        return reply

    def _named(self, board: str, name: str) -> folders.CampaignFolder:
        chosen = self.campaign(board, name) if name else None
        if chosen is None:
            raise RefusalError("no-campaign", text_of("refusal.no_campaign"))
        return chosen

    def _new(self, board: str) -> Path:
        return self._root / f"{board}-{time.strftime('%Y%m%d-%H%M%S')}"

    def _as_person(self, session: LoginSession) -> list[str]:
        return ["--who", session.name, *self._routes.live(session.name)]

    def _run(self, folder: Path, board: str) -> list[str]:
        return ["campaign", "run", str(folder), "--board", board]


def _judging(campaign: folders.CampaignFolder) -> list[str]:
    """Return the paths of the flights that judge models.

    Raises:
        DataError: campaign.toml is absent or not text.
        ConfigError: a key or a value of it is wrong.
    """
    assert campaign.toml is not None
    listed = load(campaign.toml)
    return [str(listed.path_of(r)) for r in listed.recordings if r.use == "judge" and r.kind in FLIES]
