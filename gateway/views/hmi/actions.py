"""Checks and executes the actions of all pages and requests.  Blocking: call it in a thread.

Rule 1: rights are checked for each action, with the current session and role, whatever an open page shows.
Rule 2: a refusal has a reason and a sentence.  That of gateway, board or link is a reply; that of the page is raised.
Rule 3: every action is sent under the user's name, so that the log shows who did what.
"""

from __future__ import annotations

import contextlib
import logging
import re
import time
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

from gateway.access.roles import may, refusal_text
from gateway.views.board_feed import UNSEEN_S
from gateway.views.feed import Feed
from gateway.views.hmi.jobs import Jobs
from gateway.views.hmi.library import Library, LibraryFile
from gateway.views.hmi.refusals import RefusalError
from gateway.views.hmi.sessions import LoginSession, LoginSessions
from gateway.views.hmi.texts import text_of
from gateway.views.listen import ACCOUNT
from protocol.bus import board51_pb2 as pb
from protocol.bus import topics
from protocol.errors import Board51Error

REPLAY_SITE = "replay"  # logs are replayed under this site, and on a bus of their own: never for live
WRITTEN_S = 30.0  # a log that is open is flushed far more often
# A replay shows the page as it was, with the twin of that time.
_EVERYTHING = [word for topic in topics.RECORDED for word in ("--topic", topic)]
# The act that whoever starts or ends a job of this kind must be allowed; to end a campaign, "stop" is enough.
_RIGHTS = dict.fromkeys(("identify", "validate", "diagnose", "bode", "compare", "design", "forecast"), "diagnose")
_RIGHTS |= {"record": "recording", "campaign": "campaign", "replay": "read", "hand-over": "use_model"}
_ORDER = re.compile(r"pause|play|(seek|speed) \d{1,9}(\.\d{1,6})?")
_logger = logging.getLogger("gateway.hmi")


@dataclass(frozen=True, slots=True, kw_only=True)
class Routes:
    """The options of `board51` by which jobs reach the bus, and the folders of files."""

    logs: Path  # of the gateway
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


@dataclass(frozen=True, slots=True, kw_only=True)
class Order:
    """A job that somebody wants to start."""

    session: LoginSession
    kind: str  # of the job
    board: str  # its rig; "*": none
    table: Mapping[str, object]  # keys of the request

    def word(self, key: str) -> str:
        """Return the text of a key; empty where there is none."""
        return str(self.table.get(key) or "")

    def flag(self, key: str) -> bool:
        """Return whether a key is true."""
        return self.table.get(key) is True


