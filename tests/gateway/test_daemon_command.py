"""`board51 gateway` as a user starts it: wrong options, the ways in which it ends."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from contextlib import ExitStack
from pathlib import Path

import pytest

import board51
from gateway.emulator.serve import Emulator
from protocol.bus import board51_pb2 as pb
from protocol.log.scan import Scan
from tests.harness.gateway.gateway_peers import (
    Bus,
    ScriptedBoard,
    client,
    closed_loop,
    gateway_and_client,
    gateway_config,
    logged_messages,
    running,
    wait_for,
)
from tests.harness.ports import free_port
from tests.patience import HANG_S


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        ([], "--board NAME=PORT"),
        (["--board", "rig1"], "NAME=PORT"),
        (["--board", "Rig 1=/dev/null"], "is not a name"),
        (["--board", "a=x", "--board", "a=y"], "twice"),
        (["--board", "a=nonsense://x"], "nonsense"),
        (["--board", "a=/dev/null", "--listen", "127.0.0.1:7447"], "is not a zenoh endpoint"),
        (["--board", "a=/dev/null", "--log-dir", "/proc/nowhere"], "/proc/nowhere: No such file or directory. Give"),
        (["--board", "a=/dev/null", "--log-dir", "/dev/null"], "/dev/null: not a directory. Give"),
        (["--board", "a=/dev/null", "--log-dir", "/proc/self"], "/proc/self: no such directory. Give"),
        (["--config", "absent.toml"], "cannot be read"),
    ],
)
def test_bad_usage_is_one_line_and_exit_code_2(
    arguments: list[str], says: str, capfd: pytest.CaptureFixture[str]
) -> None:
    listen = [] if "--listen" in arguments else ["--listen", f"tcp/127.0.0.1:{free_port()}"]

    code = board51.main(["gateway", *arguments, *listen])

    error_output = capfd.readouterr().err
    assert code == 2
    assert len(error_output.splitlines()) == 1
    assert says in error_output


def test_the_printed_configuration_is_one_that_passes_the_check(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    assert board51.main(["gateway", "--print-config"]) == 0
    (tmp_path / "gateway.toml").write_text(capfd.readouterr().out)

    assert board51.main(["gateway", "--config", str(tmp_path / "gateway.toml"), "--check"]) == 0

    captured = capfd.readouterr()
    assert captured.err == ""
    assert "rig1 at /dev/ttyUSB0" in captured.out


PANICS = """
import os, pathlib, sys, threading, time
import board51

def panic():  # what Rust writes, in the way it writes it: to the descriptor, past Python
    while not list(pathlib.Path(sys.argv[1]).glob("*.mcap")):
        time.sleep(0.01)
    os.write(2, b"\\nthread 'rx-0' (4711) panicked at zenoh/src/net/routing/dispatcher/resource.rs:823:44:\\n")

threading.Thread(target=panic, daemon=True).start()
sys.exit(board51.main(sys.argv[2:]))
"""


def test_a_panic_in_a_thread_of_zenoh_ends_it_in_good_order_to_be_started_again(tmp_path: Path) -> None:
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    with ScriptedBoard() as board:
        words = ["gateway", "--board", f"rig={board.url}", "--listen", endpoint, "--log-dir", str(tmp_path)]
        process = subprocess.run(
            [sys.executable, "-c", PANICS, str(tmp_path), *words],
            stderr=subprocess.PIPE,
            text=True,
            timeout=HANG_S,
            check=False,
        )
    (log,) = tmp_path.glob("*.mcap")

    assert process.returncode == 70
    assert "its process ends" in process.stderr
    assert "panicked at" not in process.stderr  # a gateway that reads this of a view does not end, too
    assert Scan(log).indexed


PANICS_AT_THE_END = """
import os, signal, sys, threading, time
import board51
from protocol.ending import end_is_ordered

def panic():
    while signal.getsignal(signal.SIGTERM) == signal.SIG_DFL:
        time.sleep(0.01)
    os.kill(os.getpid(), signal.SIGTERM)
    while not end_is_ordered():
        time.sleep(0.001)
    os.write(2, b"\\nthread 'net-0' (4711) panicked at zenoh/src/net/routing/dispatcher/resource.rs:491:27:\\n")

