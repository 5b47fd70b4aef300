"""Logs are readable by @mcap/core and protobufjs from npm: they share no code with the writer, and do not know us."""

from __future__ import annotations

import json
import subprocess
from pathlib import Path
from typing import Any

import pytest

from gateway.record.recorder import Recorder, RecorderOptions
from gateway.record.recover import recover
from protocol.bus import board51_pb2 as pb
from tests.harness.gateway.npm import installed

CHECKER_FOLDER = Path(__file__).parent / "mcap_core"
START_NS = 1_700_000_000_000_000_000


@pytest.fixture(scope="module")
def checker(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A directory with check.mjs and its packages."""
    return installed(CHECKER_FOLDER, tmp_path_factory.mktemp("mcap_core"))


def check(checker: Path, log: Path) -> dict[str, Any]:
    process = subprocess.run(["node", "check.mjs", str(log)], cwd=checker, capture_output=True, text=True, check=False)
    assert process.returncode == 0, process.stderr
    report: dict[str, Any] = json.loads(process.stdout)
    return report


def write(folder: Path) -> Path:
    recorder = Recorder(
        folder,
        RecorderOptions(prefix="rig", rotate_bytes=1 << 30, rotate_s=3600, min_free_bytes=0, flush_s=0.0),
        metadata={"config": {"port": "/dev/ttyUSB0"}},
    )
    recorder.start()
    parameters = pb.Parameters(host_time_ns=START_NS, sample_time_s=0.002, gains=[0.49, 1700.0, 17.7, -17600.0])
    recorder.put("board51/rig/parameters", parameters.SerializeToString(), START_NS)
    for tick in range(3000):
        now_ns = START_NS + tick * 2_000_000
        state = pb.State(tick=tick, session=1, host_time_ns=now_ns, x_m=tick * 1e-6, i_c_a=0.0, mode=pb.MODE_OPEN_LOOP)
        recorder.put("board51/rig/state", state.SerializeToString(), now_ns)
    recorder.put("board51/rig/status", pb.Status(bad_frames={"crc": 3}).SerializeToString(), now_ns)
    recorder.close()
    return next(folder.iterdir())


def expect(report: dict[str, Any]) -> None:
    state = report["topics"]["board51/rig/state"]
    assert state["schema"] == ".board51.v1.State"
    assert state["count"] == 3000
    assert state["log_time"] == [str(START_NS + tick * 2_000_000) for tick in range(3000)]
    assert state["last"]["tick"] == 2999
    assert state["last"]["x_m"] == 2999 * 1e-6
    assert state["last"]["i_c_a"] == 0.0  # measured as zero, not absent
    assert "u_c_v" not in state["last"]
    assert report["topics"]["board51/rig/parameters"]["first"]["gains"] == [0.49, 1700.0, 17.7, -17600.0]
    assert report["topics"]["board51/rig/status"]["first"]["bad_frames"] == [{"key": "crc", "value": 3}]
    assert report["metadata"]["config"] == {"port": "/dev/ttyUSB0"}
    assert report["streamed"] == 3002
    assert report["done"] is True


@pytest.mark.slow
def test_an_independent_reader_decodes_a_log(checker: Path, tmp_path: Path) -> None:
    expect(check(checker, write(tmp_path)))


@pytest.mark.slow
def test_an_independent_reader_decodes_a_recovered_log(checker: Path, tmp_path: Path) -> None:
    (tmp_path / "logs").mkdir()
    log = write(tmp_path / "logs")
    broken = tmp_path / "broken.mcap"
    broken.write_bytes(log.read_bytes()[:-50])  # the end is missing, and with it the index

    recover(broken, tmp_path / "clean.mcap")

    expect(check(checker, tmp_path / "clean.mcap"))
