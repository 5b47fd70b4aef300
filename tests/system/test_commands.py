"""The `board51` command as a user meets it: help, mistakes, and the line from an emulated board to a client."""

from __future__ import annotations

import io
import json
import os
import re
import signal
import subprocess
import sys
import time
import tomllib
from collections.abc import Iterator
from importlib import metadata
from pathlib import Path

import pytest

import board51
from gateway.commands import bench
from gateway.emulator.serve import Emulator
from tests.harness.gateway.gateway_peers import wait_for
from tests.harness.ports import free_endpoint
from tests.patience import HANG_S

ROOT = Path(__file__).parents[2]


def _start(*words: object, cwd: Path) -> subprocess.Popen[str]:
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "PYTHONUNBUFFERED": "1"}
    return subprocess.Popen(
        [sys.executable, "-m", "board51", *map(str, words)],
        cwd=cwd,
        env=environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def _call(*words: object, cwd: Path, limit_s: float = HANG_S) -> subprocess.CompletedProcess[str]:
    process = _start(*words, cwd=cwd)
    out, err = process.communicate(timeout=limit_s)
    return subprocess.CompletedProcess(process.args, process.returncode, out, err)


def _answer(words: list[str], capsys: pytest.CaptureFixture[str]) -> tuple[int, str, str]:
    """Exit code, stdout, stderr of a command in this process: starting Python for each takes a second."""
    try:
        code = board51.main(words)
    except SystemExit as end:  # argparse
        code = int(end.code or 0)
    return code, *capsys.readouterr()


@pytest.mark.parametrize("name", sorted(board51.COMMANDS))
def test_every_command_has_help_with_an_example(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    code, out, err = _answer([name, "--help"], capsys)

    assert code == 0, err
    assert re.search(rf"example.*board51 {name}", out, re.DOTALL)


def test_the_list_of_commands_answers_without_importing_them() -> None:
    code = "import sys, board51\ntry: board51.main(['--help'])\nexcept SystemExit: pass\nprint(sorted(sys.modules))"

    out = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True).stdout

    listing, modules = out.rsplit("\n[", 1)
    assert all(re.search(rf"^  {name} ", listing, re.MULTILINE) for name in board51.COMMANDS)
    assert sorted(" ".join(board51.PURPOSES.values()).split()) == sorted(board51.COMMANDS)
    assert not {"zenoh", "numpy", "numba", "matplotlib", "foxglove"} & set(re.findall(r"'([^']+)'", modules))


def test_the_page_of_all_commands_has_each_of_them() -> None:
    page = (ROOT / "docs" / "howto" / "commands.md").read_text(encoding="utf-8")

    assert {name for name in board51.COMMANDS if not re.search(rf"`board51 {name}\b", page)} == set()


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["fly"], "there is no command 'fly'"),
        (["send", "rig1", "reference", "nan"], "not a finite number"),
        (["send", "rig1", "excite", "step", "--amplitude", "1500", "--duration", "1"], "You may mean 1.5 (1500 mV)"),
        (["send", "rig1", "excite", "step", "--on-reference", "--amplitude", "2", "--duration", "1"], "0.002 (2 mm)"),
        (["send", "Rig 1", "stop"], "is not a name"),
        (["send", "rig1", "stop", "--connect", "7447"], "is not a zenoh endpoint"),
        (["send", "rig1", "plant", "absent.toml"], "absent.toml cannot be read"),
        (["gateway"], "board"),
        (["gateway", "--board", "rig1"], "NAME=PORT"),
        (["gateway", "--config", "absent.toml"], "absent.toml"),
        (["gateway", "--board", "rig1=/dev/null", "--plant", "absent.toml"], "absent.toml cannot be read"),
        (["gateway", "--board", "rig1=/dev/null", "--plant", "rig2=x.toml"], "rig2 is not the name of a board"),
        (["start", "--board", "/dev/null", "--rig", "x.toml"], "--rig describes the emulated plant"),
        (["emulate", "--rig", "absent.toml"], "absent.toml cannot be read"),
        (["emulate", "--rig", "absent.toml", "--chip", "avr"], "the image of a chip holds the numbers of its rig"),
        (["router", "--config", "absent.json5"], "absent.json5"),
        (["router", "--listen", "x"], "is not a zenoh endpoint"),
        (["info", "absent.mcap"], "absent.mcap"),
        (["twin", "--model", "absent.json"], "absent.json"),
        (["twin", "--hand-over", "absent.json"], "absent.json"),
        (["plot", "absent.mcap", "--out", "p.png", "--span", "5:2"], "is not FROM:TO"),
        (["demo", "--out", "/proc/no/folder"], "/proc/no/folder cannot be written"),
        (["plot", "absent.mcap", "--out", "p.png"], "absent.mcap"),
        (["bench", "nothing"], "nothing"),
        (["emulate", "--effect", "magic=1"], "magic"),
        (["import", "absent.csv", "-o", "x.mcap"], "absent.csv"),
        (["export", "absent.mcap", "--format", "csv", "-o", "x.csv"], "absent.mcap"),
        (["recover", "absent.mcap", "-o", "x.mcap"], "absent.mcap"),
        (["replay", "absent.mcap"], "absent.mcap"),
        (["record", "-o", "/proc/no/logs"], "/proc/no/logs cannot be written"),
        (["identify", "absent.toml"], "absent.toml"),
        (["validate", "absent.toml", "--model", "ce152", "--out", "v"], "absent.toml"),
        (["design", "absent.json"], "absent.json"),
        (["diagnose", "absent.toml"], "absent.toml"),
        (["diagnose"], "there is nothing to diagnose"),
        (["diagnose", "--live", "0", "--out", "d"], "outside 0.1 .. 60 minutes"),
        (["diagnose", "--live", "1"], "--out DIR"),
        (["diagnose", "absent.toml", "--live", "1", "--out", "d"], "exclude each other"),
        (["diagnose", "absent.toml", "--hand-over"], "--hand-over is for live data"),
        (["twin", "--diagnosis-after", "-1"], "--diagnosis-after -1 is outside"),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, list) else "",
)
def test_a_mistake_is_one_clear_line_and_exit_code_2(
    words: list[str],
    expected: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)

    code, _, err = _answer(words, capsys)

    assert code == 2, err
    assert expected in err
    assert "Traceback" not in err


