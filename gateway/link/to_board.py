"""Supervision of the direction from the host to one board, by the board's answers alone.  No I/O.

    unknown      no answer has arrived yet
    answering    the last frame sent was answered, or has not waited long
    unanswered   frames of the board arrive, but no answers: a STOP may not reach it

Rule 1: a wait counts only while frames arrive without a pause.  A pause of the board or of the host, or a
        cut of the other direction, also delays answers.  It must not be taken for a cut line to the board.
Rule 2: only an answer ends `unanswered`, or another port.
"""

from __future__ import annotations

from collections.abc import Callable

UNANSWERED_S = 1.0  # ten repetitions at the default time-out
UNKNOWN, ANSWERING, UNANSWERED = "unknown", "answering", "unanswered"
_PAUSE_S = 0.25
_NEVER = float("inf")


class ToBoard:
    """Supervises the direction from the host to one board; calls `changed` with each new state."""

    def __init__(self, changed: Callable[[str], None]) -> None:
        self.state = UNKNOWN
        self.deadline_s = _NEVER  # when `judge` has something to do
        self._changed = changed
        self._waits_since_s: float | None = None  # the first that was sent after the last answer or pause
        self._unanswered_since_s = 0.0
        self._last_frame_s = -_NEVER

    def begin(self) -> None:
        """Reset the state after a port was opened or lost."""
        self._wait(None)
        self._last_frame_s = -_NEVER
        self._become(UNKNOWN)

    def sent(self, now_s: float) -> None:
        """Note that bytes were sent that require an answer."""
        # From the first frame without an answer: each repetition would put the limit off.
        if self._waits_since_s is None:
            self._wait(now_s)

    def frames_arrived(self, now_s: float, period_s: float) -> None:
        """Note that valid frames of any kind arrived; `period_s` is the period of the stream."""
        # A pause delays answers as well, so the wait begins again: a pause of the host is not a cut line.
        pause_s = now_s - self._last_frame_s
        if pause_s > _PAUSE_S and pause_s > 3 * period_s:
            self._wait(None)
        self._last_frame_s = now_s

    def answered(self) -> None:
        """Note that an answer arrived."""
        self._wait(None)
        self._become(ANSWERING)

    def unanswered_s(self, now_s: float) -> float:
        """Return for how long the board has not answered, s; 0 if it answers."""
        return now_s - self._unanswered_since_s if self.state == UNANSWERED else 0.0

    def judge(self, now_s: float) -> None:
        """Check whether an answer has been missing for too long."""
        waited_from_s = self._waits_since_s
        if waited_from_s is None or now_s < waited_from_s + UNANSWERED_S:
            return
        self.deadline_s = _NEVER
        if self._last_frame_s < waited_from_s + UNANSWERED_S / 2:  # little has come since: the next frames tell
            self._wait(None)
        elif self.state != UNANSWERED:
            self._unanswered_since_s = waited_from_s
            self._become(UNANSWERED)

    def _wait(self, since_s: float | None) -> None:
        self._waits_since_s = since_s
        self.deadline_s = _NEVER if since_s is None else since_s + UNANSWERED_S

    def _become(self, state: str) -> None:
        if state != self.state:
            self.state = state
            self._changed(state)
