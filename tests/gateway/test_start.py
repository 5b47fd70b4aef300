"""`board51 start`: gateway, twin and control room at once, and nothing left behind."""

from __future__ import annotations

import os
import re
import signal
import socket
import subprocess
import sys
from pathlib import Path

import pytest

import board51
from gateway.commands import start
from gateway.processes.command import listens
from protocol.arguments import Parser
from tests.harness.gateway.gateway_peers import client, wait_for
from tests.harness.gateway.heavy_rig import HEAVY_RIG
from tests.harness.ports import free_port
from tests.patience import HANG_S

START = [sys.executable, "-m", "board51", "start"]


def test_one_command_flies_shows_and_ends_everything(tmp_path: Path) -> None:
    page, bus = free_port(), free_port()
    words = ["--emulated", "--page", f"127.0.0.1:{page}", "--listen", f"tcp/127.0.0.1:{bus}", "--no-browser", "--lean"]
    process = subprocess.Popen(
        [*START, *words, "--log-dir", str(tmp_path / "logs")],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=os.environ | {"TMPDIR": str(tmp_path)},
    )  # fmt: skip
    try:
        with client(f"tcp/127.0.0.1:{bus}") as receiver:
            wait_for(lambda: len(receiver.messages["rig1/twin/state"]) > 10, "the twin beside the board")
        assert process.stdout is not None
        assert process.stdout.readline() == f"control room  http://127.0.0.1:{page}\n"
        children = children_of(process.pid)
        process.send_signal(signal.SIGINT)
        _, error_output = process.communicate(timeout=HANG_S)
    finally:
        process.kill()

    assert process.returncode == 0
    assert error_output.endswith("everything stopped\n")
    assert len(children) == 3
    assert [pid for pid in children if Path(f"/proc/{pid}").exists()] == []
    assert list(tmp_path.glob("board51-*")) == []  # the pty's folder
    assert [listens(port) for port in (page, bus)] == [False, False]
    assert list((tmp_path / "logs").glob("*.mcap"))


@pytest.mark.slow
def test_another_emulated_rig_has_its_plant_card_and_its_limits(tmp_path: Path) -> None:
    page, bus = free_port(), free_port()
    (tmp_path / "rig.toml").write_text(HEAVY_RIG)
    words = ["--emulated", "--rig", str(tmp_path / "rig.toml"), "--page", f"127.0.0.1:{page}", "--no-browser"]
    process = subprocess.Popen(
        [*START, *words, "--listen", f"tcp/127.0.0.1:{bus}", "--log-dir", str(tmp_path / "logs")],
        env=os.environ | {"TMPDIR": str(tmp_path)},
    )
    try:
        with client(f"tcp/127.0.0.1:{bus}") as receiver:
            card = wait_for(lambda: [c for c in receiver.messages["rig1/plant"] if c.board], "card with its board")[-1]
            board = wait_for(lambda: receiver.messages["rig1/parameters"], "parameters")[-1]
    finally:
        process.send_signal(signal.SIGINT)
        process.communicate(timeout=HANG_S)

    assert (card.plant.mass_kg, card.plant.x_max_m, card.board) == (20e-3, 16e-3, "1 emul-own")
    assert card.who
    assert board.gateway_x_ref_max_m == pytest.approx(5.2e-3 * 12 / 5.7, rel=1e-3)
    assert board.x_ref_max_m == pytest.approx(board.gateway_x_ref_max_m, rel=1e-3)


@pytest.mark.slow
def test_a_start_that_is_killed_leaves_nothing_in_the_temporary_folder(tmp_path: Path) -> None:
    words = ["--emulated", "--page", f"127.0.0.1:{free_port()}", "--listen", f"tcp/127.0.0.1:{free_port()}"]
    process = subprocess.Popen(
        [*START, *words, "--no-browser", "--log-dir", str(tmp_path / "logs")],
        stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, env=os.environ | {"TMPDIR": str(tmp_path)},
    )  # fmt: skip
    try:
        assert process.stdout is not None
        assert process.stdout.readline().startswith(b"control room")
        assert list(tmp_path.glob("board51-*")), "it says so when the emulated board is there, too"
        children = children_of(process.pid)
    finally:
        process.kill()
        process.communicate()

    wait_for(lambda: not any(Path(f"/proc/{pid}").exists() for pid in children), "the end of its processes")
    assert list(tmp_path.glob("board51-*")) == []


def children_of(pid: int) -> list[int]:
    threads = Path(f"/proc/{pid}/task").glob("*/children")
    return [int(child) for thread in threads for child in thread.read_text().split()]


@pytest.mark.parametrize(
    ("words", "problem"),
    [
        ([], "one of the arguments --emulated --board is required"),
        (["--board", "/dev/ttyUSB0", "--effect", "coulomb-friction=1e-3"], "Give it with --emulated"),
        (["--emulated", "--page", "here"], "--page"),
        (["--emulated", "--page", "0.0.0.0:0"], "open to the network"),
        (["--emulated", "--listen", "tcp/0.0.0.0:7447"], "board51 gateway --security DIR"),
        (["--emulated", "--keep-days", "-3"], "--keep-days = -3.0 is not in 0 .. 100000"),
        (["--emulated", "--log-dir", "/dev/null/logs"], "/dev/null/logs cannot be written: Not a directory"),
    ],
)
def test_what_cannot_be_is_said_at_once(words: list[str], problem: str, capsys: pytest.CaptureFixture[str]) -> None:
    try:
        code = board51.main(["start", *words])
    except SystemExit as ended:  # argparse
        code = int(ended.code or 0)

    assert code == 2
    assert problem in capsys.readouterr().err


def test_a_port_that_is_absent_or_closed_is_said_in_the_terminal(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "tty0").touch()
    monkeypatch.setattr(os, "access", lambda path, mode: False)

    start._warn_of_ports([f"{tmp_path}/absent", f"cart={tmp_path}/tty*", "socket://127.0.0.1:1"])

    lines = capsys.readouterr().err.splitlines()
    assert [line.partition(":")[0] for line in lines] == ["rig1", "cart"]
    assert f"There is no {tmp_path}/absent: is the adapter plugged in?" in lines[0]
    assert f"No permission to open {tmp_path}/tty*: add the user to its group" in lines[1]


@pytest.mark.parametrize(
    ("words", "pattern"),
    [
        (["--board", "a", "--board", "b"], r"about 22 MB a minute: [\d.e+]+ h in \S+ GB, then the disk is full"),
        (
            ["--emulated", "--lean", "--keep-gb", "0.06"],
            r"about 10 MB a minute: 0\.1 h in 0\.06 GB, then the oldest logs are deleted",
        ),
    ],
)
def test_it_says_how_much_is_logged_and_for_how_long(words: list[str], pattern: str, tmp_path: Path) -> None:
    parser = Parser()
    start.configure(parser)

    assert re.fullmatch(pattern, start._log_size(parser.parse_args([*words, "--log-dir", str(tmp_path)])))


def test_a_port_that_is_taken_is_named_before_anything_starts(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with socket.create_server(("127.0.0.1", 0)) as listener:
        port = listener.getsockname()[1]
        code = board51.main(["start", "--emulated", "--page", f"127.0.0.1:{port}", "--log-dir", str(tmp_path / "logs")])

    error_output = capsys.readouterr().err
    assert code == 2
    assert re.search(rf"Cannot listen on 127\.0\.0\.1:{port} .*give --page HOST:PORT", error_output)
    assert error_output.count("\n") == 1
    assert not (tmp_path / "logs").exists()
