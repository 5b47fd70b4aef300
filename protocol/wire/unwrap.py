"""Converts the 16-bit sequence numbers of states into board ticks.  No clock: the caller passes the time.

Rule 1: a tick is published once and in rising order; states that cannot be placed are counted, never guessed.
Rule 2: a frame can be late, never early.  The earliest arrival so far bounds the time of tick 0.  A sequence that
        would lie in the future is therefore noise that passed the CRC (once in 65536), or the board restarted.
Rule 3: no single frame moves the count.  The one witness besides the frame itself is, for the step of the stream, the
        count so far; for any other step, the state that follows it; for a full tick (PONG, EVENT) that contradicts the
        count, another full tick.  Until then the frame is held; if the next one goes on from the old count, the held
        one was noise (`implausible`).
Rule 4: sequences do not contain the number of wraps, so it is not derived from them.  The count ends and is requested
        again after half a wrap without a state or a full tick.  So it is after a step forward that the host's clock
        does not allow.
Rule 5: losses are counted against the divider of the stream; while it is not known, against the smallest step seen.
"""

from __future__ import annotations

from typing import NamedTuple

from protocol.wire.decoder import State
from protocol.wire.events import Sample

WRAP = 1 << 16
_HALF_WRAP = WRAP // 2
_TICK_BITS = 32
_EARLY_TICKS = 25  # 50 ms at T_s = 2 ms: queueing of the anchoring answer, drift of both clocks between two anchors
_OVERTAKEN_TICKS = 256  # an answer overtaken by this many states still speaks of the same run of the board
_LEAD_WINDOW_S = 10.0  # the best arrival is forgotten after at most twice this, so that clock drift does not add up
_CLAIM_S = 1.0  # a contradiction that no second full tick confirms within this time is dropped


class Jump(NamedTuple):
    """The count of ticks ends; no state is placed until the next `restart`."""

    board_reset: bool  # False: the board may never have restarted, but continuity cannot be claimed
    doubtful: tuple[int, int] | None = None  # ticks, first and last, placed since a full tick agreed for the last time


