"""A lasting alarm leads to a quiet twin: request, diagnosis of the flight, hand-over; as a user types it."""

from __future__ import annotations

import os
import re
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path

import pytest
import zenoh

from gateway.processes.command import ADAPTER
from protocol.bus import board51_pb2 as pb
from protocol.bus.endpoint import zenoh_config
from tests.harness.ports import free_endpoint
from tests.patience import HANG_S, WORK_S

ROOT = Path(__file__).parents[2]


def start(words: list[object], cwd: Path) -> subprocess.Popen[str]:
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "PYTHONUNBUFFERED": "1"}
    with (cwd / f"{words[0]}.log").open("w") as log:
        return subprocess.Popen(
            [sys.executable, "-m", "board51", *map(str, words)],
            cwd=cwd, env=environment, stdout=log, stderr=log, text=True,
        )  # fmt: skip


def call(words: list[object], cwd: Path) -> tuple[int, str]:
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    process = subprocess.run(
        [sys.executable, "-m", "board51", *map(str, words)],
        cwd=cwd, env=environment, capture_output=True, text=True, timeout=WORK_S, check=False,
    )  # fmt: skip
    return process.returncode, process.stdout + process.stderr


def wait(condition: Callable[[], bool], what: str) -> None:
    deadline = time.monotonic() + HANG_S
    while not condition():
        assert time.monotonic() < deadline, f"no {what} within {HANG_S} s"
        time.sleep(0.05)


@dataclass
class Line:
    """Emulated board, gateway and twin, with a flight over the travel."""

    folder: Path
    endpoint: str
    alarms: list[pb.Alarm] = field(default_factory=list)
    newest: pb.State = field(default_factory=pb.State)

    def bus(self) -> list[object]:
        return ["--board", "rig", "--connect", self.endpoint]

    def send(self, *words: object) -> None:
        code, output = call(["send", "rig", *words, "--connect", self.endpoint], self.folder)
        assert code == 0, output


@pytest.fixture
def line(tmp_path: Path) -> Iterator[Line]:
    endpoint = free_endpoint()
    line = Line(tmp_path, endpoint)
    tty = tmp_path / "tty"
    with ExitStack() as stack:
        services: list[list[object]] = [
            ["emulate", "--pty", tty, *ADAPTER],
            ["gateway", "--board", f"rig={tty}", "--listen", endpoint, "--log-dir", "logs"],
            ["twin", *line.bus(), "--diagnosis-after", "2"],
        ]
        for words in services:
            process = start(words, tmp_path)
            stack.callback(process.wait, timeout=HANG_S)
            stack.callback(process.terminate)
            if words[0] == "emulate":
                wait(tty.exists, "pty")
        with socket.socket() as probe:
            wait(lambda: probe.connect_ex(("127.0.0.1", int(endpoint.rsplit(":", 1)[1]))) == 0, "gateway")
        config = zenoh.Config.from_json5(zenoh_config("client", connect=[endpoint]))
        with zenoh.open(config) as session:
            session.declare_subscriber(
                "board51/rig/twin/alarm", lambda s: line.alarms.append(pb.Alarm.FromString(s.payload.to_bytes()))
            )
            session.declare_subscriber("board51/rig/state", lambda s: line.newest.ParseFromString(s.payload.to_bytes()))
            wait(lambda: line.newest.tick > 0, "samples")
            yield line


@pytest.mark.slow
def test_a_lasting_alarm_leads_to_a_diagnosis_of_the_flight_and_to_a_quiet_twin(line: Line) -> None:
    code, output = call(["diagnose", "--live", "1", *line.bus(), "--quick", "--out", "early"], line.folder)
    assert code == 2, "nothing was flown yet"
    assert "0 s of the" in output
    assert "campaign run" in output

    # A campaign is what a good operator would fly; any flight with wide steps does.
    assert call(["campaign", "run", "flown", *line.bus(), "--quick"], line.folder)[0] == 0
    line.send("mode", "closed-loop")
    line.send("reference", "0.002")
    wait(lambda: any(a.name == "diagnosis-wanted" and a.active for a in line.alarms), "request")
    alarm, *_ = (a for a in line.alarms if a.name == "diagnosis-wanted" and a.active)  # it is repeated
    assert "board51 diagnose --live" in alarm.text

    words: list[object] = ["diagnose", "--live", "1.2", *line.bus(), "--quick", "--out", "diagnosis", "--hand-over"]
    code, output = call(words, line.folder)

    assert code == 0, output
    assert "from logs/" in output, "out of the gateway's log, while it is being written"
    assert "air-gap-offset" in output, "the emulated coil is 2.4 mm above the nominal model's"
    rms = [float(x) for x in re.findall(r"innovation (?:before|after): +x ([0-9.]+) um", output)]
    assert len(rms) == 2, output
    assert rms[1] < 0.2 * rms[0]
    (folder,) = (line.folder / "diagnosis").glob("live-*")
    assert (folder / "campaign.toml").is_file()
    tick = line.newest.tick
    wait(lambda: line.newest.tick > tick + 1500, "three seconds of flight")
    standing = {a.name: a.active for a in line.alarms}
    assert standing["diagnosis-wanted"] is False
    assert standing["innovation"] is False
