"""The OPC UA server judged by node-opcua, which shares no code with it; board, gateway and all are processes."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from gateway.access.folder import SecurityFolder
from gateway.access.roles import Role, may
from gateway.access.users import User
from gateway.processes.command import ADAPTER
from tests.harness.gateway.gateway_peers import wait_for
from tests.harness.gateway.npm import installed
from tests.harness.ports import free_port
from tests.patience import HANG_S

pytestmark = pytest.mark.slow  # test_opcua_* ask the same of a client in Python

SCRIPT_FOLDER = Path(__file__).parent / "node_opcua"
ROOT = Path(__file__).parents[3]
PASSWORDS = {"vera": "look-only-1", "otto": "fly-it-now-2"}
VARIABLES = [
    *(f"state/{name}{end}" for name in ("i_c_a", "x_m", "u_c_v", "x_ref_m") for end in ("", "/min", "/max")),
    *(f"state/{n}" for n in ("tick", "sequence", "t_s", "mode", "host_time_ns", "flags", "session", "lost_before")),
]
INTERVAL_MS = 20.0
WRITES = {
    "within": "Good", "outside": "BadOutOfRange", "wrong type": "BadTypeMismatch", "float": "BadTypeMismatch",
    "int": "BadTypeMismatch", "mode": "Good", "measured": "BadNotWritable",
}  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class Plant:
    url: str
    bus: str
    folder: Path  # of its keys
    node: Path  # where the judge and its packages are


@pytest.fixture(scope="module")
def node(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A directory with judge.mjs and its packages."""
    return installed(SCRIPT_FOLDER, tmp_path_factory.mktemp("node_opcua"))


@pytest.fixture(scope="module")
def plant(node: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Plant]:
    """`board51 emulate` and `board51 gateway --opcua --security`, as a user starts them."""
    folder = tmp_path_factory.mktemp("opcua")
    with ExitStack() as stack:
        run(stack, folder, "emulate", "--pty", str(folder / "tty"), *ADAPTER)
        wait_for((folder / "tty").exists, "pty", 30.0)
        plant = served(stack, folder, node)
        mode = board51("send", "rig1", "mode", "closed-loop", "--connect", plant.bus, "--identity",
                       str(plant.folder / "identities" / "otto"))  # fmt: skip
        assert mode.returncode == 0, mode.stdout + mode.stderr
        yield plant


def served(stack: ExitStack, folder: Path, node: Path, *, secured: bool = True) -> Plant:
    """A gateway with its OPC UA server, guarded or as it comes, for a board at `folder`/tty."""
    security = SecurityFolder(folder / "security")
    if secured:
        security.init()
        security.add_user(User(name="vera", role=Role.VIEWER), PASSWORDS["vera"])
        security.add_user(User(name="otto", role=Role.OPERATOR), PASSWORDS["otto"])
    guard = ("--security", str(security.path)) if secured else ()
    bus, port = f"tcp/127.0.0.1:{free_port()}", free_port()
    tty, logs = f"rig1={folder / 'tty'}", str(folder / "logs")
    views = ("--opcua", f"127.0.0.1:{port}", "--opcua-rate", "50")
    run(stack, folder, "gateway", "--board", tty, "--listen", bus, *guard, "--log-dir", logs, *views)
    wait_for(lambda: "rig1 is served" in read_log(folder), "OPC UA server", 90.0)
    return Plant(url=f"opc.tcp://127.0.0.1:{port}/board51/", bus=bus, folder=security.path, node=node)


def run(stack: ExitStack, folder: Path, *words: str) -> None:
    errors = stack.enter_context((folder / f"{words[0]}.log").open("wb"))
    process = subprocess.Popen(
        [sys.executable, "-m", "board51", *words],
        cwd=ROOT,
        stderr=errors,
        stdout=errors,
    )
    stack.callback(process.wait, 20)
    stack.callback(process.terminate)


def read_log(folder: Path) -> str:
    return (folder / "gateway.log").read_text()


def board51(*words: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "board51", *words], cwd=ROOT, capture_output=True, text=True, check=False
    )


def judge(plant: Plant, tmp_path: Path, name: str, *, seconds: float = 1.0, **options: Any) -> dict[str, Any]:
    identity = plant.folder / "identities" / name
    request = {
        "url": plant.url, "board": "rig1", "namespaceUri": "urn:board51:board51", "seconds": seconds,
        "variables": VARIABLES, "policy": "Basic256Sha256", "certificate": str(identity / "certificate.pem"),
        "key": str(identity / "key.pem"), "user": name, "password": PASSWORDS.get(name), "pki": str(tmp_path / "pki"),
        "ca": str(plant.folder / "ca.pem"),
        "within": 2.9e-3, "outside": 9e-3, **options,
    }  # fmt: skip
    process = subprocess.run(
        ["node", "judge.mjs", json.dumps(request)],
        cwd=plant.node,
        capture_output=True,
        text=True,
        check=False,
        timeout=seconds + 5 * HANG_S,
    )
    print(process.stderr)
    assert process.returncode == 0, process.stderr
    report: dict[str, Any] = json.loads(process.stdout.splitlines()[-1])
    return report


def expect_no_loss(report: dict[str, Any]) -> None:
    """Each interval of the board's time came: a lost one would show as 40 ms.

    How many came per second of this machine's time, and whether none came for so long that it is said, is the emulated
    board's affair on a busy machine; half of them at least, or nothing was tested.
    """
    assert len(report["series"]) == 20
    assert report["longest_board_s"] < 1.5e-3 * INTERVAL_MS
    counts = [series["count"] for series in report["series"].values()]
    assert max(counts) - min(counts) <= 2  # read while values arrive
    for path, series in report["series"].items():
        assert series["count"] > 0.5 * report["seconds"] * 1000.0 / INTERVAL_MS, (path, series)
        assert set(series["statuses"]) <= {"Good", "UncertainLastUsableValue"}, (path, series)


