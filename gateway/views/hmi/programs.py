"""The sessions of programs: by a bearer token, or, where the page needs no login, of this machine's user.

Rule: a token opens the paths of `is_api` and nothing else; the cookie of a browser is not a token (guard.py).
"""

from __future__ import annotations

from collections.abc import Mapping

from gateway.access.roles import Role
from gateway.access.tokens import digest_of
from gateway.access.users import User
from gateway.views.hmi.sessions import LoginSession, LoginSessions
from protocol.bus.identity import login_name

VERSION = "/api/v1"
METRICS = "/metrics"
# Of the page: its description of the API, and the requests of a page whose rig is called v1; see requests.py.
_OF_PAGE = frozenset(("", "stop", "command", "acknowledge", "gains", "job", "delete", "remove", "export"))


def is_api(path: str) -> bool:
    """Return whether a path is for programs."""
    below = path.removeprefix(f"{VERSION}/")
    return path == METRICS or (below != path and below.partition("/")[0] not in _OF_PAGE)


class Programs:
    """The sessions of one server's programs, one for each token.

    Args:
        sessions: where they are opened; without users every program is the local operator.
    """

    def __init__(self, sessions: LoginSessions) -> None:
        self._sessions = sessions
        self._granted: dict[str, LoginSession] = {}

    def session(self, headers: Mapping[str, str], now_s: float) -> LoginSession | None:
        """Return the session of a request's token; None: it has none, or that is not valid."""
        scheme, _, token = headers.get("authorization", "").partition(" ")
        grant, user = "", None
        if self._sessions.users is None:
            user = User(name=login_name("local operator"), role=Role.ENGINEER)
        elif scheme.lower() == "bearer":
            grant = digest_of(token.strip())
            user = self._sessions.users.bearer(grant)
        if user is None:
            return None
        session = self._granted.get(grant)
        if session is None or session.name != user.name or not self._sessions.is_open(session, now_s):
            session = self._granted[grant] = self._sessions.open(user.name, user.role, now_s, grant=grant)
        return session
