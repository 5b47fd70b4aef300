"""Lab, site and plant on hosts of their own, 50 ms and 1 % loss between them; the lab is cut off.

BOARD51_SITES_CUT_S=600 pytest -n0 -s tests/gateway/sites/test_namespaces.py      # ten minutes, by hand
"""

from __future__ import annotations

import os
import sys
import threading
import time
from contextlib import ExitStack
from pathlib import Path

import pytest

from gateway.record.merge import merge
from tests.harness.gateway.gateway_peers import ScriptedBoard, wait_for
from tests.harness.sites.logs import account, held, missing
from tests.harness.sites.namespaces import Line, host, why_not
from tests.harness.soak.processes import Service, looked_at
from tests.patience import HANG_S

CUT_S = float(os.environ.get("BOARD51_SITES_CUT_S", "8"))
DELAY_S, LOSS, LOOK_S = 0.05, 0.01, 5.0
LOCAL = "tcp/127.0.0.1:7447"


def states_of(folder: Path, board: str) -> int:
    return sum(key.endswith(f"/{board}/state") for key, _ in held(folder)) if folder.exists() else 0


@pytest.mark.slow
def test_a_lab_that_is_cut_off_has_no_gap_at_the_plant(tmp_path: Path) -> None:
    if reason := why_not():
        pytest.skip(reason)
    recorded, names = tmp_path / "recorded", ("lab", "site", "plant")
    with ExitStack() as stack:
        hosts = {name: stack.enter_context(host(name)) for name in names}
        lower = Line((hosts["lab"], hosts["site"]), "10.51.1", delay_s=DELAY_S, loss=LOSS, seed=1)
        stack.callback(lower.close)
        upper = Line((hosts["site"], hosts["plant"]), "10.51.2", delay_s=DELAY_S, loss=LOSS, seed=2)
        stack.callback(upper.close)
        listen = {"site": "tcp/10.51.1.2:7447", "plant": "tcp/10.51.2.2:7447"}
        connect = {"lab": listen["site"], "site": listen["plant"]}

        def service(site: str, name: str, *words: str, ready: str = "") -> Service:
            command = [*hosts[site], sys.executable, "-m", "board51", *words]
            run = "import os, sys; os.execvp(sys.argv[1], sys.argv[1:])"
            made = Service(f"{name}-{site}", tmp_path, "-c", run, *command, ready=ready)
            services.append(made)
            made.start()
            return made

        services: list[Service] = []
        boards: list[ScriptedBoard] = []
        stack.enter_context(looked_at(services))
        for number, site in enumerate(reversed(names)):
            boards.append(board := stack.enter_context(ScriptedBoard()))
            ends = [f"--listen={end}" for end in (LOCAL, listen.get(site)) if end]
            ends += [f"--connect={connect[site]}"] if site in connect else []
            words = (f"--board=rig{number}={board.url}", f"--log-dir={tmp_path / site}", "--insecure", *ends)
            service(site, "gateway", "gateway", *words, ready="serving 1 boards")
            service(site, "server", "serve-log", str(tmp_path / site), "--connect", LOCAL, ready="serving")
        recorder = service("plant", "recorder", "record", "-o", str(recorded), "--connect", LOCAL, ready="recording")
        wait_for(lambda: all(states_of(recorded, f"rig{n}") > 200 for n in range(3)), "samples of each rig")
        for board in boards[:-1]:
            board.streaming = False  # the lab's samples are those that are missed; the others cost a core
        lower.is_cut = True
        filling = service("plant", "fill", "fill", str(recorded), "--connect", LOCAL, "--every", "5", "--settle", "10")
        threading.Event().wait(CUT_S)  # the fault lasts
        lower.is_cut, mended_s, at_cut = False, time.monotonic(), states_of(recorded, "rig2")
        wait_for(lambda: states_of(recorded, "rig2") > at_cut + 200, "samples of the lab again")
        back_s = time.monotonic() - mended_s
        mended_ns = time.time_ns()
        lacked = missing(tmp_path / "lab", recorded, before_ns=mended_ns)
        while missing(tmp_path / "lab", recorded, before_ns=mended_ns):
            assert time.monotonic() < mended_s + CUT_S + HANG_S, "the rest does not come"
            time.sleep(LOOK_S)  # a look reads the whole log
        filled_s = time.monotonic() - mended_s
        until_ns = [mended_ns + 10 * 10**9, time.time_ns() - 5 * 10**9]
        live = [missing(tmp_path / "lab", recorded, before_ns=t, parts="bus-*.mcap") for t in until_ns]
        other_gaps = [missing(tmp_path / site, recorded, before_ns=mended_ns) for site in ("site", "plant")]
        for service_ in services:
            service_.look()
        held_mb = {s.name: round(max(h.resident_mb for life in s.held for h in life)) for s in services}
        begin_mb = {s.name: round(s.held[0][0].resident_mb) for s in services if s.held[0]}
        recorder.end()
        filling.end()
        print(f"cut for {CUT_S:g} s, samples again after {back_s:.1f} s; {lacked} records filled in {filled_s:.0f} s")
        print(f"lost live after it: {live[1] - live[0]}; lost on the lines: {lower.lost}, {upper.lost} packets")
        print(f"MB at first, at most: {begin_mb} {held_mb}", filling.output, sep="\n")
    merged = merge(recorded, tmp_path / "whole.mcap")

    assert lacked > 100 * CUT_S
    assert other_gaps == [0, 0]
    assert account(recorded, recorded) == (0, 0)
    assert merged.twice == 0
