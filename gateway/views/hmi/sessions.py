"""Login sessions of browsers, by an unguessable cookie and with limited time.  Pure: the caller passes the time.

Rule 1: a session ends after `idle_s` without an action of the user, and after `lifetime_s` in any case.  An open page
        is not an action: it receives frames even if nobody is at the screen.
Rule 2: the token of a session is in an HttpOnly cookie; `csrf` is in the page, and every request that changes something
        must bear it.
Rule 3: the sessions of a removed user end at once, even while a page is open.
Rule 4: the session of a program does not end with time: each of its requests bears a token, and it ends with that.
Rule 5: memory is bounded: the session that was idle longest makes room.
"""

from __future__ import annotations

import math
import secrets
from collections import OrderedDict
from dataclasses import dataclass, field

from gateway.access.roles import Role
from gateway.access.users import User, Users

MAX_SESSIONS = 256


@dataclass(slots=True, kw_only=True)
class LoginSession:
    """A login of one person, or of a program for one."""

    name: str
    role: Role
    opened_s: float  # monotonic
    acted_s: float
    grant: str | None = None  # of a program: the digest of its token; empty: none is needed.  None: of a browser
    token: str = field(default_factory=lambda: secrets.token_urlsafe(32))
    csrf: str = field(default_factory=lambda: secrets.token_urlsafe(32))


class LoginSessions:
    """The open sessions.

    Args:
        users: where roles come from; None: no login is needed, and everybody here is the local operator.
        idle_s: time without an action that ends a session.
        lifetime_s: so long after login it is over in any case.
    """

    def __init__(self, users: Users | None = None, *, idle_s: float, lifetime_s: float) -> None:
        self.users, self.idle_s, self.lifetime_s = users, idle_s, lifetime_s
        self._open: dict[str, LoginSession] = {}
        self._names: OrderedDict[str, str] = OrderedDict()  # by token, also of sessions that are over

    def open(self, name: str, role: Role, now_s: float, *, grant: str | None = None) -> LoginSession:
        """A new session; the caller has checked who it is.  `grant`: see LoginSession."""
        for token in [t for t, s in self._open.items() if self.left_s(s, now_s) <= 0.0]:
            del self._open[token]
        if len(self._open) >= MAX_SESSIONS:
            del self._open[min(self._open.values(), key=lambda s: (s.grant is not None, s.acted_s)).token]
        session = LoginSession(name=name, role=role, opened_s=now_s, acted_s=now_s, grant=grant)
        self._open[session.token] = session
        self._names[session.token] = name
        if len(self._names) > MAX_SESSIONS:
            self._names.popitem(last=False)
        return session

    def held(self, token: str, name: str) -> str:
        """The token if it is, or was, of a session of `name`, else ""."""
        return token if self._names.get(token) == name else ""

    def get(self, token: str, now_s: float) -> LoginSession | None:
        """Return the session of a cookie, or None if there is none or it has ended."""
        session = self._open.get(token)
        if session is not None and (self.left_s(session, now_s) <= 0.0 or not self._is_known(session)):
            self._open.pop(token, None)
            return None
        return session

    def is_open(self, session: LoginSession, now_s: float) -> bool:
        """Return whether the session is still valid."""
        return self.get(session.token, now_s) is session

    def role(self, session: LoginSession) -> Role:
        """Return the current role: a change of the users file takes effect at once."""
        if self.users is not None:
            user = _user_of(session, self.users)
            session.role = Role.VIEWER if user is None else user.role  # None: the session is over, too
        return session.role

    def _is_known(self, session: LoginSession) -> bool:
        return self.users is None or _user_of(session, self.users) is not None

    def acted(self, session: LoginSession, now_s: float) -> None:
        """Restart the idle time after an action of the user."""
        session.acted_s = max(session.acted_s, now_s)

    def left_s(self, session: LoginSession, now_s: float) -> float:
        """Return the remaining time without further actions, s; infinite for a program."""
        if session.grant is not None:
            return math.inf
        return min(session.acted_s + self.idle_s, session.opened_s + self.lifetime_s) - now_s

    def close(self, session: LoginSession) -> None:
        """Log out."""
        self._open.pop(session.token, None)


def _user_of(session: LoginSession, users: Users) -> User | None:
    return users.bearer(session.grant) if session.grant else users.find(session.name)
