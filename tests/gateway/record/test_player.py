"""A log that is played: pause, seek and speed, by a clock of the test's own."""

from __future__ import annotations

import threading
from typing import Any

import pytest

from gateway.record.player import GLANCE_S, Player
from protocol.log.reader import RawLogRecord

TICK_NS = 20_000_000
TICKS = 100  # 2 s


def record(tick: int) -> RawLogRecord:
    return RawLogRecord("s/b/state", "s", "b", "state", b"", tick * TICK_NS)


class Played:
    """A player in a clock that moves with each look, and what it sent."""

    def __init__(self, orders: dict[int, str] | None = None) -> None:
        self.sent: list[int] = []
        self.times_s: list[float] = []
        self.reports: list[dict[str, Any]] = []
        self.seeks = 0
        self._clock_s = 0.0
        self._pending: list[str] = []
        self._orders = dict(orders or {})
        self._stop = threading.Event()
        self.player = Player(
            lambda start_s: (record(k) for k in range(TICKS) if k * TICK_NS >= start_s * 1e9),
            self._send, next_order=self._next_order,
            sought=self._sought, report=self._report, stop=self._stop, now_s=self._now_s,
        )  # fmt: skip
        self.player.run(0.0, 1.0)

    def _now_s(self) -> float:
        return self._clock_s

    def _next_order(self, limit_s: float) -> str | None:
        if self._pending:
            return self._pending.pop(0)
        self._clock_s += limit_s
        return None

    def _send(self, sent: RawLogRecord) -> None:
        self.sent.append(sent.time_ns // TICK_NS)
        self.times_s.append(self._clock_s)
        line = self._orders.pop(self.sent[-1], None)
        self._pending += [] if line is None else line.split(";")

    def _sought(self) -> None:
        self.seeks += 1

    def _report(self, state: dict[str, Any]) -> None:
        self.reports.append(state)
        if state["state"] == "ended":
            self._stop.set()


def test_it_plays_to_the_end_and_says_so() -> None:
    played = Played()

    assert played.sent == list(range(TICKS))
    assert [report["state"] for report in played.reports] == ["playing", "ended"]


@pytest.mark.parametrize(("speed", "takes"), [("0.5", 2.0), ("2", 0.5), ("5", 0.2)])
def test_speed_counts_from_the_order_on(speed: str, takes: float) -> None:
    played = Played({49: f"speed {speed}"})

    assert played.sent == list(range(TICKS))
    assert played.times_s[-1] - played.times_s[50] == pytest.approx(0.98 * takes, abs=0.05)
    assert played.reports[-1] == {"state": "ended", "speed": float(speed)}


def test_a_seek_goes_on_there() -> None:
    played = Played({9: "seek 1.5", 80: "seek 0.2"})

    assert played.sent == [*range(10), *range(75, 81), *range(10, TICKS)]
    assert played.seeks == 2


def test_a_seek_while_it_pauses_shows_a_glance_and_goes_on_when_told() -> None:
    glance = round(GLANCE_S * 1e9 / TICK_NS)
    played = Played({9: "pause;seek 1", 50 + glance: "play"})

    assert played.sent == [*range(10), *range(50, TICKS)]
    assert [report["state"] for report in played.reports] == ["playing", "paused", "paused", "playing", "ended"]
    assert played.times_s[10 + glance] - played.times_s[10] < GLANCE_S / 2  # at once, not in its time


@pytest.mark.parametrize("line", ["", "seek", "seek x", "seek -1", "seek nan", "speed 0", "speed 1e9", "dance"])
def test_what_is_no_order_is_passed_over(line: str) -> None:
    played = Played({9: line})

    assert played.sent == list(range(TICKS))
    assert len(played.reports) == 2


@pytest.mark.parametrize("speed", [0.0, 1.0, 4.0])
def test_played_once_it_keeps_time_and_a_record_of_before_delays_nothing(speed: float) -> None:
    ticks, clock_s, sent = [0, 5, 2, 6], [0.0], list[tuple[int, float]]()

    def wait(limit_s: float) -> None:
        clock_s[0] += limit_s

    player = Player(
        lambda start_s: map(record, ticks), lambda played: sent.append((played.time_ns // TICK_NS, clock_s[0])),
        next_order=wait, sought=lambda: None, report=lambda state: None, stop=threading.Event(),
        now_s=lambda: clock_s[0],
    )  # fmt: skip

    assert player.play(0.0, speed) == pytest.approx(0.12)
    assert [tick for tick, _ in sent] == ticks  # in the order of the log
    due = [0.0, 0.1, 0.1, 0.12] if speed else [0.0] * 4
    assert [at_s for _, at_s in sent] == pytest.approx([at_s / (speed or 1.0) for at_s in due])
