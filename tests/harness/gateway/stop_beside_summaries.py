"""A command beside many summaries of a large log, given up and followed by a STOP: does it act later?

    python -m tests.harness.gateway.stop_beside_summaries --summaries 16

An emulated rig, its gateway and its page as processes.  Browsers ask for the summaries and wait.  Two seconds later an
operator closes the loop; the browser gives up after 10 s; then somebody stops the rig.  The rig is watched from then on
until no summary is read any more, for --watch seconds at least.  The exit code is 1 where it moved.
"""

from __future__ import annotations

import argparse
import contextlib
import sys
import tempfile
import threading
import time
from pathlib import Path

import httpx

from protocol.bus import board51_pb2 as pb
from tests.harness.gateway.gateway_peers import client, wait_for
from tests.harness.gateway.hmi_peers import Page
from tests.harness.gateway.rig_peers import emulated_rig
from tests.harness.gateway.summary_peers import Viewers, children, write_log

MESSAGES = 1_600_000  # 96 MB
BROWSER_S = 10.0
CLOSED = {"set_mode": {"mode": "MODE_CLOSED_LOOP"}}


def play(folder: Path, summaries: int, messages: int, watch_s: float) -> bool:
    """Play it once; returns whether the rig stayed idle."""
    (folder / "logs").mkdir()
    write_log(folder / "logs" / "big.mcap", messages)
    print(f"{summaries} summaries of {(folder / 'logs' / 'big.mcap').stat().st_size / 1e6:.0f} MB")
    with emulated_rig(folder) as rig, client(rig.endpoint) as bus:
        wait_for(bus.states, "a sample")
        page = Page(rig.port)
        page.open()
        wait_for(lambda: page.post("/api/rig/stop").status_code == 200, "the rig on the page")
        viewers, begin_s, peak = Viewers(page), time.monotonic(), 0

        def report(text: str) -> None:
            print(f"{time.monotonic() - begin_s:+6.1f} s  {text}", flush=True)

        viewers.request_summaries(summaries)
        threading.Event().wait(2.0)
        with contextlib.suppress(httpx.TimeoutException):
            page.http.timeout = httpx.Timeout(BROWSER_S)
            report(f"closed loop: {page.post('/api/rig/command', CLOSED).json()}")
        page.http.timeout = httpx.Timeout(60.0)
        report("STOP")
        stop = page.post("/api/rig/stop").json()
        report(f"STOP: {stop}")
        wait_for(lambda: bus.states()[-1].tick >= stop["tick"], "its sample")
        stopped_s, moved = time.monotonic(), False
        while children(rig.hmi.pid) or time.monotonic() - stopped_s < watch_s:
            peak = max(peak, len(children(rig.hmi.pid)))
            if bus.states()[-1].mode != pb.MODE_IDLE and not moved:
                moved = True
                report("THE RIG ACTS: mode " + pb.Mode.Name(bus.states()[-1].mode))
            time.sleep(0.05)
        report(f"no summary is read any more; {peak} at once at most; answers {sorted(viewers.statuses())}")
        viewers.leave()
        return not moved


def main() -> int:
    """Play it as the options say."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--summaries", type=int, default=16)
    parser.add_argument("--messages", type=int, default=MESSAGES, help="of the log")
    parser.add_argument("--watch", type=float, default=60.0, help="s after the STOP, at least")
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        idle = play(Path(folder), args.summaries, args.messages, args.watch)
    print("the rig stayed idle after the STOP" if idle else "THE RIG ACTED AFTER THE STOP")
    return 0 if idle else 1


if __name__ == "__main__":
    sys.exit(main())