class TickUnwrapper:
    """Tracks one board's tick.  Call `restart` with a full tick before the first `feed`.

    Every state is placed, counted in `duplicates`, `implausible` or `unplaced`, or waits (at most two do).
    """

    def __init__(self) -> None:
        self.session = 0  # of the samples
        self.duplicates = 0
        self.implausible = 0
        self.unplaced = 0  # possibly valid, but the count ended, or was in doubt, before a second frame confirmed them
        self.lost = 0
        self.divider: int | None = None  # None: not known
        self._smallest_step = WRAP
        self._rate = 500.0
        self._sure_s = _HALF_WRAP / self._rate
        self._last = -_OVERTAKEN_TICKS
        self._last_s = 0.0
        self._first = True
        self._witnessed = 0  # the newest full tick that agreed
        self._witnessed_s = 0.0
        self._gap: Sample | None = None  # in time, but not the next one: waits for its successor
        self._unexpected: tuple[State, float] | None = None  # too early, or back: waits for its successor
        self._claim: tuple[int, float] | None = None  # a full tick that contradicts the count
        self._lead = self._next_lead = 0.0
        self._window_end_s = 0.0
        self._quick = False

    @property
    def in_doubt(self) -> bool:
        """Return whether a full tick contradicts the count, so that a second full tick is needed."""
        return self._claim is not None

    def restart(self, tick: int, now_s: float, *, sample_time_s: float | None = None) -> None:
        """Begin a count at the full tick `tick`, received at `now_s`; pass T_s in seconds if it is new."""
        if sample_time_s is not None:
            self._rate = 1.0 / sample_time_s
            self._sure_s = _HALF_WRAP / self._rate
        self.give_up()
        self._last = tick - _OVERTAKEN_TICKS
        self._last_s = now_s
        self._witnessed, self._witnessed_s = tick, now_s
        self._first = True
        self._quick = False
        self._smallest_step = WRAP
        self._lead = self._next_lead = tick - now_s * self._rate
        self._window_end_s = now_s + _LEAD_WINDOW_S

    def give_up(self) -> None:
        """Count the waiting states as unplaced: no further states follow."""
        self.unplaced += (self._gap is not None) + (self._unexpected is not None)
        self._gap = self._unexpected = self._claim = None

    def stream(self, divider: int) -> None:
        """Set the divider: the board sends every n-th tick (0: none); ticks that it skips are not losses."""
        self.divider = divider or None
        if not divider:
            self._first, self._quick = True, False

    def witness(self, tick: int, now_s: float) -> Jump | None:
        """Compare a full tick, modulo 2^32 (PONG, EVENT), with the count; a second contradiction gives a Jump."""
        tick = self._last + _signed(tick - self._last)
        if self._last - _OVERTAKEN_TICKS <= tick <= max(self._latest(now_s), self._last + _EARLY_TICKS):
            self._claim = None
            self._agreed(tick, now_s)
            return None
        claim, self._claim = self._claim, (tick, now_s)
        # One full tick does not end the count: noise passes the CRC once in 65536.
        if claim is None or now_s - claim[1] > _CLAIM_S or not -_OVERTAKEN_TICKS <= tick - claim[0] < _HALF_WRAP:
            return None
        ahead = tick - self._last
        if 0 < ahead < _HALF_WRAP:  # a board that runs faster than it says (an emulator at --speed 20), little streamed
            self._claim = None
            self._agreed(tick, now_s)
            return None
        doubtful = (self._witnessed, self._last) if self._last > self._witnessed else None
        self.give_up()
        return Jump(ahead < 0, doubtful)

    def feed(self, state: State, now_s: float) -> list[Sample | Jump]:
        """Place a state that arrived at `now_s`; return no, one, or (with states that waited) several results."""
        tick = self.following(state.sequence, now_s)
        return self._feed_slowly(state, now_s) if tick is None else [Sample(tick, self.session, 0, state, now_s)]

    def following(self, sequence: int, now_s: float) -> int | None:
        """Place the very next state of an undisturbed stream, and return its tick; None: `feed` decides."""
        step = (sequence - self._last) & 0xFFFF
        if step != self.divider or not self._quick or now_s - self._last_s >= self._sure_s:
            return None
        self._last += step
        self._last_s = now_s
        return self._last

    def settle(self, now_s: float) -> None:
        """Update the estimate of the board's clock from the newest state; call it once per read, after its states."""
        if not self._first:
            self._arrived(self._last, now_s)

    def _feed_slowly(self, state: State, now_s: float) -> list[Sample | Jump]:
        # Later, one sequence number may belong to two runs of the counter. A new handshake costs some states, a wrong
        # guess would shift all.
        if now_s - max(self._last_s, self._witnessed_s) >= self._sure_s:
            self.give_up()
            self.unplaced += 1
            return [Jump(board_reset=False)]
        if not self._first and state.sequence == self._last & 0xFFFF:
            self.duplicates += 1
            return []
        tick = self._candidate(state.sequence)
        if tick > self._latest(now_s):
            return self._too_early(state, now_s)
        if self._unexpected is not None:
            self._count_noise(self._unexpected[0])
            self._unexpected = None
        return self._in_time(tick, state, now_s)

    def _in_time(self, tick: int, state: State, now_s: float) -> list[Sample | Jump]:
        gap, self._gap = self._gap, None
        if not self._first and tick - self._last == (self.divider or self._smallest_step):
            if gap is not None:
                self._count_noise(gap.state)
            return [self._accept(tick, state, now_s)]
        if gap is not None and tick > gap.tick and not self._fits_claim(state, now_s):
            return [self._accept(gap.tick, gap.state, gap.arrived_s), self._accept(tick, state, now_s)]
        if gap is not None and tick == gap.tick:
            self.duplicates += 1
        elif gap is not None and tick < gap.tick:
            self._count_noise(gap.state)
        elif gap is not None:
            self.unplaced += 1
        # Held, not published: noise with a right CRC would look like a loss, and move the count.
        self._gap = Sample(tick, self.session, 0, state, now_s)
        self._quick = False  # the next state decides about this one, also if it follows the old count
        return []

    def _too_early(self, state: State, now_s: float) -> list[Sample | Jump]:
        unexpected, self._unexpected = self._unexpected, (state, now_s)
        self._quick = False
        # One frame that is too early may be noise. The next one decides.
        if unexpected is None:
            return []
        if not 0 < (state.sequence - unexpected[0].sequence) & 0xFFFF <= max(self.divider or 1, _EARLY_TICKS):
            self._count_noise(unexpected[0])
            return []
        return self._jump(unexpected, (state, now_s))

    def _jump(self, first: tuple[State, float], second: tuple[State, float]) -> list[Sample | Jump]:
        gap = self._gap
        ahead = (first[0].sequence - self._last) & 0xFFFF
        if ahead < _OVERTAKEN_TICKS and (gap is None or gap.tick < self._last + ahead):
            # Two frames agree on a step forward that is too early by our clock: the board runs faster than it says
            # (an emulator at --speed 20).  The losses are real, the continuity too.
            self._unexpected = self._gap = None
            tick = self._last + ahead
            self._arrived(tick, first[1])
            placed = [] if gap is None else [self._accept(gap.tick, gap.state, gap.arrived_s)]
            return [*placed, self._accept(tick, *first), *self.feed(*second)]
        # A board that restarted since the last state cannot be further than the time since then.
        board_reset = first[0].sequence <= (first[1] - self._last_s) * self._rate + _EARLY_TICKS
        self.give_up()
        self.unplaced += 1  # the first of the two
        return [Jump(board_reset)]

    def _candidate(self, sequence: int) -> int:
        """Return the first tick with this sequence number after the last placed tick or the newest full tick."""
        start = max(self._last, self._witnessed - _OVERTAKEN_TICKS)
        tick = start + 1 + ((sequence - start - 1) & 0xFFFF)
        return tick if tick >= 0 else tick + WRAP

    def _accept(self, tick: int, state: State, arrived_s: float) -> Sample:
        lost = 0
        if not self._first:
            step = tick - self._last
            self._smallest_step = min(step, self._smallest_step)
            # By the divider, not by single ticks: ticks that the board skips on purpose are not losses.
            lost = (step - 1) // (self.divider or self._smallest_step)
            self.lost += lost
        self._last, self._last_s, self._first, self._quick = tick, arrived_s, False, True
        return Sample(tick, self.session, lost, state, arrived_s)

    def _count_noise(self, state: State) -> None:
        behind = (self._last - state.sequence) & 0xFFFF
        if behind < _OVERTAKEN_TICKS:
            self.duplicates += 1
        else:
            self.implausible += 1

    def _fits_claim(self, state: State, now_s: float) -> bool:
        """Return whether the state fits the full tick that contradicts the count as well as the count."""
        if self._claim is None:
            return False
        tick, claimed_s = self._claim
        if now_s - claimed_s > _CLAIM_S:
            self._claim = None
            return False
        since = (state.sequence - tick + _OVERTAKEN_TICKS) & 0xFFFF
        return since <= 2 * _OVERTAKEN_TICKS + (now_s - claimed_s) * self._rate

    def _latest(self, now_s: float) -> float:
        """Return the latest tick that is possible by the host's clock."""
        return now_s * self._rate + self._lead + _EARLY_TICKS

    def _agreed(self, tick: int, now_s: float) -> None:
        self._arrived(tick, now_s)
        self._witnessed_s = now_s
        self._witnessed = max(self._witnessed, tick)

    def _arrived(self, tick: int, now_s: float) -> None:
        lead = tick - now_s * self._rate
        # The best arrival of the last two windows, not of all time: the drift of the two clocks would add up.
        if now_s > self._window_end_s:
            self._lead, self._next_lead = self._next_lead, lead
            self._window_end_s = now_s + _LEAD_WINDOW_S
        if lead > self._next_lead:
            self._next_lead = lead
        if lead > self._lead:
            self._lead = lead


def _signed(ticks: int) -> int:
    """Return the difference of smallest magnitude that equals `ticks` modulo 2^32."""
    half = 1 << _TICK_BITS - 1
    return (ticks + half) % (1 << _TICK_BITS) - half
