"""The demo's processes end with it, however it ends."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

from gateway.processes.command import listens, running
from tests.harness.gateway.gateway_peers import wait_for
from tests.harness.ports import free_port

ROOT = Path(__file__).parents[3]


def test_no_process_outlives_a_demo_that_is_killed(tmp_path: Path) -> None:
    port = free_port()
    code = (
        "from gateway.processes.command import running\nfrom pathlib import Path\nimport time\n"
        f"with running(Path({str(tmp_path)!r}), 'router', '--listen', 'tcp/127.0.0.1:{port}'): time.sleep(600)"
    )
    demo = subprocess.Popen([sys.executable, "-c", code], cwd=ROOT)
    wait_for(lambda: listens(port), "the router")

    demo.kill()
    demo.wait()

    wait_for(lambda: not listens(port), "end of the router")


def test_a_process_of_the_demo_runs_at_its_priority_and_ends_with_the_block(tmp_path: Path) -> None:
    port = free_port()

    with running(tmp_path, "router", "--listen", f"tcp/127.0.0.1:{port}") as process:
        wait_for(lambda: listens(port), "the router")
        nice = os.getpriority(os.PRIO_PROCESS, process.pid)

    assert nice == os.getpriority(os.PRIO_PROCESS, 0)
    assert process.returncode == 0
    assert not listens(port)