threading.Thread(target=panic, daemon=True).start()
sys.exit(board51.main(sys.argv[1:]))
"""


@pytest.mark.parametrize(
    "service", ["gateway", *(pytest.param(view, marks=pytest.mark.slow) for view in ("hmi", "opcua"))]
)
def test_a_panic_while_zenoh_closes_is_no_failure(service: str, tmp_path: Path) -> None:
    """zenoh panics in some of its ends; `systemctl stop` must not leave "failed" behind by luck."""
    with Emulator(tcp=False) as emulator, running(config := gateway_config(*emulator.urls)):
        endpoint = config.zenoh.listen[0]
        logs = ["--log-dir", str(tmp_path)]
        options = {
            "gateway": ["--board", "rig=/dev/null", "--listen", f"tcp/127.0.0.1:{free_port()}", *logs],
            "hmi": ["--connect", endpoint, "--listen", f"127.0.0.1:{free_port()}", "--data", str(tmp_path)],
            "opcua": ["--connect", endpoint, "--listen", f"127.0.0.1:{free_port()}"],
        }
        process = subprocess.run(
            [sys.executable, "-c", PANICS_AT_THE_END, service, *options[service]],
            stderr=subprocess.PIPE, text=True, timeout=HANG_S, check=False,
        )  # fmt: skip

    assert process.returncode == 0, process.stderr


def test_a_terminal_that_closes_ends_it_cleanly(tmp_path: Path) -> None:
    """As at the end of an ssh connection: the terminal is gone, whoever writes to it gets an error."""
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    master, slave = os.openpty()
    with ScriptedBoard() as board:
        words = ["--board", f"rig={board.url}", "--listen", endpoint, "--log-dir", str(tmp_path)]
        gateway = subprocess.Popen(
            ["setsid", "--ctty", sys.executable, "-m", "board51", "gateway", *words],
            stdin=slave, stdout=slave, stderr=slave,
        )  # fmt: skip
        try:
            os.close(slave)
            with client(endpoint) as bus:
                wait_for(bus.states, "first sample")
            os.close(master)
            code = gateway.wait(30.0)
        finally:
            gateway.kill()
            gateway.wait()
    (log,) = tmp_path.glob("*.mcap")

    assert code == 0
    assert Scan(log).indexed


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT, signal.SIGHUP])
def test_a_signal_ends_it_cleanly_and_moves_nothing(number: signal.Signals, tmp_path: Path) -> None:
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    with ExitStack() as stack:
        emulator = stack.enter_context(Emulator())
        # Not a second, as by default: the next gateway may take longer to come on a busy machine.
        board = f'[[board]]\nname = "rig"\nport = "{emulator.urls[0]}"\nhost_loss_timeout_s = 30.0\n'
        (tmp_path / "gateway.toml").write_text(board)
        arguments = ["--config", str(tmp_path / "gateway.toml"), "--listen", endpoint, "--log-dir", str(tmp_path)]
        gateway = subprocess.Popen(
            [sys.executable, "-m", "board51", "gateway", *arguments], stderr=subprocess.PIPE, text=True
        )
        stack.enter_context(gateway)
        stack.callback(gateway.kill)  # where the test fails before the signal
        with client(endpoint) as bus:
            closed_loop_when_up(bus)
            bus.await_states(100)
            gateway.send_signal(number)
            _, lines = gateway.communicate(timeout=HANG_S)
        second = gateway_config(*emulator.urls)
        with gateway_and_client(second) as bus:
            mode = bus.states()[0].mode

    assert gateway.returncode == 0
    assert Scan(next(tmp_path.glob("*.mcap"))).indexed
    assert "streaming" in lines
    assert "Traceback" not in lines
    assert mode == pb.MODE_CLOSED_LOOP
    commands = {r.command.WhichOneof("what") for r in logged_messages(next(tmp_path.glob("*.mcap")), "command/record")}
    assert commands == {"set_mode"}


def closed_loop_when_up(bus: Bus) -> None:
    wait_for(bus.states, "first sample")
    closed_loop(bus)
