"""Runs what a view does for its clients: in threads of its own, and only while it is still wanted.

Rule 1: acts have threads of their own (ACTS), STOP has others (STOPS).  Neither waits for the view's reading and
        drawing, and STOP never waits for an act.
Rule 2: whether an act is still wanted is judged when its thread begins it, not when it arrives.  It is given up
        after FRESH_S, if its client has left, or if a STOP of its rig has arrived since.
Rule 3: an act is dated by its arrival at the view.  The gateway compares this date with the last STOP that it received
        (link/command_handler.py), so a STOP of another view gives it up, too.
"""

from __future__ import annotations

import asyncio
import math
import threading
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from typing import TypeVar

from protocol.bus import board51_pb2 as pb

T = TypeVar("T")

FRESH_S = 3.0  # with what `gateway.client.connection.send` may take (7 s) no more than a page or client waits
ACTS = 32  # that wait for their answers at once; a board that answers nothing holds one for 7 s
STOPS = 64  # the same for STOP
EVERY_RIG = "*"


@dataclass(slots=True, kw_only=True)
class Wish:
    """An act of a client, from its arrival on."""

    board: str  # its rig; "" for an act that concerns none
    arrived_s: float = field(default_factory=time.monotonic)
    has_left: bool = False  # the client

    @property
    def issued_ns(self) -> int:
        """The date for the gateway: Unix time of the arrival."""
        return time.time_ns() - round((time.monotonic() - self.arrived_s) * 1e9)


class Dispatch:
    """The threads of one view.

    Args:
        view: its name in refusals.
        stopped_s: Returns when the last STOP of a rig was seen on the bus, monotonic; -inf: none.
    """

    def __init__(self, view: str, stopped_s: Callable[[str], float]) -> None:
        self._view, self._stopped_s = view, stopped_s
        self._acts = ThreadPoolExecutor(ACTS, thread_name_prefix="act")
        self._stops = ThreadPoolExecutor(STOPS, thread_name_prefix="stop")
        self._lock = threading.Lock()
        self._stop_arrivals_s: dict[str, float] = {}  # rig -> arrival of its last STOP at this view

    async def act(self, wish: Wish, do: Callable[[], pb.CommandReply]) -> pb.CommandReply:
        """Do it in a thread, and return its reply or why it was given up."""

        def begin() -> pb.CommandReply:
            return self._refuse_outdated(wish) or do()

        return await asyncio.get_running_loop().run_in_executor(self._acts, begin)

    async def stop(self, boards: Sequence[str], do: Callable[[], T]) -> T:
        """Execute a STOP in a thread at once; commands to these rigs that still wait are refused."""
        now_s = time.monotonic()
        with self._lock:
            self._stop_arrivals_s.update(dict.fromkeys(boards, now_s))
        return await asyncio.get_running_loop().run_in_executor(self._stops, do)

    def _refuse_outdated(self, wish: Wish) -> pb.CommandReply | None:
        if wish.board and self._last_stop_s(wish.board) >= wish.arrived_s:
            return self._refusal(
                "superseded-by-stop", "A STOP of this rig arrived before this command was sent. Nothing was done."
            )
        age_s = time.monotonic() - wish.arrived_s
        if wish.has_left or age_s > FRESH_S:
            text = f"The command was delayed by {age_s:.1f} s. Nothing was done. Repeat it if it is still needed."
            return self._refusal("not-fresh", text)
        return None

    def _last_stop_s(self, board: str) -> float:
        with self._lock:
            stops_s = [self._stop_arrivals_s.get(name, -math.inf) for name in (board, EVERY_RIG)]
        return max(*stops_s, self._stopped_s(board))

    def _refusal(self, reason: str, text: str) -> pb.CommandReply:
        return pb.CommandReply(refused_by=self._view, reason=reason, text=text)
