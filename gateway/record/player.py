"""Plays a log at its pace: once, or under orders that arrive while it plays: pause, play, seek, speed.

Rule 1: an order is a line of text: `pause`, `play`, `seek S` (from the first message of the log), `speed N`.  A line
        that is none of them is passed over.
Rule 2: it stays at the end, where `seek` brings it back.
Rule 3: a seek while it pauses sends GLANCE_S of the log, so that there is something to look at.
Rule 4: speed is log seconds per second; at 0 each record is due at once.
"""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable, Iterable
from typing import Any

from protocol.log.reader import RawLogRecord

GLANCE_S = 0.1
MIN_SPEED, MAX_SPEED = 0.1, 100.0
_LOOK_S = 0.2  # longest sleep between two checks of `stop`


class Player:
    """A log that is played.

    Args:
        records: Of the log from a time on, s.
        send: Called for each record.
        next_order: Returns the next order; None if none comes within the given seconds.
        sought: Called before the first record after a seek.
        report: Called with {"state": "playing" | "paused" | "ended", "speed": N} at each change.
        stop: Set it to end.
        now_s: Monotonic clock, s.
    """

    def __init__(
        self,
        records: Callable[[float], Iterable[RawLogRecord]],
        send: Callable[[RawLogRecord], None],
        *,
        next_order: Callable[[float], str | None],
        sought: Callable[[], None],
        report: Callable[[dict[str, Any]], None],
        stop: threading.Event,
        now_s: Callable[[], float] = time.monotonic,
    ) -> None:
        self._records, self._send, self._sought, self._report = records, send, sought, report
        self._next_order, self._stop, self._now_s = next_order, stop, now_s
        self._speed, self._state = 1.0, "playing"
        self._seek_s: float | None = None
        self._anchor: tuple[float, int] | None = None  # a moment of the clock and the log time that belongs to it
        self._first_ns = self._newest_ns = 0  # of this pass

    def play(self, start_s: float, speed: float) -> float:
        """Play once from `start_s` to the end or `stop`; return the log time of what was sent, s."""
        self._speed = speed
        self._pass(start_s)
        return (self._newest_ns - self._first_ns) / 1e9

    def run(self, start_s: float, speed: float) -> None:
        """Play from `start_s` under orders until `stop`."""
        self._speed, self._seek_s = speed, start_s
        self._changed("playing")
        while not self._stop.is_set():
            if self._seek_s is None:
                self._obey(_LOOK_S)  # at the end
                continue
            position_s, self._seek_s = self._seek_s, None
            if self._pass(position_s):
                self._changed("ended")

    def _pass(self, position_s: float) -> bool:
        """Send from a position on; return whether the end was reached."""
        self._anchor, self._first_ns, self._newest_ns = None, 0, 0
        for number, record in enumerate(self._records(position_s)):
            if number == 0:
                self._first_ns = record.time_ns
            # Log times may run back by a little: such a record is due at once.
            self._newest_ns = max(record.time_ns, self._newest_ns)
            if not self._await(self._newest_ns):
                return False
            self._send(record)
        return True

    def _await(self, time_ns: int) -> bool:
        """Wait until a record is due; False: a seek, or the end, came first."""
        while not self._stop.is_set():
            paused = self._state == "paused"
            if self._anchor is None:
                self._anchor = (self._now_s(), time_ns)
            lasts_s = (time_ns - self._anchor[1]) / 1e9 / self._speed if self._speed else 0.0
            wait_s = self._anchor[0] + lasts_s - self._now_s()
            is_due = time_ns <= self._first_ns + GLANCE_S * 1e9 if paused else wait_s <= 0.0
            self._obey(0.0 if is_due else _LOOK_S if paused else min(wait_s, _LOOK_S))
            if self._seek_s is not None:
                return False
            if is_due and paused == (self._state == "paused"):
                return True
        return False

    def _obey(self, limit_s: float) -> None:
        """Carry out the orders that have come, waiting for the first one."""
        while (line := self._next_order(limit_s)) is not None:
            limit_s = 0.0
            word, _, value = line.strip().partition(" ")
            try:
                self._carry_out(word, float(value) if value else math.nan)
            except ValueError:
                continue

    def _carry_out(self, word: str, number: float) -> None:
        if word == "seek" and 0.0 <= number < math.inf:
            self._seek_s = number
            self._sought()
            self._changed("playing" if self._state == "ended" else self._state)
        elif word == "speed" and MIN_SPEED <= number <= MAX_SPEED:
            self._speed = number
            self._changed(self._state)
        elif word in ("pause", "play") and self._state != "ended":
            self._changed("paused" if word == "pause" else "playing")
        elif word == "play":
            self._seek_s = 0.0
            self._sought()
            self._changed("playing")

    def _changed(self, state: str) -> None:
        self._state = state
        if self._anchor is not None:  # the clock goes on from here
            self._anchor = (self._now_s(), self._newest_ns)
        self._report({"state": state, "speed": self._speed})
