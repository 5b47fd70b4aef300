"""What a session may do, and doing it: every act of a page or a request passes here.  Blocking: call it in a thread.

Rule 1: rights are looked up at each act, in the session and the role of now: a page that was open before they changed
        gives none.
Rule 2: a refusal is a value with a reason and a sentence, whoever refused: page, gateway, board or link.
Rule 3: everything a person does goes out under the person's name, so the log shows who did what.
"""

from __future__ import annotations

import logging
import re
import time
from collections.abc import Callable
from pathlib import Path

from gateway.access.roles import Role, may, refusal_text
from gateway.access.users import Users
from gateway.views.feed import Feed
from gateway.views.hmi.jobs import Jobs
from gateway.views.hmi.library import Library
from gateway.views.hmi.sessions import Session, Sessions
from protocol.bus import board51_pb2 as pb
from protocol.errors import Board51Error

REPLAY_SITE = "replay"  # logs are replayed under this site, never under the one that is live
_logger = logging.getLogger("gateway.hmi")


class Console:
    """The acts.

    Args:
        feed: of the live site.
        replayed: of REPLAY_SITE.
        sessions: who is logged in.
        users: where roles come from; None: everybody here is the local operator.
        jobs: where recordings, campaigns and replays run.
        logs: files that may be replayed.
        reports: pages of diagnosis.
        data: folder for recordings and campaigns.
        bus_words: options with which a job joins the same bus.
    """

    def __init__(
        self,
        feed: Feed,
        replayed: Feed,
        sessions: Sessions,
        users: Users | None,
        *,
        jobs: Jobs,
        logs: Library,
        reports: Library,
        data: Path,
        bus_words: tuple[str, ...],
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.feed, self.replayed, self.sessions, self.users = feed, replayed, sessions, users
        self.jobs, self.logs, self.reports = jobs, logs, reports
        self._data, self._bus_words, self._clock = data, bus_words, clock

    def role(self, session: Session) -> Role:
        """The role of now: a changed users file counts at once; who was removed is a viewer until the session ends."""
        if self.users is not None:
            user = self.users.find(session.name)
            session.role = Role.VIEWER if user is None else user.role
        return session.role

    def may(self, session: Session, act: str) -> bool:
        """Whether a control is shown; each act asks again."""
        return may(self.role(session), act)

    def command(self, session: Session, board: str, what: pb.Command) -> pb.CommandReply:
        """Send a command to a board and wait for what becomes of it."""
        refused = self._refused(session, str(what.WhichOneof("what")))
        if refused is not None:
            return refused
        if self.feed.board(board) is None:
            return _refusal("no-board", f"Nothing has been heard of a board {board[:32]!r}.")
        try:
            return self.feed.command(board, what, who=session.name, role=self.role(session).word)
        except Exception as error:  # a bus that closed under us must not look like an accepted command
            _logger.warning("command of %s to %s: %s", session.name, board, error)
            return _refusal("not-delivered", f"The bus did not take the command: {error}.")

    def acknowledge(self, session: Session, board: str, alarm: str) -> pb.CommandReply:
        """Somebody has seen an alarm."""
        refused = self._refused(session, "acknowledge")
        if refused is not None:
            return refused
        if self.feed.acknowledge(board, alarm, session.name):
            return pb.CommandReply(accepted=True)
        return _refusal("no-alarm", "There is no such alarm, or it was acknowledged before.")

    def start_recording(self, session: Session, board: str, title: str) -> pb.CommandReply:
        """Log this board's bus into files of their own, beside the gateway's log."""
        name = slug(title)[:16] or "rec"
        words = ["record", "--out", str(self._data / "recordings"), "--prefix", f"{name}-{board}"[:32].rstrip("-_"),
                 "--board", board]  # fmt: skip
        return self._start(session, "recording", "record", board, words, title=title or "recording")

    def start_campaign(self, session: Session, board: str, *, quick: bool) -> pb.CommandReply:
        """The paper's experiments into a new folder."""
        folder = self._data / "campaigns" / f"{board}-{time.strftime('%Y%m%d-%H%M%S')}"
        words = ["campaign", "run", str(folder), "--board", board, "--who", session.name, *["--quick"] * quick]
        return self._start(session, "campaign", "campaign", board, words, title=folder.name)

    def start_replay(self, session: Session, log: str, speed: float) -> pb.CommandReply:
        """A log onto the replay site, with everything that travelled on the bus."""
        entry = self.logs.find(log)
        if entry is None:
            return _refusal("no-log", "There is no such log.")
        words = ["replay", str(entry.path), "--as-site", REPLAY_SITE, "--speed", f"{speed:g}", "--twin"]
        return self._start(session, "read", "replay", "*", words, title=entry.name)

    def stop_job(self, session: Session, kind: str, board: str) -> pb.CommandReply:
        """Interrupt a job; a campaign parks the ball."""
        act = {"record": "recording", "campaign": "stop", "replay": "read"}.get(kind, "")
        refused = self._refused(session, act)
        if refused is not None:
            return refused
        if self.jobs.stop(kind, board):
            return pb.CommandReply(accepted=True, text="It ends now.")
        return _refusal("not-running", "Nothing of that kind is running.")

    def _start(
        self, session: Session, act: str, kind: str, board: str, words: list[str], *, title: str
    ) -> pb.CommandReply:
        refused = self._refused(session, act)
        if refused is not None:
            return refused
        if board != "*" and self.feed.board(board) is None:
            return _refusal("no-board", f"Nothing has been heard of a board {board[:32]!r}.")
        try:
            if kind != "replay":
                self._data.mkdir(parents=True, exist_ok=True)
            self.jobs.start(kind, board, [*words, *self._bus_words], title=title, who=session.name)
        except Board51Error as error:
            return _refusal("busy", str(error))
        except OSError as error:
            return _refusal("failed", f"It cannot be started: {error.strerror}.")
        _logger.info("%s started a %s of %s: %s", session.name, kind, board, title)
        return pb.CommandReply(accepted=True, text=f"{title}: started")

    def _refused(self, session: Session, act: str) -> pb.CommandReply | None:
        """Why not; None where it is allowed.  An act is what a person does: the idle time begins anew."""
        now_s = self._clock()
        if not self.sessions.is_open(session, now_s):
            return _refusal("session-over", "The session is over: log in again.")
        self.sessions.acted(session, now_s)
        if not may(self.role(session), act):
            return _refusal("not-allowed", refusal_text(session.name, session.role, act))
        return None


def slug(text: str) -> str:
    """Lower-case letters, digits and hyphens of `text`: it becomes part of a file name."""
    return re.sub(r"[^a-z0-9]+", "-", text.lower()).strip("-")


def _refusal(reason: str, text: str) -> pb.CommandReply:
    return pb.CommandReply(refused_by="hmi", reason=reason, text=text)
