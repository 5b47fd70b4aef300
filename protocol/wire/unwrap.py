"""Sixteen-bit sequence numbers in, board ticks out.  No clock: every call is told the time.

Rule 1: a tick is published once and in rising order; what cannot be placed is counted, never guessed.
Rule 2: a frame can be late, never early.  Since the best arrival so far says when tick 0 was, a sequence that would
        lie in the future is either noise that passed the CRC (once in 65536) or a restarted board.
Rule 3: a step that breaks rule 2 or goes back is held until the next frame confirms it by following it; if that one
        follows the old count instead, the held one was noise (`implausible`) and the count never moved.
Rule 4: losses are counted against the divider of the stream; while it is not known, against the smallest step seen.
"""

from __future__ import annotations

from typing import NamedTuple

from protocol.wire.decoder import State

WRAP = 1 << 16
_EARLY_TICKS = 25  # 50 ms at T_s = 2 ms: queueing of the anchoring answer, drift of both clocks between two anchors
_LATE_TICKS = 256  # an answer overtaken by this many states still speaks of the same run of the board
_LEAD_WINDOW_S = 10.0  # the best arrival is forgotten after at most twice this, so that clock drift does not add up
_FAST_S = 60.0  # below half a wrap of 131 s the next sequence number is unambiguous


class Placed(NamedTuple):
    """A state with its place in time."""

    tick: int  # since the board's reset
    lost_before: int  # states missing directly before this one
    state: State


class Jump(NamedTuple):
    """The count cannot go on; nothing is placed until the next `restart`."""

    board_reset: bool  # False: the board may never have restarted, but continuity cannot be claimed


class TickUnwrapper:
    """Follows one board's tick.  Call `restart` with a tick heard in full before the first `feed`."""

    def __init__(self) -> None:
        self.duplicates = 0
        self.implausible = 0
        self.lost = 0
        self.divider: int | None = None  # None: not known
        self._smallest_step = WRAP
        self._rate = 500.0
        self._last = -_LATE_TICKS
        self._last_s = 0.0
        self._first = True
        self._held: tuple[State, float] | None = None
        self._lead = self._next_lead = 0.0
        self._window_end_s = 0.0
        self._quick = False

    @property
    def last_tick(self) -> int:
        """The newest tick placed; before the first one, what the anchor said."""
        return max(self._last, 0)

    def restart(self, tick: int, now_s: float, *, sample_time_s: float | None = None) -> None:
        """Begin a count near `tick`, heard in full at `now_s`; T_s in seconds where it is news."""
        if sample_time_s is not None:
            self._rate = 1.0 / sample_time_s
        self._last = tick - _LATE_TICKS
        self._last_s = now_s
        self._first = True
        self._held = None
        self._quick = False
        self._smallest_step = WRAP
        self._lead = self._next_lead = tick - now_s * self._rate
        self._window_end_s = now_s + _LEAD_WINDOW_S

    def anchor(self, tick: int, now_s: float) -> bool:
        """A tick heard in full (PONG).  False: it is behind what was placed, so the board restarted."""
        if tick < self._last - _LATE_TICKS:
            return False
        self._arrived(tick, now_s)
        if tick - self._last > WRAP // 2:
            self._quick = False  # after a long silence the next sequence number alone is ambiguous
        return True

    def feed(self, state: State, now_s: float) -> list[Placed | Jump]:
        """Place a state that arrived at `now_s`; nothing, one, or after a confirmed jump several results."""
        step = (state.sequence - self._last) & 0xFFFF
        if step == self.divider and self._quick and now_s - self._last_s < _FAST_S:
            self._last += step
            self._last_s = now_s
            return [Placed(self._last, 0, state)]
        return self._feed_slowly(state, now_s)

    def settle(self, now_s: float) -> None:
        """Once per read, after its states: the newest of them is the best witness of the board's clock."""
        if not self._first:
            self._arrived(self._last, now_s)

    def _feed_slowly(self, state: State, now_s: float) -> list[Placed | Jump]:
        if not self._first and state.sequence == self._last & 0xFFFF and now_s - self._last_s < _FAST_S:
            self.duplicates += 1
            return []
        tick = self._candidate(state.sequence, now_s)
        if tick <= now_s * self._rate + self._lead + _EARLY_TICKS:
            if self._held is not None:
                self._drop_held()
            return [self._place(tick, state, now_s)]
        held, self._held = self._held, (state, now_s)
        self._quick = False  # the next frame decides about this one, also if it follows the old count
        if held is None:
            return []
        if not 0 < (state.sequence - held[0].sequence) & 0xFFFF <= max(self.divider or 1, _EARLY_TICKS):
            self._count_noise(held[0])
            return []
        self._held = None
        return self._jump(held, (state, now_s))

    def _candidate(self, sequence: int, now_s: float) -> int:
        """The first tick after the last one with this sequence number, moved on by the wraps that time allows."""
        tick = self._last + 1 + ((sequence - self._last - 1) & 0xFFFF)
        latest = now_s * self._rate + self._lead + _EARLY_TICKS
        if tick < 0:
            tick += WRAP
        return tick + max(0, int((latest - tick) // WRAP)) * WRAP

    def _place(self, tick: int, state: State, now_s: float) -> Placed:
        lost = 0
        if not self._first:
            step = tick - self._last
            self._smallest_step = min(step, self._smallest_step)
            lost = (step - 1) // (self.divider or self._smallest_step)
            self.lost += lost
        self._last, self._last_s, self._first, self._quick = tick, now_s, False, True
        return Placed(tick, lost, state)

    def _jump(self, first: tuple[State, float], second: tuple[State, float]) -> list[Placed | Jump]:
        sequence, now_s = first[0].sequence, first[1]
        # A board that restarted since the last state cannot be further than the time since then.
        board_reset = sequence <= (now_s - self._last_s) * self._rate + _EARLY_TICKS
        ahead = (sequence - self._last) & 0xFFFF
        if not board_reset and ahead < WRAP // 2:
            # Two frames agree on a step forward that is too early by our clock: the board runs faster than it says
            # (an emulator at --speed 20).  The losses are real, the continuity too.
            self._lead = self._next_lead = self._last + ahead - now_s * self._rate
            placed = self._place(self._last + ahead, *first)
            return [placed, *self.feed(*second)]
        return [Jump(board_reset)]

    def _drop_held(self) -> None:
        assert self._held is not None
        self._count_noise(self._held[0])
        self._held = None

    def _count_noise(self, state: State) -> None:
        behind = (self._last - state.sequence) & 0xFFFF
        if behind < _LATE_TICKS:
            self.duplicates += 1
        else:
            self.implausible += 1

    def _arrived(self, tick: int, now_s: float) -> None:
        lead = tick - now_s * self._rate
        if now_s > self._window_end_s:
            self._lead, self._next_lead = self._next_lead, lead
            self._window_end_s = now_s + _LEAD_WINDOW_S
        if lead > self._next_lead:
            self._next_lead = lead
        if lead > self._lead:
            self._lead = lead
