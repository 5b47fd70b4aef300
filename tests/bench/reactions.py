"""The reaction times of the control room: STOP (also under a flood), a lost board, frames beside browsers that
never read.

Each is what a person waits for, so it is wall time, and each has a limit that is promised on two cores that do little
else (`note`).  The baseline is the same without a page: a client of the bus that says STOP, the feed that the page
is served from, a reader alone.  On a busy machine value and baseline grow together.
"""

from __future__ import annotations

import itertools
import signal
import statistics
import tempfile
import threading
import time
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from protocol.bus import board51_pb2 as pb
from tests.gateway.views.test_hmi_slow_reader import never_reading
from tests.harness.gateway.access_peers import fresh, guarded_rig, made_folder
from tests.harness.gateway.bus_peers import played_gateway, ticking
from tests.harness.gateway.chromium import ABSENT, CHROMIUM, chromium
from tests.harness.gateway.gateway_peers import Bus, client, wait_for
from tests.harness.gateway.hmi_peers import Page, Process, frame, hmi
from tests.harness.ports import free_port

Row = dict[str, Any]
ROUNDS = 5
FRAMES = 90
NOTE = """() => {
    window.lostAt = 0;
    window.addEventListener('keydown', () => { window.pressedAt = Date.now(); }, { capture: true });
    const look = () => { if (document.body.dataset.live === 'no' && !window.lostAt) window.lostAt = Date.now(); };
    new MutationObserver(look).observe(document.body, { attributes: true });
}"""


def run() -> list[Row]:
    """Rows for `board51 bench`."""
    with tempfile.TemporaryDirectory(prefix="reactions-") as scratch:
        return [*_on_a_rig(Path(scratch)), _under_a_flood(Path(scratch)), _with_non_readers(Path(scratch))]


def _row(name: str, value: float, unit: str, baseline: float, note: str) -> Row:
    return {"name": name, "value": value, "unit": unit, "baseline": baseline, "ratio": baseline / value, "note": note}


def _on_a_rig(folder: Path) -> list[Row]:
    if CHROMIUM is None:
        return [{"name": "reactions of the page", "value": None, "unit": "", "note": f"NOT MEASURED: {ABSENT}"}]
    with ExitStack() as stack:
        endpoint = f"tcp/127.0.0.1:{free_port()}"
        emulator = stack.enter_context(Process(folder, "emulate", "--pty", str(folder / "tty")))
        emulator.wait_for_words("tty")
        words = ("--board", f"rig={folder / 'tty'}", "--listen", endpoint, "--log-dir", str(folder / "logs"))
        stack.enter_context(Process(folder, "gateway", *words)).wait_for_words("streaming")
        port, _ = stack.enter_context(hmi(folder, endpoint))
        bus = stack.enter_context(client(endpoint))
        tab = stack.enter_context(chromium()).new_page()
        tab.goto(f"http://127.0.0.1:{port}/rig/rig")
        tab.wait_for_selector("body[data-live=yes]")
        tab.evaluate(NOTE)

        def key() -> int:
            tab.keyboard.press("Escape")
            return int(tab.evaluate("window.pressedAt")) * 1_000_000

        def call() -> int:
            now_ns = time.time_ns()
            bus.command(f"stop-{now_ns}", stop=pb.Stop())
            return now_ns

        key_s, bus_s = ([_stopped_s(bus, press) for _ in range(ROUNDS)] for press in (key, call))
        lost_s = []
        for _ in range(ROUNDS):
            tab.wait_for_selector("body[data-live=yes]")
            tab.evaluate("window.lostAt = 0")
            emulator.signal(signal.SIGSTOP)
            wait_for(lambda: tab.evaluate("window.lostAt > 0"), "the loss on the page")
            lost_s.append(tab.evaluate("window.lostAt") / 1e3 - bus.states()[-1].host_time_ns / 1e9)
            emulator.signal(signal.SIGCONT)
    each = f"worst of {ROUNDS}"
    return [
        _row("STOP by key on the page, to the coil off", max(key_s), "s", max(bus_s), f"{each}; promised 0.2 s"),
        _row("a lost board, shown on the page", max(lost_s), "s", 1.0, f"{each}; baseline: the promise"),
    ]


def _stopped_s(bus: Bus, press: Any) -> float:
    """Return the time from the press to the first sample with the coil off."""
    bus.command(f"open-{time.time_ns()}", set_mode=pb.SetMode(mode=pb.MODE_OPEN_LOOP))
    wait_for(lambda: bus.states()[-1].mode == pb.MODE_OPEN_LOOP, "open loop")
    pressed_ns = press()
    wait_for(lambda: bus.states()[-1].mode == pb.MODE_IDLE, "idle")
    first = next(s for s in bus.states() if s.host_time_ns > pressed_ns and s.mode == pb.MODE_IDLE)
    return float((first.host_time_ns - pressed_ns) / 1e9)


def _under_a_flood(folder: Path) -> Row:
    keys, stop = made_folder(folder / "keys"), threading.Event()
    with guarded_rig(keys, folder / "guarded") as rig, rig.join("ana") as ana, rig.join("ben") as ben:

        def flood() -> None:
            while not stop.is_set():
                payload = fresh(ping=pb.Ping()).SerializeToString()
                for replies in [ben.session.get(ben.command_key, payload=payload, timeout=3.0) for _ in range(200)]:
                    list(replies)

        def stopped_s() -> float:
            began_s = time.monotonic()
            assert ana.command(stop=pb.Stop())
            return time.monotonic() - began_s

        quiet_s = max(stopped_s() for _ in range(ROUNDS))
        thread = threading.Thread(target=flood)
        thread.start()
        wait_for(lambda: any(event.name == "command-flood" for event in ana.events), "the flood")
        flooded_s = max(stopped_s() for _ in range(ROUNDS))
        stop.set()
        thread.join()
    note = f"worst of {ROUNDS}; promised 1 s; baseline: without the flood"
    return _row("STOP of one sender under the flood of another", flooded_s, "s", quiet_s, note)


def _with_non_readers(folder: Path) -> Row:
    with ExitStack() as stack:
        gateway = stack.enter_context(played_gateway())
        port, _ = stack.enter_context(hmi(folder, gateway.endpoint))
        stack.enter_context(ticking(gateway, period_s=0.002))
        page = Page(port)
        page.open()
        with page.live("/live/rig") as reader:
            wait_for(lambda: "now" in frame(reader), "the board")

            def interval_s() -> float:
                arrived = []
                for _ in range(FRAMES):
                    frame(reader)
                    arrived.append(time.monotonic())
                return statistics.mean(b - a for a, b in itertools.pairwise(arrived))

            quiet_s = interval_s()
            for _ in range(4):
                stack.enter_context(never_reading(page))
            loaded_s = interval_s()
    return _row("frames of a page beside four that never read", 1.0 / loaded_s, "1/s", 1.0 / quiet_s, "baseline: alone")


if __name__ == "__main__":
    for row in run():
        print(row)
