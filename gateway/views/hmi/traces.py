"""The last seconds of one board as rows for a plot: min / max bins of measured, twin and divergence.

Any number of readers follow with a cursor of their own: a slow one falls behind in this one ring, not in memory of its
own, and gets what it missed as long as the ring holds it.

A row is a list, so that 30 of them a second stay small:
    ["s", session, t_s, x low, x high, x_ref, i_c low, i_c high, u_c low, u_c high]     state; m, A, V
    ["t", session, t_s, x low, x high, i_c low, i_c high]                                twin
    ["d", session, t_s, x error low, x error high, NIS mean]                             divergence; errors in sigma
A value that does not exist is null.
"""

from __future__ import annotations

import math
from collections import deque

from gateway.views.bins import TopicBins
from gateway.views.decimate import Bin
from gateway.views.feed import BoardFeed
from protocol.bus import board51_pb2 as pb

SPAN_S = 20.0  # that a plot shows
BIN_S = 1.0 / 30.0  # a frame of a screen
MAX_ROWS = round(3 * SPAN_S / BIN_S)

Row = list[object]


class Traces:
    """Of one board.

    Args:
        board: as heard on the bus.
    """

    def __init__(self, board: BoardFeed) -> None:
        self._board = board
        self._rows: deque[Row] = deque(maxlen=MAX_ROWS)
        self._count = 0  # rows so far: the cursor of one who has read all
        self._taps: list[TopicBins] = []

    def pump(self) -> None:
        """Take in what came since the last call; call it about 30 times a second."""
        if not self._taps:
            if self._board.latest(pb.State) is None:
                return
            self._taps = [self._board.tap(kind, width_s=BIN_S) for kind in (pb.State, pb.TwinState, pb.Divergence)]
        states, twins, divergences = (tap.take() for tap in self._taps)
        for made, bins in ((_state, states), (_twin, twins), (_divergence, divergences)):
            for done in bins:
                self._rows.append(made(done))
                self._count += 1

    def since(self, cursor: int) -> tuple[list[Row], int]:
        """(rows that a reader at `cursor` has not seen, its next cursor)."""
        missing = min(self._count - cursor, len(self._rows))
        if missing <= 0:
            return [], self._count
        return list(self._rows)[-missing:], self._count


def number(value: float, digits: int = 6) -> float | None:
    """Round a number for JSON, which has no NaN, to the digits that a screen can show."""
    return float(f"{value:.{digits}g}") if math.isfinite(value) else None


def _state(b: Bin) -> Row:
    return ["s", b.session, number(b.t_s, 9), *_band(b, "x_m"), number(b.last["x_ref_m"]), *_band(b, "i_c_a"),
            *_band(b, "u_c_v")]  # fmt: skip


def _twin(b: Bin) -> Row:
    return ["t", b.session, number(b.t_s, 9), *_band(b, "x_m"), *_band(b, "i_c_a")]


def _divergence(b: Bin) -> Row:
    return ["d", b.session, number(b.t_s, 9), *_band(b, "x_m.normalised"), number(b.high["nis_mean"])]


def _band(b: Bin, name: str) -> tuple[float | None, float | None]:
    return number(b.low[name]), number(b.high[name])
