"""Logins: authentication by `users.py` with the rate limit of `tries.py`.  For one event loop.

Rule: logins use AT_ONCE threads of their own, so that they delay neither STOP nor anything else.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Awaitable, Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

from gateway.access.tries import Tries
from gateway.access.users import User, Users

AT_ONCE = 2
PATIENCE_S = 10.0  # longest wait of a user at a form


@dataclass(frozen=True, slots=True)
class TooMany:
    """The attempt was refused by the rate limit; the password was not checked."""

    wait_s: float  # time until another attempt is possible


class Logins:
    """The logins of one server."""

    def __init__(
        self,
        users: Users,
        *,
        clock: Callable[[], float] = time.monotonic,
        sleep: Callable[[float], Awaitable[None]] = asyncio.sleep,
    ) -> None:
        self._users, self._clock, self._sleep = users, clock, sleep
        self._tries = Tries()
        self._pool = ThreadPoolExecutor(AT_ONCE, "login")

    async def login(self, name: str, password: str, host: str, *, browser: str = "") -> User | TooMany | None:
        """Check a login; returns None for a wrong name or password.  `browser` is as of `Tries.turn`."""
        turn = self._tries.turn(name, host, self._clock(), patience_s=PATIENCE_S, browser=browser)
        if not turn.granted:
            return TooMany(turn.wait_s)
        if turn.wait_s:
            await self._sleep(turn.wait_s)
        user = await asyncio.get_running_loop().run_in_executor(self._pool, self._users.check, name, password)
        if user is not None:
            self._tries.right(turn, name, host)
        return user

    def at_once(self, name: str, password: str, host: str) -> User | TooMany | None:
        """`login` for a caller that cannot wait."""
        turn = self._tries.turn(name, host, self._clock(), patience_s=0.0)
        if not turn.granted:
            return TooMany(turn.wait_s)
        user = self._users.check(name, password)
        if user is not None:
            self._tries.right(turn, name, host)
        return user