class Actions:
    """The acts.  `feed` is that of the live site, `replayed` that of the site of replays."""

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
        self.routes, self._replayed = routes, replayed

    def may(self, session: LoginSession, act: str) -> bool:
        """Return whether to show a control; each action checks the right again."""
        return may(self.sessions.role(session), act)

    def command(self, session: LoginSession, board: str, what: pb.Command, *, issued_ns: int = 0) -> pb.CommandReply:
        """Send a command that was issued at `issued_ns` (Unix time; 0: now) to a board, and wait for the reply."""
        self.check(session, str(what.WhichOneof("what")))
        self._check_board(board)
        role = self.sessions.role(session).word
        try:
            return self.feed.command(board, what, who=session.name, role=role, issued_ns=issued_ns)
        except Exception as error:  # a bus that closed under us must not look like an accepted command
            _logger.warning("command of %s to %s: %s", session.name, board, error)
            raise RefusalError("not-delivered", text_of("refusal.not_delivered", error=error)) from error

    def stop(self, session: LoginSession, board: str) -> dict[str, pb.CommandReply]:
        """Switch the coil off at once, of one board or ("*") of all boards of the site; return their replies.

        A campaign ends by itself with a STOP that it sees.  One that is just starting, or an investigation between two
        experiments, sees none and would lift the ball later: so it is interrupted as well.
        """
        boards = self.feed.boards() if board == "*" else (board,)

        def send(name: str) -> pb.CommandReply:
            try:
                return self.command(session, name, pb.Command(stop=pb.Stop()))
            except RefusalError as refusal:
                return refusal.reply

        try:
            with ThreadPoolExecutor(max(1, len(boards))) as pool:  # one that does not answer holds up no other
                return dict(zip(boards, pool.map(send, boards), strict=True))
        finally:
            with contextlib.suppress(RefusalError):
                self.check(session, "stop")
                for name in boards:
                    self.jobs.stop("campaign", name)

    def acknowledge_all(
        self, session: LoginSession, board: str, alarms: Sequence[str], *, issued_ns: int = 0
    ) -> pb.CommandReply:
        """Acknowledge alarms, each by a command of its own; return the first refusal, if there is one.

        An alarm that another person has acknowledged meanwhile is not a refusal.
        """
        with ThreadPoolExecutor(min(8, max(1, len(alarms)))) as pool:  # each may wait for its answer
            each = (pb.Command(acknowledge=pb.Acknowledge(alarm=alarm)) for alarm in alarms)
            replies = list(pool.map(partial(self.command, session, board, issued_ns=issued_ns), each))
        refused = next((r for r in replies if not r.accepted and r.reason != "no-alarm"), None)
        if refused is not None:
            return refused
        count = sum(reply.accepted for reply in replies)
        return pb.CommandReply(accepted=True, text=text_of("alarm.all_acknowledged", count=count))

    def remove(self, session: LoginSession, board: str) -> pb.CommandReply:
        """Take a rig that has not been seen for minutes off the pages and out of STOP for all rigs."""
        self.check(session, "acknowledge")
        if not self.feed.remove(board):
            raise RefusalError("in-use", text_of("refusal.rig_in_use", minutes=f"{UNSEEN_S / 60:g}"))
        return pb.CommandReply(accepted=True, text=text_of("refusal.removed", rig=board[:32]))

    def start_recording(self, order: Order) -> pb.CommandReply:
        """Log this board's bus into files of their own, beside the gateway's log."""
        title = order.word("title")
        prefix = f"{slug(title)[:16] or 'rec'}-{order.board}"[:32].rstrip("-_")
        words = ["record", "--out", str(self.routes.data / "recordings"), "--prefix", prefix, "--board", order.board]
        words += self.routes.live(ACCOUNT)
        return self.start_job(order, words, title=title or text_of("job_kind.record"))

    def start_replay(self, order: Order) -> pb.CommandReply:
        """Play a log onto the replay site, with everything that travelled on the bus."""
        entry = self.log(order.word("log"))
        words = ["replay", str(entry.path), "--control", "--json", "--speed", "1"]
        words += [*self.routes.replayed(), *_EVERYTHING]
        reply = self.start_job(replace(order, board="*"), words, title=entry.name)
        self._replayed.forget()  # what the last replay left
        return reply

    def order_replay(self, session: LoginSession, order: str) -> pb.CommandReply:
        """Give an order to the replay that runs: pause, play, seek S, speed N."""
        self.check(session, "read")
        if not _ORDER.fullmatch(order):
            raise RefusalError("malformed", text_of("replay.no_order"))
        if not self.jobs.tell("replay", "*", order):
            raise RefusalError("not-running", text_of("job.not_running"))
        return pb.CommandReply(accepted=True)

    def log(self, name: str) -> LibraryFile:
        """Return a log or recording.  Raises RefusalError if there is none of that name."""
        return _entry_of(self.logs, name, RefusalError("no-log", text_of("refusal.no_log"), status=404))

    def report(self, name: str) -> LibraryFile:
        """Return a report of a diagnosis.  Raises RefusalError if there is none of that name."""
        return _entry_of(self.reports, name, RefusalError("no-report", text_of("refusal.no_report"), status=404))

    def delete_log(self, session: LoginSession, name: str) -> pb.CommandReply:
        """Delete a log or recording for good; never one of a campaign, or one that is being written."""
        self.check(session, "delete_log")
        entry = self.log(name)
        if entry.name.startswith("campaigns/"):
            raise RefusalError("of-a-campaign", text_of("refusal.log_of_campaign"))
        if time.time() - entry.changed_s < WRITTEN_S:
            raise RefusalError("in-use", text_of("refusal.log_in_use", seconds=f"{WRITTEN_S:g}"))
        try:
            entry.path.unlink()
        except OSError as error:
            raise RefusalError("failed", text_of("refusal.no_delete", error=error.strerror)) from None
        _logger.info("%s deleted %s", session.name, entry.path)
        return pb.CommandReply(accepted=True, text=text_of("refusal.deleted", log=entry.name))

    def stop_job(self, session: LoginSession, kind: str, board: str) -> pb.CommandReply:
        """Interrupt a job; a campaign parks the ball."""
        self.check(session, "stop" if kind == "campaign" else _RIGHTS[kind])
        if not self.jobs.stop(kind, board):
            raise RefusalError("not-running", text_of("job.not_running"))
        return pb.CommandReply(accepted=True, text=text_of("job.ending"))

    def start_job(self, order: Order, words: list[str], *, title: str) -> pb.CommandReply:
        """Start `board51 WORDS`; one job of a kind and board at a time."""
        self.check_order(order)
        if order.board != "*":
            self._check_board(order.board)
        try:
            if order.kind != "replay":
                self.routes.data.mkdir(parents=True, exist_ok=True)
            self.jobs.start(order.kind, order.board, words, title=title, who=order.session.name)
        except Board51Error as error:
            raise RefusalError("busy", str(error)) from None
        except OSError as error:
            raise RefusalError("failed", text_of("job.no_start", error=error.strerror)) from None
        _logger.info("%s started a %s of %s: %s", order.session.name, order.kind, order.board, title)
        return pb.CommandReply(accepted=True, text=text_of("job.started", title=title))

    def check_order(self, order: Order) -> None:
        """Check the right to start a job, as `check` does."""
        self.check(order.session, _RIGHTS[order.kind])

    def check(self, session: LoginSession, act: str) -> None:
        """Check the right to act.  An action restarts the idle time.

        Raises:
            RefusalError: the session is over, or its user may not do that.
        """
        now_s = time.monotonic()
        if not self.sessions.is_open(session, now_s):
            raise RefusalError("session-over", text_of("refusal.session_over"))
        self.sessions.acted(session, now_s)
        if not may(self.sessions.role(session), act):
            raise RefusalError("not-allowed", refusal_text(session.name, session.role, act))

    def _check_board(self, board: str) -> None:
        if self.feed.board(board) is None:
            raise RefusalError("no-board", text_of("refusal.no_board", board=repr(board[:32])))


def _entry_of(library: Library, name: str, refusal: RefusalError) -> LibraryFile:
    entry = library.find(name)
    if entry is None:
        raise refusal
    return entry


def slug(text: str) -> str:
    """Lower-case letters, digits and hyphens of `text`: it becomes part of a file name."""
    return re.sub(r"[^a-z0-9]+", "-", text.lower()).strip("-")
