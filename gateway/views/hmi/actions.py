"""Checks and executes the actions of all pages and requests.  Blocking: call it in a thread.

Rule 1: rights are checked for each action, with the current session and role, whatever an open page shows.
Rule 2: a refusal by page, gateway, board or link is a value with a reason and a sentence.
Rule 3: every action is sent under the user's name, so that the log shows who did what.
"""

from __future__ import annotations

import logging
import re
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from gateway.access.roles import may, refusal_text
from gateway.views.board_feed import UNSEEN_S
from gateway.views.feed import Feed
from gateway.views.hmi.gains import parse_gains, rows
from gateway.views.hmi.jobs import Jobs
from gateway.views.hmi.library import Library
from gateway.views.hmi.sessions import LoginSession, LoginSessions
from gateway.views.hmi.texts import text_of
from gateway.views.listen import ACCOUNT
from protocol.bus import board51_pb2 as pb
from protocol.bus import topics
from protocol.errors import Board51Error

REPLAY_SITE = "replay"  # logs are replayed under this site, and on a bus of their own: never for live
WRITTEN_S = 30.0  # a log that is open is flushed far more often
_EVERYTHING = tuple(
    word for topic in topics.TOPICS if topic.bus and topic.logged for word in ("--topic", topic.name)
)  # a replay shows what was seen, the twin of then included
_ENDED_AS = {  # the act that whoever ends a job of this kind must be allowed
    "record": "recording", "campaign": "stop", "replay": "read",
    "identify": "diagnose", "diagnose": "diagnose", "bode": "diagnose", "hand-over": "use_model",
    "compare": "diagnose", "validate": "diagnose", "design": "diagnose", "forecast": "diagnose",
}  # fmt: skip
_ORDER = re.compile(r"pause|play|(seek|speed) \d{1,9}(\.\d{1,6})?")
_logger = logging.getLogger("gateway.hmi")


@dataclass(frozen=True, slots=True, kw_only=True)
class Routes:
    """The options of `board51` by which jobs reach the bus, and the folder into which they write."""

    data: Path  # of recordings, campaigns and models
    connect: str
    site: str
    replay: str  # endpoint of the bus on which replays run
    identities: Path | None  # on a guarded bus: the folder with those of people and of the views

    def live(self, name: str) -> list[str]:
        """Return the options for the live bus, as user `name`.

        A job that sends commands runs as the person; a job that only listens runs as the account of the views.
        """
        words = ["--connect", self.connect, "--site", self.site]
        return words if self.identities is None else [*words, "--identity", str(self.identities / name)]

    def replayed(self) -> list[str]:
        """Return the options for the bus of replays."""
        return ["--connect", self.replay, "--as-site", REPLAY_SITE]