def test_an_operator_sees_20_variables_at_50_hz_and_commands_within_limits(plant: Plant, tmp_path: Path) -> None:
    report = judge(plant, tmp_path, "otto", seconds=4.0)

    assert report["browsed"] > 300
    assert sorted(report["endpoints"]) == [
        "Aes128_Sha256_RsaOaep SignAndEncrypt", "Aes256_Sha256_RsaPss SignAndEncrypt", "Basic256Sha256 SignAndEncrypt",
    ]  # fmt: skip
    assert report["EngineeringUnits"]["displayName"]["text"] == "m"
    expect_no_loss(report)
    assert report["writes"] == WRITES
    assert report["timestamps"] == {
        "Source": ["source"], "Server": ["server"], "Both": ["source", "server"], "Neither": [],
    }  # fmt: skip
    assert "http://opcfoundation.org/UA/SecurityPolicy#Basic256Sha256" in report["profiles"]
    assert report["calls"]["SetReference"]["code"] == "BadOutOfRange"
    assert report["calls"]["SetGains"]["code"] == "BadUserAccessDenied"
    assert report["calls"]["Stop"]["code"] == "Good"
    assert report["history"] > 30


def test_a_viewer_is_refused_every_command_that_the_table_of_rights_does_not_give(plant: Plant, tmp_path: Path) -> None:
    report = judge(plant, tmp_path, "vera", policy="Aes256_Sha256_RsaPss")

    assert (report["writes"]["within"], report["writes"]["mode"]) == ("BadUserAccessDenied", "BadUserAccessDenied")
    assert {name: call["code"] for name, call in report["calls"].items()} == {
        "SetReference": "BadUserAccessDenied",
        "SetGains": "BadUserAccessDenied",
        "Stop": "Good" if may(Role.VIEWER, "stop") else "BadUserAccessDenied",
    }
    assert report["series"]["state/x_m"]["count"] > 0


def test_on_an_unguarded_loopback_a_client_without_a_name_may_command(node: Path, tmp_path: Path) -> None:
    """What the page says of Node-RED, Grafana and the rest: no user, no certificate, the URL as it stands."""
    with ExitStack() as stack:
        run(stack, tmp_path, "emulate", "--pty", str(tmp_path / "tty"))
        wait_for((tmp_path / "tty").exists, "pty", 30.0)
        plant = served(stack, tmp_path, node, secured=False)
        mode = board51("send", "rig1", "mode", "closed-loop", "--connect", plant.bus)
        assert mode.returncode == 0, mode.stdout + mode.stderr
        report = judge(plant, tmp_path, "", user=None, policy=None)

    assert report["endpoints"] == ["None None"]
    assert report["writes"] == WRITES
    assert report["calls"]["SetGains"]["code"] == "Good"
    assert report["calls"]["Stop"]["code"] == "Good"
    assert report["series"]["state/x_m/max"]["count"] > 0
    assert report["history"] > 30


def test_a_wrong_password_gets_no_session(plant: Plant, tmp_path: Path) -> None:
    report = judge(plant, tmp_path, "otto", password="guess", policy="Aes128_Sha256_RsaOaep")

    assert "BadUserAccessDenied" in report["refused"]


def test_the_alarm_of_an_absent_board_is_acknowledged_by_its_event(node: Path, tmp_path: Path) -> None:
    with ExitStack() as stack:
        plant = served(stack, tmp_path, node)

        viewer = judge(plant, tmp_path, "vera", variables=[], alarm="link-down")
        operator = judge(plant, tmp_path, "otto", variables=[], alarm="link-down")
        second_viewer = judge(plant, tmp_path, "vera", variables=[], alarm="link-down")

    waiting = {"refresh": "Good", "active": True, "acked": False}
    assert viewer["alarm"] == {**waiting, "codes": ["BadEventIdUnknown", "BadUserAccessDenied"]}
    assert operator["alarm"] == {**waiting, "codes": ["BadEventIdUnknown", "Good"], "by": "otto", "comment": "known"}
    assert second_viewer["alarm"]["acked"] is True
    assert operator["calls"]["SetReference"]["code"] == "BadNoCommunication"
    assert operator["calls"]["Stop"]["code"] == "BadNoCommunication"


def test_the_nodeset_is_loaded_on_top_of_the_official_companion_specifications(node: Path) -> None:
    """Into node-opcua's address space, with DI and Machinery as their publisher has them."""
    file = ROOT / "protocol/opcua/board51.NodeSet2.xml"
    process = subprocess.run(
        ["node", "types.mjs", str(file)], cwd=node, capture_output=True, text=True, check=False, timeout=HANG_S
    )

    assert process.returncode == 0, process.stderr
    assert process.stderr == ""  # each node that it cannot take is a line
    report = json.loads(process.stdout.splitlines()[-1])
    assert report["declared"] > 300
    assert report["made"]["dataType"] == "ns=0;i=11"
    assert report["made"]["identification"] == "MachineIdentificationType"
    assert report["made"]["twin"] is False  # optional
    assert report["ids"] == {
        "di FunctionalGroupType": "i=1005", "machinery i=1001": "Machines",
        "machinery MachineryItemIdentificationType": "i=1004", "machinery MachineIdentificationType": "i=1012",
    }  # fmt: skip


def test_20_variables_at_50_hz_come_without_loss(plant: Plant, tmp_path: Path) -> None:
    report = judge(plant, tmp_path, "otto", seconds=20.0)

    expect_no_loss(report)
