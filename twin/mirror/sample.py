"""A State as the mirror takes it: NaN for what it lacks or what is not finite, each counted by name."""

from __future__ import annotations

import math
from collections import Counter
from typing import NamedTuple

from protocol.bus import board51_pb2 as pb
from protocol.wire.messages import Flag

CLIPPED = int(Flag.POSITION_RANGE | Flag.CURRENT_RANGE)


class Sample(NamedTuple):
    """A tick of a board; i, x, u, x_ref in A, m, V, m."""

    sequence: int
    tick: int
    session: int
    t_s: float
    closed_loop: bool
    mode: int
    i: float
    x: float
    u: float
    x_ref: float
    usable: bool  # by the observer: i, x, u are there and the sensors within their ranges

    @property
    def drive(self) -> float:
        """The input of the free-running twin: x_ref in closed loop, otherwise u."""
        return self.x_ref if self.closed_loop else self.u


def read(state: pb.State, counters: Counter[str]) -> Sample:
    """The sample of a message; what is missing is counted in `counters`."""
    i, x, u, x_ref, mode = state.i_c_a, state.x_m, state.u_c_v, state.x_ref_m, state.mode
    whole = math.isfinite(i + x + u + x_ref)
    # Presence is asked only where a 0 leaves it open: four questions take twice as long as reading the four numbers.
    if not whole or i == 0.0 or x == 0.0 or u == 0.0 or x_ref == 0.0:  # 0 is what an absent field reads as
        i = _finite("i_c", i if state.HasField("i_c_a") else math.nan, counters)
        x = _finite("x", x if state.HasField("x_m") else math.nan, counters)
        u = _finite("u_c", u if state.HasField("u_c_v") else math.nan, counters)
        x_ref = _finite("x_ref", x_ref if state.HasField("x_ref_m") else math.nan, counters)
        whole = math.isfinite(i + x + u)
        if mode == pb.MODE_IDLE and math.isnan(u):
            u = 0.0  # idle is: coil off
            whole = math.isfinite(i + x)
    return Sample(
        state.sequence,
        state.tick,
        state.session,
        state.t_s,
        mode == pb.MODE_CLOSED_LOOP,
        mode,
        i,
        x,
        u,
        x_ref,
        whole and not state.flags & CLIPPED,
    )


def interruption(now: Sample, last: Sample, bridge_ticks_max: int) -> str:
    """Return why a sample does not continue the flight of the last one; empty if it does."""
    if now.session != last.session:
        return "board-reset"
    missing = now.tick - last.tick - 1
    if missing < 0:
        return "time-backwards"
    held = now.drive == (last.x_ref if now.closed_loop else last.u)
    # Bridged only where both sides agree: what happened in between is known then.
    if missing > bridge_ticks_max or (missing > 0 and not (held and now.mode == last.mode)):
        return "lost-samples"
    if math.isnan(now.drive):
        return "missing-channel"
    return ""


def sample_time_between(last: Sample | None, now: Sample) -> float:
    """Return T_s by the clock of the board, s; NaN unless `now` is a later sample of the same session."""
    if last is None or last.session != now.session or now.tick <= last.tick:
        return math.nan
    # To 0.1 us: differences of a clock in s have rounding errors, and T_s must not change with each sample.
    return round((now.t_s - last.t_s) / (now.tick - last.tick), 7)


def _finite(name: str, value: float, counters: Counter[str]) -> float:
    if math.isfinite(value):
        return value
    counters[f"missing_{name}"] += 1
    return math.nan
