"""The newest samples of every board, kept whether or not somebody looks: what happened just now can be read.

Rule: memory is bounded, LONGEST_S at 500 Hz for each board: 13 MB.
"""

from __future__ import annotations

import threading
from collections import deque

from gateway.views.board_feed import BoardFeed
from protocol.bus import board51_pb2 as pb

LONGEST_S = 60.0
MAX_SAMPLES = 30_000
LOOK_S = 0.25  # a new board is noticed so soon


class Samples:
    """The newest samples of one board."""

    def __init__(self, board: BoardFeed) -> None:
        self.board = board
        self._states: deque[pb.State] = deque(maxlen=MAX_SAMPLES)
        self._lock = threading.Lock()
        board.attach(pb.State, self)

    def push(self, message: pb.State) -> None:
        """Take in a sample; called by the feed."""
        with self._lock:
            self._states.append(message)

    def last(self, seconds: float) -> list[pb.State]:
        """Return the samples that arrived in the last `seconds`, the oldest first.

        Now is the arrival of the newest sample and its age: the clocks of the gateway's host and of ours may differ.
        """
        with self._lock:
            states = list(self._states)
        if not states:
            return []
        begin_ns = states[-1].host_time_ns - round(1e9 * (seconds - self.board.age_s(pb.State)))
        first = next((n for n, state in enumerate(states) if state.host_time_ns >= begin_ns), len(states))
        return states[first:]
