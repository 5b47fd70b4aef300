"""The last seconds of one board as rows for a plot: min / max bins of measured, twin and divergence.

Any number of readers follow with a cursor of their own.  A slow one falls behind in this one ring, not in memory of its
own.  It gets the rows that it missed as long as the ring holds them.

A row is a list, so that 30 of them a second stay small.

    ["s", session, t_s, x low, x high, x_ref, i_c low, i_c high, u_c low, u_c high]     state; m, A, V
    ["t", session, t_s, x low, x high, i_c low, i_c high]                                twin
    ["d", session, t_s, x error low, x error high, NIS mean]                             divergence; errors in sigma

A value that does not exist is null.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable

from google.protobuf.message import Message

from gateway.views.board_feed import BoardFeed
from gateway.views.decimate import Bin, TopicBins
from protocol.bus import board51_pb2 as pb

SPAN_S = 20.0  # that a plot shows
BIN_S = 1.0 / 30.0  # a frame of a screen
MAX_ROWS = round(3 * SPAN_S / BIN_S)
SPARK_S, SPARK_STEP_S = 30.0, 0.2  # of the overview, whose frames come as often
COARSE_S, LONGEST_S = 2.0, 600.0  # of older rows; static/history.js thins its own rows in the same way

Row = list[object]

# Channels of a row.  The last seconds are always kept, even for nobody, so there are no other channels.
_CHANNELS: dict[type[Message], tuple[str, ...]] = {
    pb.State: ("x_m", "x_ref_m", "i_c_a", "u_c_v"),
    pb.TwinState: ("x_m", "i_c_a"),
    pb.Divergence: ("x_m.normalised", "nis_mean"),
}


class Traces:
    """The traces of one board."""

    def __init__(self, board: BoardFeed) -> None:
        self.board = board
        self._rows: deque[Row] = deque(maxlen=MAX_ROWS)
        self._count = 0  # rows so far: the cursor of one who has read all
        self._taps: list[TopicBins] = []
        self._coarse: deque[Row] = deque(maxlen=round(3 * LONGEST_S / COARSE_S))

    def pump(self) -> None:
        """Take in what came since the last call, up to MAX_BINS; a reader calls it before each frame."""
        if not self._taps:
            if self.board.latest(pb.State) is None:
                return
            self._taps = [
                self.board.tap(kind, width_s=BIN_S, channels=channels) for kind, channels in _CHANNELS.items()
            ]
        states, twins, divergences = (tap.take() for tap in self._taps)
        for made, bins in ((_state, states), (_twin, twins), (_divergence, divergences)):
            for closed in bins:
                if len(self._rows) == MAX_ROWS:
                    self._fold(self._rows[0])
                self._rows.append(made(closed))
                self._count += 1

    def since(self, cursor: int) -> tuple[list[Row], int]:
        """Return (rows that a reader at `cursor` has not received, its next cursor)."""
        missing = min(self._count - cursor, len(self._rows))
        if missing <= 0:
            return [], self._count
        return list(self._rows)[-missing:], self._count

    def past(self) -> list[Row]:
        """Return the rows older than those of `since(0)`, in bins of COARSE_S, up to LONGEST_S."""
        return list(self._coarse)

    def spark(self) -> list[Row]:
        """Return (t_s, x in m) of the newest session, at most one in SPARK_STEP_S of the last SPARK_S."""
        points: list[Row] = []
        for row in reversed([*self._coarse, *self._rows]):
            if row[0] != "s":
                continue
            if not points:
                newest = row
            t_s = float(str(row[2]))
            if row[1] != newest[1] or t_s < float(str(newest[2])) - SPARK_S:
                break
            if not points or float(str(points[-1][0])) - t_s >= SPARK_STEP_S:
                points.append([t_s, row[4]])
        return points[::-1]

    def _fold(self, row: Row) -> None:
        """Put a row that leaves the ring into the coarse bin of its kind, session and time."""
        for index in range(len(self._coarse) - 1, max(len(self._coarse) - 4, -1), -1):
            bin_ = self._coarse[index]
            if bin_[:2] == row[:2] and _slot(bin_) == _slot(row):
                self._coarse[index] = _widened(bin_, row)
                return
        self._coarse.append(row)


_LOWS, _LARGEST = {"s": (3, 6, 8), "t": (3, 5), "d": (3,)}, {"d": (5,)}


def _slot(row: Row) -> int:
    return int(float(str(row[2])) // COARSE_S)


def _widened(bin_: Row, row: Row) -> Row:
    """Return `row` with the lowest and highest values of both rows.

    Of a value without a band the newest counts, or the largest.
    """
    wide = list(row)
    for low in _LOWS[str(row[0])]:
        wide[low], wide[low + 1] = _of(min, bin_[low], row[low]), _of(max, bin_[low + 1], row[low + 1])
    for index in _LARGEST.get(str(row[0]), ()):
        wide[index] = _of(max, bin_[index], row[index])
    return wide


def _of(choose: Callable[[float, float], float], a: object, b: object) -> object:
    if not isinstance(a, float | int) or not isinstance(b, float | int):
        return b if a is None else a
    return choose(a, b)


def number(value: float, digits: int = 6) -> float | None:
    """Round a number for JSON, which has no NaN, to the digits that a screen can show."""
    return float(f"{value:.{digits}g}") if math.isfinite(value) else None


def _state(b: Bin) -> Row:
    return ["s", *_moment(b), *_band(b, "x_m"), number(b.last["x_ref_m"]), *_band(b, "i_c_a"), *_band(b, "u_c_v")]


def _twin(b: Bin) -> Row:
    return ["t", *_moment(b), *_band(b, "x_m"), *_band(b, "i_c_a")]


def _divergence(b: Bin) -> Row:
    return ["d", *_moment(b), *_band(b, "x_m.normalised"), number(b.high["nis_mean"])]


def _moment(b: Bin) -> tuple[int, float | None]:
    return b.message.session, number(b.message.t_s, 9)


def _band(b: Bin, name: str) -> tuple[float | None, float | None]:
    return number(b.low[name]), number(b.high[name])
