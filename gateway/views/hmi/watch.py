"""The spectra of a board's last seconds for one reader, from every tick since the reader began to look.

Rule 1: readings are collected only while a reader looks.
Rule 2: a column that cannot be shown is null, and a sentence says why.
"""

from __future__ import annotations

import math
import threading
from array import array
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from gateway.views.board_feed import BoardFeed
from gateway.views.hmi.spectrum import MISSING, FloatArray, amplitudes, even, in_bands, missing
from gateway.views.hmi.texts import text_of, texts_of
from gateway.views.hmi.traces import number
from protocol.bus import board51_pb2 as pb

SPAN_S = 10.0
MIN_SPAN_S = 2.0  # of samples needed for a first spectrum
_MAX_READINGS = 10_000  # of a topic: SPAN_S at 1 kHz; twice as many are kept before the older half goes
_HIGHEST = {"x": "spectrum.highest_x", "e": "spectrum.highest_e", "i": "spectrum.highest_i"}
_TWIN_LAG_S = 0.25  # by which the twin may be behind


class Readings:
    """The newest readings of one topic: session, t_s, values.

    Args:
        values: of a message.
    """

    def __init__(self, values: Callable[[Any], tuple[float, ...]]) -> None:
        self._values = values
        self._numbers = array("d")  # row after row
        self._newest: tuple[float, ...] = (math.nan, math.nan)
        self._width = 0
        self._lock = threading.Lock()

    def push(self, message: Any) -> None:
        """Take in a message; called by the feed."""
        row = (message.session, message.t_s, *self._values(message))
        with self._lock:
            if row[0] != self._newest[0] or row[1] <= self._newest[1]:  # another time base
                del self._numbers[:]
            elif len(self._numbers) >= 2 * _MAX_READINGS * len(row):
                del self._numbers[: _MAX_READINGS * len(row)]
            self._newest, self._width = row, len(row)
            self._numbers.extend(row)

    def table(self) -> FloatArray:
        """Return the readings of the newest session, shape (n, 2 + values)."""
        with self._lock:
            return np.array(self._numbers, np.float64).reshape(-1, self._width) if self._width else np.empty((0, 2))


class Watch:
    """The spectra of a board, while one reader looks at them."""

    def __init__(self, board: BoardFeed) -> None:
        self.board = board
        self._states, self._errors = Readings(_measured), Readings(_residual)
        board.attach(pb.State, self._states)
        board.attach(pb.Divergence, self._errors)

    def close(self) -> None:
        """Stop collecting."""
        self.board.detach(pb.State, self._states)
        self.board.detach(pb.Divergence, self._errors)

    def spectra(self) -> dict[str, Any]:
        """Return frequencies (Hz) and amplitudes of x, the residual (um) and i_c (mA), and sentences."""
        states, link = self._states.table(), self.board.link()
        if not link.live:
            return _words(text_of("spectrum.silent"))
        span_s = float(states[-1, 1] - states[0, 1]) if len(states) > 1 else 0.0
        if span_s < MIN_SPAN_S:
            return _words(text_of("spectrum.collecting", seconds=f"{span_s:.1f}", least=f"{MIN_SPAN_S:g}"))
        columns, step_s = _columns(states, self._errors.table())
        answer: dict[str, Any] = {"span_s": round(len(columns["x"]) * step_s, 1)}
        words, highest = [], []
        for name, values in columns.items():
            answer[name], word = None, _word(name, missing(values))
            if word:
                words.append(word)
            if missing(values) <= MISSING:
                frequency_hz, amplitude = amplitudes(values, step_s)
                at = int(np.argmax(amplitude))
                highest.append(text_of(_HIGHEST[name], amplitude=f"{amplitude[at]:.3g}", hz=f"{frequency_hz[at]:.3g}"))
                middle_hz, largest = in_bands(frequency_hz, amplitude)
                if "f_hz" not in answer:
                    answer["f_hz"] = [number(f, 5) for f in middle_hz.tolist()]
                answer[name] = [number(a, 3) for a in largest.tolist()]
        if highest:
            answer["highest"] = text_of("spectrum.highest", lines=" \u00b7 ".join(highest))
        return answer | _words(*words)


def _words(*sentences: str) -> dict[str, Any]:
    return {"said": " ".join(sentences)}


def _word(name: str, share: float) -> str:
    """Return the sentence about the missing share of a channel's samples; "" if none is missing."""
    if share == 0.0:
        return ""
    if share == 1.0 and name == "e":
        return text_of("spectrum.no_twin")
    channel, percent = texts_of("spectrum_of")[name], f"{100.0 * share:.2g}"
    if share > MISSING:
        return text_of("spectrum.lost", channel=channel, percent=percent)
    return text_of("spectrum.filled", channel=channel, percent=percent)


def _columns(states: FloatArray, errors: FloatArray) -> tuple[dict[str, FloatArray], float]:
    """Return (x in um, i_c in mA, residual in um at the same even times, their interval in s)."""
    t_s, lost = states[:, 1], states[:, 2]
    step_s, end_s = float(np.min(np.diff(t_s) / (1.0 + lost[1:]))), float(t_s[-1])
    same = len(errors) > 0 and errors[-1, 0] == states[-1, 0]
    if same and end_s - _TWIN_LAG_S < errors[-1, 1] < end_s:  # the newest of the twin is still on its way
        end_s = float(errors[-1, 1])
    count = 1 + round(min(SPAN_S - step_s, end_s - float(t_s[0])) / step_s)
    grid = partial(even, end_s=end_s, step_s=step_s, count=count)
    return {
        "x": 1e6 * grid(t_s, states[:, 3]),
        "e": 1e6 * grid(errors[:, 1], errors[:, 2]) if same else np.full(count, np.nan),
        "i": 1e3 * grid(t_s, states[:, 4]),
    }, step_s


def _measured(state: pb.State) -> tuple[float, ...]:
    return (
        state.lost_before,
        state.x_m if state.HasField("x_m") else math.nan,
        state.i_c_a if state.HasField("i_c_a") else math.nan,
    )


def _residual(divergence: pb.Divergence) -> tuple[float, ...]:
    return (divergence.x_m.error if divergence.HasField("x_m") else math.nan,)