@pytest.mark.parametrize(("words", "code"), [(["--help"], 0), (["fly"], 2), (["info", "absent.mcap"], 2)])
def test_a_shell_sees_the_exit_code(words: list[str], code: int, tmp_path: Path) -> None:
    process = _call(*words, cwd=tmp_path)

    assert process.returncode == code, process.stderr
    assert (process.stderr == "") == (code == 0)
    assert "Traceback" not in process.stderr


def test_board51_alone_prints_its_help(capsys: pytest.CaptureFixture[str]) -> None:
    assert _answer([], capsys) == _answer(["--help"], capsys)
    assert _answer([], capsys)[0] == 0


def test_the_version_is_that_of_the_installation_or_of_the_checkout(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    stated = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["version"]

    assert _answer(["--version"], capsys) == (0, f"board51 {metadata.version('board51')}\n", "")
    monkeypatch.setattr(sys, "path", [])  # where the metadata of all packages are
    checkout = _answer(["--version"], capsys)

    assert checkout == (0, f"board51 {stated} (a checkout, not installed)\n", "")


@pytest.mark.parametrize(
    ("command", "terminal", "speaks"), [("plot", True, True), ("plot", False, False), ("identify", True, False)]
)
def test_a_silent_command_gives_signs_of_life_on_a_terminal(
    command: str, terminal: bool, speaks: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    stream = io.StringIO()
    monkeypatch.setattr(stream, "isatty", lambda: terminal)
    monkeypatch.setattr(sys, "stderr", stream)
    monkeypatch.setattr(board51, "FIRST_SIGN_S", 0.0)

    with board51._signs_of_life(command):
        if speaks:
            wait_for(stream.getvalue, "a sign of life")

    assert (f"board51 {command} is working" in stream.getvalue()) == speaks


@pytest.mark.parametrize("name", bench.names())
def test_every_benchmark_can_be_started(name: str) -> None:
    assert callable(bench.load(name))


@pytest.mark.slow
def test_without_a_gateway_a_command_says_where_it_looked(tmp_path: Path) -> None:
    endpoint = free_endpoint()

    process = _call("send", "rig1", "ping", "--connect", endpoint, cwd=tmp_path)

    assert process.returncode == 1
    assert f"No router answers at {endpoint}" in process.stderr


@pytest.fixture
def line(tmp_path: Path) -> Iterator[str]:
    """Router, gateway (its client) and an emulated board; the router's endpoint."""
    endpoint = free_endpoint()
    with Emulator(boards=1, tcp=True) as emulator:
        gateway = _start(
            "gateway", "--board", f"rig1={emulator.urls[0]}", "--connect", endpoint, "--log-dir", "logs", cwd=tmp_path
        )
        router = _start("router", "--listen", endpoint, cwd=tmp_path)
        assert router.stdout is not None
        assert "listens on" in router.stdout.readline()
        try:
            yield endpoint
        finally:
            errors = []
            for process in (gateway, router):
                process.send_signal(signal.SIGTERM)
                errors.append(process.communicate(timeout=HANG_S)[1])
    assert (gateway.returncode, router.returncode) == (0, 0), errors


@pytest.mark.slow  # of six programs; test_start.py guards that they find each other
def test_send_and_watch_through_a_standalone_router(line: str, tmp_path: Path) -> None:
    bus = ("--connect", line)
    deadline = time.monotonic() + HANG_S
    while _call("watch", *bus, "--topic", "state", "--count", 1, "--timeout", 2, cwd=tmp_path).returncode:
        assert time.monotonic() < deadline, "no samples"

    recorded = _call("record", "-o", "new/folder", "--seconds", 5, *bus, cwd=tmp_path)
    accepted = _call("send", "rig1", "mode", "closed-loop", "--json", "--who", "me", *bus, cwd=tmp_path)
    refused = _call("send", "rig1", "reference", "0.1", *bus, cwd=tmp_path)
    nobody = _call("send", "rig2", "ping", *bus, "--timeout", 1, cwd=tmp_path)
    states = _call("watch", *bus, "--topic", "state", "--json", "--count", 50, "--timeout", 20, cwd=tmp_path)

    assert recorded.returncode == 0, recorded.stderr
    assert len(list((tmp_path / "new" / "folder").glob("*.mcap"))) == 1
    assert accepted.returncode == 0
    assert json.loads(accepted.stdout)["accepted"] is True
    assert refused.returncode == 1
    assert "refused by gateway: out-of-range" in refused.stdout
    assert nobody.returncode == 1
    assert "not-delivered" in nobody.stdout
    rows = [json.loads(row) for row in states.stdout.splitlines()]
    assert len(rows) == 50
    assert rows[-1]["mode"] == "MODE_CLOSED_LOOP"
    ticks = [int(row["tick"]) for row in rows]
    assert ticks == list(range(ticks[0], ticks[0] + 50))


@pytest.mark.slow
def test_the_demo_names_the_cause_flies_on_all_models_and_leaves_everything(tmp_path: Path) -> None:
    process = _call("demo", "--out", "out", cwd=tmp_path, limit_s=380.0)

    assert process.returncode == 0, process.stderr
    assert len(re.findall(r"reference 4\.50 mm: ball at 4\.(?:4[5-9]|5[0-5]) mm", process.stdout)) == 3
    text = " ".join(process.stdout.split())
    steps = re.findall(r"the (identified|extended) model cuts it from (\d+) to (\d+) mA rms", text)
    assert [name for name, _, _ in steps] == ["identified", "extended"]
    # Each rest is a mean over REST_SAMPLES of a coloured error of 25 mA rms: a few mA are noise.
    assert float(steps[-1][2]) < 10.0
    # The emulated rig's coil plane is 2.438 mm above the stop, where the nominal model has it.
    assert re.search(r"Cause: air-gap-offset \(the coil sits 2\.4\d* mm higher", text)
    assert "the extended twin raises no alarm" in text
    (log,) = (tmp_path / "out").glob("*.mcap")
    assert (tmp_path / "out" / "measured-vs-twin.png").read_bytes().startswith(b"\x89PNG")
    for report in ("report", "diagnosis"):
        assert "<html" in (tmp_path / "out" / report / "report.html").read_text()
    info = _call("info", "--json", log, cwd=tmp_path)
    assert info.returncode == 0
    board = json.loads(info.stdout)["boards"]["board51/demo"]
    assert [model["who"] for model in board["twin_models"]] == ["", "demo", "demo"]
    assert board["gaps"]["samples_missing"] == 0
    assert _processes_in(tmp_path) == []


@pytest.mark.slow
def test_an_interrupted_demo_parks_the_ball_and_stops_everything(tmp_path: Path) -> None:
    demo = _start("demo", "--out", "out", cwd=tmp_path)
    assert demo.stdout is not None

    has_begun = any("[1/" in line for line in demo.stdout)  # in the middle of the campaign
    demo.send_signal(signal.SIGINT)
    _, errors = demo.communicate(timeout=HANG_S)

    assert has_begun
    assert demo.returncode == 130
    assert "everything stopped" in errors
    assert "Traceback" not in errors
    assert "ball parked, coil off" in (tmp_path / "out" / "campaign.log").read_text()
    assert _processes_in(tmp_path) == []


def _processes_in(folder: Path) -> list[str]:
    """Command lines of the processes that work in `folder`: the demo's all do."""
    commands = []
    for process in Path("/proc").glob("[0-9]*"):
        try:
            if (process / "cwd").resolve() == folder.resolve():
                commands.append((process / "cmdline").read_text().replace("\0", " "))
        except OSError:  # ended meanwhile, or not ours
            continue
    return commands


def test_a_fault_of_ours_is_one_line_with_a_code_of_its_own_and_a_traceback_on_demand(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def broken(_: object) -> int:
        raise ZeroDivisionError("float division\nby zero")

    monkeypatch.setattr(bench, "run", broken)

    assert board51.main(["bench", "log"]) == board51.OUR_FAULT
    err = capsys.readouterr().err
    assert err.count("\n") == 1
    assert "ZeroDivisionError: float division\\nby zero" in err
    assert board51.DEBUG in err
    monkeypatch.setenv(board51.DEBUG, "1")
    with pytest.raises(ZeroDivisionError):
        board51.main(["bench", "log"])
