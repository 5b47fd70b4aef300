"""`board51 emulate`: what it serves, prints and refuses."""

from __future__ import annotations

import contextlib
import json
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

import board51
from tests.harness.gateway.raw_wire import Wire, is_state
from tests.patience import HANG_S


@pytest.fixture
def _same_signals() -> Iterator[None]:
    """A command in this process leaves its handlers behind."""
    before = {number: signal.getsignal(number) for number in (signal.SIGTERM, signal.SIGINT)}
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


@pytest.mark.slow
def test_the_command_serves_until_a_signal_and_cleans_up(tmp_path: Path) -> None:
    call = [sys.executable, "-m", "board51", "emulate", "--pty", str(tmp_path / "rig"), "--boards", "2"]
    process = subprocess.Popen(call, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert process.stdout is not None
    lines = [process.stdout.readline() for _ in range(2)]
    with Wire(lines[1].split()[-1]) as wire:
        wire.until(is_state)

    process.send_signal(signal.SIGINT)  # SIGTERM takes the same way: protocol/ending.py
    _, errors = process.communicate(timeout=HANG_S)

    assert [line.split() for line in lines] == [
        ["board", "1:", f"{tmp_path}/rig-1"],
        ["board", "2:", f"{tmp_path}/rig-2"],
    ]
    assert process.returncode == 0, errors
    assert "Traceback" not in errors
    assert list(tmp_path.iterdir()) == []


def test_the_command_serves_although_nobody_can_take_its_output(tmp_path: Path) -> None:
    words = ["emulate", "--pty", str(tmp_path / "rig"), "--duration", "0.1"]
    with open("/dev/full", "w") as full:  # as a file on a disk that has no room
        process = subprocess.run(
            [sys.executable, "-m", "board51", *words], stdout=full, stderr=subprocess.PIPE, text=True, check=False
        )

    assert process.returncode == 0, process.stderr


@pytest.mark.usefixtures("_same_signals")
def test_the_command_seals_its_secret_and_prints_json(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    secret = ["--secret", "7", "--sealed", str(tmp_path / "sealed.json")]
    assert board51.main(["emulate", "--tcp", "127.0.0.1:0", "--json", "--duration", "0.1", *secret]) == 0

    reports = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert reports[0]["board_id"] == 1
    assert reports[0]["url"].startswith("socket://127.0.0.1:")
    assert (tmp_path / "sealed.json").exists()
    assert reports[1]["commitment"]
    assert reports[2]["counts"]["time_s"] == pytest.approx(0.1)


@pytest.mark.usefixtures("_same_signals")
@pytest.mark.parametrize(("host", "lines"), [("0.0.0.0", 1), ("127.0.0.1", 0), ("localhost", 0)])
def test_a_listener_beyond_this_machine_is_one_line_of_warning(
    host: str, lines: int, capsys: pytest.CaptureFixture[str]
) -> None:
    assert board51.main(["emulate", "--tcp", f"{host}:0", "--duration", "0.02"]) == 0

    warnings = [line for line in capsys.readouterr().err.splitlines() if "open to the network" in line]
    assert len(warnings) == lines
    assert all(f"--tcp {host}:0" in line and "may command" in line for line in warnings)


@pytest.mark.parametrize(
    "arguments",
    [
        ["--fault", "flood=1"],
        ["--effect", "magic=1"],
        ["--effect", "quadratic-drag"],
        ["--boards", "0"],
        ["--baud", "1"],
        ["--speed", "nan"],
        ["--latency-timer", "-1"],
        ["--tcp", "nonsense"],
        ["--tcp", "127.0.0.1:65535", "--boards", "2"],
        ["--pty", "/nowhere/at/all"],
        ["--secret", "1"],
        ["--secret", "1", "--sealed", "f", "--effect", "quadratic-drag=1"],
    ],
)
def test_bad_usage_is_one_line_and_exit_code_2(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    code = board51.main(["emulate", *arguments])

    errors = capsys.readouterr().err
    assert code == 2
    assert errors.count("\n") == 1
    assert errors.startswith("board51 emulate: ")


def test_the_help_lists_effects_and_faults(capsys: pytest.CaptureFixture[str]) -> None:
    with contextlib.suppress(SystemExit):
        board51.main(["emulate", "--help"])

    text = capsys.readouterr().out
    assert "quadratic-drag" in text
    assert "disconnect=S" in text
    assert "examples:" in text