class Actions:
    """The acts.

    Args:
        feed: of the live site.
        sessions: who is logged in, and with which role.
        jobs: where recordings, campaigns and replays run.
        logs: files that may be replayed.
        reports: pages of diagnosis.
        routes: how jobs reach the bus, and where they write.
        replayed: feed of the replay site.
    """

    def __init__(
        self,
        feed: Feed,
        sessions: LoginSessions,
        *,
        jobs: Jobs,
        logs: Library,
        reports: Library,
        routes: Routes,
        replayed: Feed,
    ) -> None:
        self.feed, self.sessions = feed, sessions
        self.jobs, self.logs, self.reports = jobs, logs, reports
        self._routes, self._replayed = routes, replayed

    def may(self, session: LoginSession, act: str) -> bool:
        """Return whether to show a control; each action checks the right again."""
        return may(self.sessions.role(session), act)

    def command(self, session: LoginSession, board: str, what: pb.Command, *, issued_ns: int = 0) -> pb.CommandReply:
        """Send a command that was issued at `issued_ns` (Unix time; 0: now) to a board, and wait for the reply."""
        send = partial(self.feed.command, board, what, issued_ns=issued_ns)
        return self._send(session, str(what.WhichOneof("what")), board, send)

    def stop(self, session: LoginSession, board: str) -> dict[str, pb.CommandReply]:
        """Switch the coil off at once, of one board or ("*") of all boards of the site; return their replies.

        A campaign ends by itself with a STOP that it sees.  One that is just starting, or an investigation between two
        experiments, sees none and would lift the ball later: so it is interrupted as well.
        """
        boards = self.feed.boards() if board == "*" else (board,)
        try:
            with ThreadPoolExecutor(max(1, len(boards))) as pool:  # one that does not answer holds up no other
                replies = pool.map(lambda name: self.command(session, name, pb.Command(stop=pb.Stop())), boards)
                return dict(zip(boards, replies, strict=True))
        finally:
            if self.refused(session, "stop") is None:
                for name in boards:
                    self.jobs.stop("campaign", name)

    def _send(
        self, session: LoginSession, act: str, board: str, send: Callable[..., pb.CommandReply]
    ) -> pb.CommandReply:
        refused = self.refused(session, act)
        if refused is not None:
            return refused
        if self.feed.board(board) is None:
            return refusal("no-board", text_of("refusal.no_board", board=repr(board[:32])))
        try:
            return send(who=session.name, role=self.sessions.role(session).word)
        except Exception as error:  # a bus that closed under us must not look like an accepted command
            _logger.warning("command of %s to %s: %s", session.name, board, error)
            return refusal("not-delivered", text_of("refusal.not_delivered", error=error))

    def acknowledge(
        self,
        session: LoginSession,
        board: str,
        alarm: str,
        *,
        comment: str = "",
        shelve_s: float = 0.0,
        issued_ns: int = 0,
    ) -> pb.CommandReply:
        """Acknowledge an alarm, or shelve it for a time."""
        send = partial(self.feed.acknowledge, board, alarm, comment=comment, shelve_s=shelve_s, issued_ns=issued_ns)
        return self._send(session, "acknowledge", board, send)

    def acknowledge_all(
        self, session: LoginSession, board: str, alarms: Sequence[str], *, issued_ns: int = 0
    ) -> pb.CommandReply:
        """Acknowledge alarms, each by a command of its own; return the first refusal, if there is one.

        An alarm that another person has acknowledged meanwhile is not a refusal.
        """
        with ThreadPoolExecutor(min(8, max(1, len(alarms)))) as pool:  # each may wait for its answer
            acknowledge = partial(self.acknowledge, session, board, issued_ns=issued_ns)
            replies = list(pool.map(acknowledge, alarms))
        refused = next((r for r in replies if not r.accepted and r.reason != "no-alarm"), None)
        if refused is not None:
            return refused
        count = sum(reply.accepted for reply in replies)
        return pb.CommandReply(accepted=True, text=text_of("alarm.all_acknowledged", count=count))

    def remove(self, session: LoginSession, board: str) -> pb.CommandReply:
        """Take a rig that has not been seen for minutes off the pages and out of STOP for all rigs."""
        refused = self.refused(session, "acknowledge")
        if refused is not None:
            return refused
        if self.feed.remove(board):
            return pb.CommandReply(accepted=True, text=text_of("refusal.removed", rig=board[:32]))
        return refusal("in-use", text_of("refusal.rig_in_use", minutes=f"{UNSEEN_S / 60:g}"))

    def gains(self, board: str, data: bytes) -> tuple[pb.SetGains, list[dict[str, str]]]:
        """Return what a file of gains would set on a board, and the table that shows it.

        Raises:
            DataError: of `parse_gains`.
        """
        known = self.feed.board(board)
        parameters = None if known is None else known.latest(pb.Parameters)
        gains = parse_gains(data, parameters)
        return gains, rows(gains, parameters)

    def start_recording(self, session: LoginSession, board: str, title: str) -> pb.CommandReply:
        """Log this board's bus into files of their own, beside the gateway's log."""
        name = slug(title)[:16] or "rec"
        prefix = f"{name}-{board}"[:32].rstrip("-_")
        words = ["record", "--out", str(self._routes.data / "recordings"), "--prefix", prefix, "--board", board]
        words += self._routes.live(ACCOUNT)
        return self.start_job(session, "recording", "record", board, words, title=title or text_of("job_kind.record"))

    def start_replay(self, session: LoginSession, log: str, speed: float) -> pb.CommandReply:
        """A log onto the replay site, with everything that travelled on the bus."""
        entry = self.logs.find(log)
        if entry is None:
            return refusal("no-log", text_of("refusal.no_log"))
        words = ["replay", str(entry.path), "--control", "--json", "--speed", f"{speed:g}"]
        words += [*self._routes.replayed(), *_EVERYTHING]
        reply = self.start_job(session, "read", "replay", "*", words, title=entry.name)
        if reply.accepted:
            self._replayed.forget()  # what the last replay left
        return reply

    def order_replay(self, session: LoginSession, order: str) -> pb.CommandReply:
        """Give an order to the replay that runs: pause, play, seek S, speed N."""
        refused = self.refused(session, "read")
        if refused is not None:
            return refused
        if not _ORDER.fullmatch(order):
            return refusal("malformed", text_of("replay.no_order"))
        if self.jobs.tell("replay", "*", order):
            return pb.CommandReply(accepted=True)
        return refusal("not-running", text_of("job.not_running"))

    def delete_log(self, session: LoginSession, log: str) -> pb.CommandReply:
        """Delete a log or recording for good; never one of a campaign, or one that is being written."""
        refused = self.refused(session, "delete_log")
        if refused is not None:
            return refused
        entry = self.logs.find(log)
        if entry is None:
            return refusal("no-log", text_of("refusal.no_log"))
        if entry.name.startswith("campaigns/"):
            return refusal("of-a-campaign", text_of("refusal.log_of_campaign"))
        if time.time() - entry.changed_s < WRITTEN_S:
            return refusal("in-use", text_of("refusal.log_in_use", seconds=f"{WRITTEN_S:g}"))
        try:
            entry.path.unlink()
        except OSError as error:
            return refusal("failed", text_of("refusal.no_delete", error=error.strerror))
        _logger.info("%s deleted %s", session.name, entry.path)
        return pb.CommandReply(accepted=True, text=text_of("refusal.deleted", log=entry.name))

    def stop_job(self, session: LoginSession, kind: str, board: str) -> pb.CommandReply:
        """Interrupt a job; a campaign parks the ball."""
        act = _ENDED_AS.get(kind, "")
        refused = self.refused(session, act)
        if refused is not None:
            return refused
        if self.jobs.stop(kind, board):
            return pb.CommandReply(accepted=True, text=text_of("job.ending"))
        return refusal("not-running", text_of("job.not_running"))

    def start_job(
        self, session: LoginSession, act: str, kind: str, board: str, words: list[str], *, title: str
    ) -> pb.CommandReply:
        """Start `board51 WORDS` for a user who may do `act`; one job of a kind and board at a time."""
        refused = self.refused(session, act)
        if refused is not None:
            return refused
        if board != "*" and self.feed.board(board) is None:
            return refusal("no-board", text_of("refusal.no_board", board=repr(board[:32])))
        try:
            if kind != "replay":
                self._routes.data.mkdir(parents=True, exist_ok=True)
            self.jobs.start(kind, board, words, title=title, who=session.name)
        except Board51Error as error:
            return refusal("busy", str(error))
        except OSError as error:
            return refusal("failed", text_of("job.no_start", error=error.strerror))
        _logger.info("%s started a %s of %s: %s", session.name, kind, board, title)
        return pb.CommandReply(accepted=True, text=text_of("job.started", title=title))

    def refused(self, session: LoginSession, act: str) -> pb.CommandReply | None:
        """Return the refusal, or None if the action is allowed.  An action restarts the idle time."""
        now_s = time.monotonic()
        if not self.sessions.is_open(session, now_s):
            return refusal("session-over", text_of("refusal.session_over"))
        self.sessions.acted(session, now_s)
        if not may(self.sessions.role(session), act):
            return refusal("not-allowed", refusal_text(session.name, session.role, act))
        return None


def slug(text: str) -> str:
    """Lower-case letters, digits and hyphens of `text`: it becomes part of a file name."""
    return re.sub(r"[^a-z0-9]+", "-", text.lower()).strip("-")


def refusal(reason: str, text: str) -> pb.CommandReply:
    """A refusal by the page."""
    return pb.CommandReply(refused_by="hmi", reason=reason, text=text)
