"""Name and password in, the user out: `users.py` behind the pace of `tries.py`.  One event loop.

Rule: a login takes no thread but AT_ONCE of its own.  STOP and everything else that runs beside it has others.
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
PATIENCE_S = 10.0  # a person at a form waits for so long


@dataclass(frozen=True, slots=True)
class TooMany:
    """The password was not looked at."""

    wait_s: float  # before it is worth coming again


class Logins:
    """Of one server.

    Args:
        users: who there is.
        clock: monotonic seconds.
        sleep: as asyncio's.
    """

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
        """The user; None for a wrong name and a wrong password alike.

        Args:
            name: as typed.
            password: as typed.
            host: address that it comes from.
            browser: token of a session that this browser has or had under this name.
        """
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
        """The same for a caller that cannot wait."""
        turn = self._tries.turn(name, host, self._clock(), patience_s=0.0)
        if not turn.granted:
            return TooMany(turn.wait_s)
        user = self._users.check(name, password)
        if user is not None:
            self._tries.right(turn, name, host)
        return user
