"""The pace of the emulated board: real time, faster, and as fast as its host reads."""

from __future__ import annotations

import json
import signal
import threading
import time
from functools import partial
from itertools import combinations
from pathlib import Path

import pytest

import board51
from gateway.emulator.ports import TcpPort
from gateway.emulator.serve import Emulator, Server, build_lines
from protocol.wire.decoder import State
from tests.harness.gateway.raw_wire import Wire, is_state, until
from tests.patience import HANG_S


def test_real_time_is_kept() -> None:
    with Emulator() as emulator, Wire(emulator.urls[0]) as wire:
        wire.until(is_state)
        before_s = time.monotonic()
        first_s = emulator.counts().time_s
        start_s = time.monotonic()

        def ran_s() -> float:
            return emulator.counts().time_s - first_s

        until(lambda: time.monotonic() - start_s > 1.5)
        # Read in this order, whatever comes between two readings, only a board that is fast looks fast.
        emulated_s, wall_s = ran_s(), time.monotonic() - before_s
        # Deadlines are absolute: what a busy machine held up is caught up.
        until(lambda: time.monotonic() - start_s - ran_s() < 0.1)

    assert emulated_s < wall_s + 0.01


def test_what_a_busy_machine_held_up_is_not_caught_up_at_once() -> None:
    """All at once, a board would see no frame of its host for the whole time, and call it lost."""
    server = Server(build_lines([TcpPort("127.0.0.1", 0)]))
    thread = threading.Thread(target=server.run)
    thread.start()
    held_up, readings = threading.Event(), list[tuple[float, float, float]]()

    def board_s() -> float:
        return server.lines[0].counts.time_s

    def hold_up() -> None:
        time.sleep(1.0)
        held_up.set()

    def caught_up() -> bool:
        readings.append((time.monotonic(), board_s(), time.monotonic()))
        return board_s() > 3.0

    try:
        until(lambda: board_s() > 0.1)
        server.call(hold_up)
        until(held_up.is_set)
        until(caught_up)
    finally:
        server.stop()
        thread.join()

    for (begin_s, first_s, _), (_, last_s, end_s) in combinations(readings[::50], 2):
        assert last_s - first_s <= 2.0 * (end_s - begin_s) + 0.11


@pytest.mark.skipif(not hasattr(signal, "pthread_kill"), reason="Windows sends no signal to a thread")
def test_signals_do_not_stop_the_boards() -> None:
    server = Server(build_lines([TcpPort("127.0.0.1", 0)]))
    thread = threading.Thread(target=server.run, daemon=True)
    before = signal.signal(signal.SIGUSR1, lambda *_: None)
    thread.start()

    def ticks_on(time_s: float) -> bool:
        signal.pthread_kill(thread.ident or 0, signal.SIGUSR1)
        return server.lines[0].counts.time_s > time_s

    try:
        for n in range(50):  # a rest that a signal prolonged for ever was seen within ten signals
            until(partial(ticks_on, 0.01 * n))
    finally:
        server.stop()
        thread.join(HANG_S)
        signal.signal(signal.SIGUSR1, before)


def test_speed_runs_the_board_faster() -> None:
    with Emulator(speed=20.0) as emulator:
        start, first = time.monotonic(), emulator.counts().time_s
        # 20 on an idle machine; on a busy one at times.
        until(lambda: emulator.counts().time_s - first > 5 * (time.monotonic() - start) + 2.0)


def test_as_fast_as_possible_waits_for_a_host_and_loses_nothing() -> None:
    with Emulator(speed=0.0) as emulator:
        time_before = emulator.counts().time_s
        with Wire(emulator.urls[0]) as wire:
            wire.until(lambda event: isinstance(event, State) and event.sequence >= 3000)
        sequences = [state.sequence for state in wire.states()]

    assert time_before == 0.0
    assert sequences == list(range(len(sequences)))


@pytest.mark.parametrize("words", [[], ["--pty", "PTY"]])
def test_as_fast_as_possible_a_duration_passes_without_a_host(
    words: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = [str(tmp_path / "board") if word == "PTY" else word for word in words]
    code = board51.main(["emulate", *words, "--speed", "0", "--duration", "0.2", "--json"])

    report = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert (code, report["counts"]["time_s"]) == (0, 0.2)
