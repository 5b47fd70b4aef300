"""The serial thread's rounds: several boards are read together, a board alone as soon as its bytes arrive."""

from __future__ import annotations

import threading
import time
from contextlib import ExitStack
from pathlib import Path

import pytest

from gateway.config import BoardConfig
from gateway.link.clock import HostClock
from gateway.link.driver import BoardDriver
from gateway.link.io_thread import LinkThread
from tests.harness.gateway.gateway_peers import Collector, ScriptedBoard, wait_for


def test_the_thread_sleeps_until_something_is_due(tmp_path: Path) -> None:
    config = BoardConfig(name="rig", port=str(tmp_path / "absent"), reconnect_s=0.2)
    driver, rounds, attempts = BoardDriver(config, Collector(), HostClock()), list[float](), list[str]()
    driver.port_absent = lambda kind, text: attempts.append(kind)  # type: ignore[method-assign]
    link = LinkThread([driver], lambda: rounds.append(time.monotonic()))
    link.start()
    try:
        wait_for(lambda: len(attempts) > 5, "attempts")
    finally:
        link.stop()

    assert len(rounds) <= 3 * len(attempts) + 2  # it is due, the port is opened or not


@pytest.mark.parametrize("count", [1, 2])
def test_only_several_boards_make_a_round_rest(count: int, monkeypatch: pytest.MonkeyPatch) -> None:
    resting, rest = set[str](), time.sleep

    def noted(duration_s: float) -> None:
        resting.add(threading.current_thread().name)
        rest(duration_s)

    monkeypatch.setattr(time, "sleep", noted)
    collectors = [Collector() for _ in range(count)]
    with ExitStack() as stack:
        boards = [stack.enter_context(ScriptedBoard()) for _ in range(count)]
        link = LinkThread(
            [
                BoardDriver(BoardConfig(name=f"rig{n}", port=board.url), collector, HostClock())
                for n, (board, collector) in enumerate(zip(boards, collectors, strict=True))
            ]
        )
        link.start()
        stack.callback(link.stop)
        wait_for(lambda: all(len(collector.samples) > 20 for collector in collectors), "samples")

    assert ("link" in resting) == (count > 1)
