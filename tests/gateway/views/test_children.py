"""Views as children: started, restarted, ended with the gateway however it ends."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from gateway.config import BoardConfig, GatewayConfig, HmiConfig, OpcuaConfig, SecurityConfig, ZenohConfig
from gateway.processes import supervisor
from gateway.processes.child import BEAT_VARIABLE, NICE_VARIABLE, NICER
from gateway.processes.supervisor import Service, running
from gateway.views.launch import views_for
from protocol.errors import ConfigError
from tests.harness.gateway.gateway_peers import wait_for
from tests.harness.ports import free_port

ROOT = Path(__file__).parents[3]
CONFIG = GatewayConfig(boards=(BoardConfig(name="rig", port="/dev/null"),))


def listening(port: int) -> Callable[[], bool]:
    def look() -> bool:
        with socket.socket() as probe:
            return probe.connect_ex(("127.0.0.1", port)) == 0

    return look


def router(port: int) -> Service:
    """A command that shows that it runs: its port is open."""
    return Service(name="router", arguments=("--listen", f"tcp/127.0.0.1:{port}"))


def children_of(pid: int) -> list[int]:
    listed = subprocess.run(["ps", "-o", "pid=", "--ppid", str(pid)], capture_output=True, text=True, check=False)
    return [int(word) for word in listed.stdout.split()]


def test_a_view_that_dies_is_started_again_and_ends_with_the_gateway(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(supervisor, "FIRST_WAIT_S", 0.1)
    port = free_port()

    with running([router(port)]):
        wait_for(listening(port), "view")
        first = view_at(port)
        os.kill(first, signal.SIGKILL)
        second = wait_for(lambda: (pid := view_at(port)) != first and pid, "another process")
        wait_for(listening(port), "view again")

    assert second != first
    assert not listening(port)()


@pytest.mark.slow
def test_a_view_that_hangs_is_killed_and_started_again(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(supervisor, "FIRST_WAIT_S", 0.1)
    monkeypatch.setattr(supervisor, "HUNG_S", 5.0)
    port = free_port()

    with running([router(port)]):
        wait_for(listening(port), "view")
        first = view_at(port)
        os.kill(first, signal.SIGSTOP)
        second = wait_for(lambda: (pid := view_at(port)) not in (0, first) and pid, "another process", 40.0)
        wait_for(listening(port), "view again")

    assert second != first
    assert not listening(port)()


@pytest.mark.parametrize(("stated", "nicer"), [("", NICER), ("2", 2)])
def test_a_view_of_a_gateway_in_real_time_runs_as_any_process_and_gives_way(
    stated: str, nicer: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(NICE_VARIABLE, stated)
    port = free_port()
    words = ["-m", "gateway.processes.child", "router", "--listen", f"tcp/127.0.0.1:{port}"]
    before = "import os, sys; os.sched_setscheduler(0, os.SCHED_RR, os.sched_param(1))\n"
    before += "os.execv(sys.executable, [sys.executable, *sys.argv[1:]])"
    view = subprocess.Popen(
        [sys.executable, "-c", before, *words], stdin=subprocess.PIPE, stderr=subprocess.PIPE, cwd=ROOT
    )
    try:
        if not wait_for(lambda: listening(port)() or (view.poll() is not None and -1), "view") > 0:
            assert view.stderr is not None
            assert b"PermissionError" in view.stderr.read()
            pytest.skip("this user may not run anything in real time")
        threads = [int(task.name) for task in Path(f"/proc/{view.pid}/task").iterdir()]
        policies = {os.sched_getscheduler(thread) for thread in threads}
        nice = os.getpriority(os.PRIO_PROCESS, view.pid)
    finally:
        view.kill()
        view.communicate()

    assert policies == {os.SCHED_OTHER}
    assert nice == os.getpriority(os.PRIO_PROCESS, 0) + nicer


@pytest.mark.parametrize("stated", ["low", "-5", "20"])
def test_a_priority_that_cannot_be_is_named_and_the_usual_one_taken(
    stated: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(NICE_VARIABLE, stated)
    port = free_port()
    words = [sys.executable, "-m", "gateway.processes.child", "router", "--listen", f"tcp/127.0.0.1:{port}"]
    with subprocess.Popen(words, stdin=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=ROOT) as view:
        wait_for(listening(port), "view")
        nice = os.getpriority(os.PRIO_PROCESS, view.pid)
        view.kill()
        error_output = view.communicate()[1]

    assert f"BOARD51_CHILD_NICE: '{stated}' is not a whole number from 0 to 19; 5 is used" in error_output
    assert nice == min(os.getpriority(os.PRIO_PROCESS, 0) + NICER, 19)


def view_at(port: int) -> int:
    """The pid of our child with this port in its command line; 0 for none."""
    for pid in children_of(os.getpid()):
        try:
            words = Path(f"/proc/{pid}/cmdline").read_bytes()
        except OSError:
            continue
        if str(port).encode() in words and b"gateway.processes.child" in words:
            return pid
    return 0


def test_a_view_with_a_wrong_option_is_not_started_again(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(supervisor, "FIRST_WAIT_S", 0.05)

    with running([Service(name="foxglove", arguments=("--listen", "nowhere"))]):
        wait_for(lambda: "not started again" in caplog.text, "verdict")

    errors = [line for line in capfd.readouterr().err.splitlines() if line]
    assert errors == ["board51 foxglove: --listen 'nowhere' is not an address. Write HOST:PORT, e.g. 127.0.0.1:4840."]


def test_a_child_that_takes_long_to_end_keeps_its_exit_code() -> None:
    """A beat that comes while Python ends finds no handler any more."""
    code = (
        "import sys, time\nfrom gateway.processes import child\n"
        "class Slow:\n    def __del__(self, sleep=time.sleep): sleep(20 * 0.01)\n"
        "slow = Slow()\nchild.BEAT_S = 0.01\n"
        "sys.argv[1:] = ['foxglove', '--listen', 'nowhere']\nsys.exit(child.main())"
    )
    beats, beat = os.pipe()
    with subprocess.Popen(
        [sys.executable, "-c", code], cwd=ROOT, stdin=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        pass_fds=(beat,), env={**os.environ, BEAT_VARIABLE: str(beat)},
    ) as child:  # fmt: skip
        assert child.stderr is not None
        errors = child.stderr.read()
    os.close(beats)
    os.close(beat)

    assert (child.returncode, "is not an address" in errors) == (2, True), errors


def test_no_view_outlives_a_gateway_that_is_killed() -> None:
    port = free_port()
    code = (
        "from gateway.processes.supervisor import Service, running\nimport time\n"
        f"with running([Service(name='router', arguments=('--listen', 'tcp/127.0.0.1:{port}'))]): time.sleep(60)"
    )
    gateway = subprocess.Popen([sys.executable, "-c", code], cwd=ROOT, stderr=subprocess.DEVNULL)
    wait_for(listening(port), "view")

    gateway.kill()
    gateway.wait()

    wait_for(lambda: not listening(port)(), "end of the view")


def test_a_view_joins_the_bus_of_its_gateway() -> None:
    config = replace(
        CONFIG,
        site="lab",
        zenoh=ZenohConfig(listen=("tcp/0.0.0.0:7447",)),
        opcua=OpcuaConfig(listen="127.0.0.1:4840", rate_hz=50.0, history_s=60.0),
        hmi=HmiConfig(listen="[::1]:8051"),
    )

    opcua, hmi = views_for(config)

    assert opcua == Service(
        name="opcua",
        arguments=(
            "--listen", "127.0.0.1:4840", "--connect", "tcp/127.0.0.1:7447", "--site", "lab",
            "--rate", "50", "--history", "60",
        ),
    )  # fmt: skip
    assert hmi.arguments[:2] == ("--listen", "[::1]:8051")
    assert "logs" in hmi.arguments


def test_a_guarded_gateway_hands_its_keys_on(tmp_path: Path) -> None:
    config = replace(CONFIG, security=SecurityConfig(directory=str(tmp_path)), hmi=HmiConfig(listen="0.0.0.0:8051"))

    (hmi,) = views_for(config)

    assert hmi.arguments[hmi.arguments.index("--security") + 1] == str(tmp_path)
    assert str(tmp_path / "identities" / "views") in hmi.arguments


@pytest.mark.parametrize("name", ["opcua", "hmi", "foxglove"])
def test_no_view_is_opened_to_the_network_unguarded(name: str) -> None:
    config = replace(CONFIG, **{name: replace(getattr(CONFIG, name), listen="0.0.0.0:4000")})
    with pytest.raises(ConfigError, match="without protection"):
        views_for(config)

    insecure = replace(config, security=SecurityConfig(insecure=True))
    assert views_for(insecure)[0].arguments[-1] == "--insecure"
