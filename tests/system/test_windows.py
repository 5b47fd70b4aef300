"""The whole line where pty, termios, fcntl, signals and pipes to wait for are absent, as on Windows.

Linux and macOS play it: tests/harness/windows/sitecustomize.py says what, and for whom.  On Windows all is real.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from gateway.processes.command import listens
from tests.harness.gateway.gateway_peers import client, wait_for
from tests.harness.ports import free_port
from tests.patience import HANG_S

ROOT = Path(__file__).parents[2]
WINDOWS = ROOT / "tests" / "harness" / "windows"
if sys.platform == "win32":
    ENVIRONMENT, CTRL_BREAK, GROUP = dict(os.environ), signal.CTRL_BREAK_EVENT, subprocess.CREATE_NEW_PROCESS_GROUP
else:
    ENVIRONMENT, CTRL_BREAK, GROUP = os.environ | {"PYTHONPATH": f"{WINDOWS}{os.pathsep}{ROOT}"}, signal.SIGUSR1, 0


def windows(*words: str) -> subprocess.CompletedProcess[str]:
    """Run Python there to its end."""
    return subprocess.run(
        [sys.executable, *words], cwd=ROOT, env=ENVIRONMENT, capture_output=True, text=True, timeout=HANG_S
    )


def board51(*words: str) -> subprocess.CompletedProcess[str]:
    return windows("-m", "board51", *words)


@pytest.mark.slow
def test_every_module_is_imported() -> None:
    process = windows(str(WINDOWS / "every_module.py"))

    assert process.returncode == 0, process.stderr
    assert list(json.loads(process.stdout)) == []


def test_a_pty_is_refused_in_words() -> None:
    process = board51("emulate", "--pty", "board")

    assert (process.returncode, process.stderr) == (
        2,
        "board51 emulate: A pty needs Linux or macOS. Give --tcp HOST:PORT instead.\n",
    )


@pytest.mark.slow  # test_start.py guards the same where all is real
def test_a_flight_from_start_to_its_log_until_ctrl_break(tmp_path: Path) -> None:
    page, bus = free_port(), f"tcp/127.0.0.1:{free_port()}"
    words = ["--emulated", "--no-browser", "--page", f"127.0.0.1:{page}", "--listen", bus]
    process = subprocess.Popen(
        [sys.executable, "-m", "board51", "start", *words, "--log-dir", str(tmp_path)],
        cwd=ROOT, env=ENVIRONMENT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        creationflags=GROUP,
    )  # fmt: skip
    try:
        with client(bus) as receiver:
            wait_for(lambda: receiver.messages["rig1/twin/state"], "the twin beside the board")
            flown = board51("send", "rig1", "mode", "closed-loop", "--connect", bus)
            assert process.stdout is not None
            assert process.stdout.readline() == f"control room  http://127.0.0.1:{page}\n"
        process.send_signal(CTRL_BREAK)
        _, stderr = process.communicate(timeout=HANG_S)
    finally:
        process.kill()
    outputs = "".join(path.read_text() for path in tmp_path.glob("*.out"))
    log = board51("info", *map(str, tmp_path.glob("*.mcap")), "--json")

    assert flown.stdout.startswith("accepted"), flown.stderr
    assert (process.returncode, stderr) == (0, "everything stopped\n")
    assert not listens(page)
    assert "socket://127.0.0.1" in (tmp_path / "emulate.out").read_text()
    assert "Traceback" not in outputs
    assert "a fault of board51" not in outputs
    assert log.returncode == 0, log.stderr
    assert "parameters" in log.stdout
