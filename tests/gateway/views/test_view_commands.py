"""The commands as a user meets them: what is wrong is said in one line, with exit code 2."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

import board51
from gateway.commands.views.opcua import anonymous
from gateway.config import OpcuaConfig
from gateway.views.listen import address


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["opcua", "--listen", "0.0.0.0:4840"], "open to the network without protection"),
        (["opcua", "--listen", "4840"], "not an address"),
        (["opcua", "--listen", "localhost:99999"], "not an address"),
        (["opcua", "--rate", "500"], "Give 10 .. 50: values per second"),
        (["opcua", "--rate", "nan"], "Give 10 .. 50: values per second"),
        (["opcua", "--history", "1e9"], "Give 10 .. 3600: how far"),
        (["opcua", "--security", "/nowhere"], "cannot be read"),
        (["opcua", "--listen", "0.0.0.0:4840", "--insecure", "--anonymous", "operator"], "everybody in the network"),
        (["opcua", "--site", "a/b"], "is not a name"),
        (["foxglove", "--listen", "0.0.0.0:8765"], "ssh"),
        (["foxglove", "--board", "Rig 1", "--print-layout"], "is not a name"),
        (
            ["gateway", "--board", "rig=/dev/null", "--opcua", "nowhere"],
            "--opcua or [opcua] listen: 'nowhere' is not an address",
        ),
        (["gateway", "--board", "rig=/dev/null", "--opcua", "--opcua-rate", "500"], "Give 10 .. 50: values per second"),
        (["gateway", "--board", "rig=/dev/null", "--opcua-rate", "nan"], "--opcua-rate"),
        (["gateway", "--board", "rig=/dev/null", "--foxglove", "0.0.0.0:1"], "without protection"),
    ],
)
def test_a_wrong_option_is_one_line_and_exit_code_2(
    words: list[str], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    code = board51.main(words)

    errors = capsys.readouterr().err
    assert code == 2
    assert message in errors
    assert errors.count("\n") == 1


def test_help_has_an_example(capsys: pytest.CaptureFixture[str]) -> None:
    for command in ("opcua", "foxglove"):
        with pytest.raises(SystemExit):
            board51.main([command, "--help"])
        assert f"board51 {command}" in capsys.readouterr().out.partition("examples:")[2]


def test_help_names_the_defaults_of_the_configuration(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        board51.main(["opcua", "--help"])
    output = " ".join(capsys.readouterr().out.split())
    assert f"each with min and max ({OpcuaConfig.rate_hz:g})" in output
    assert f"10 to 3600 s ({OpcuaConfig.history_s:g})" in output


@pytest.mark.parametrize("command", ["send", "opcua"])
def test_help_does_not_wait_for_pydantic(command: str) -> None:
    words = [sys.executable, "-X", "importtime", "-m", "board51", command, "--help"]
    imported = subprocess.run(words, capture_output=True, text=True, check=True).stderr
    assert "argparse" in imported
    assert "pydantic" not in imported


def test_a_layout_is_printed_for_the_board_that_was_asked_for(capsys: pytest.CaptureFixture[str]) -> None:
    assert board51.main(["foxglove", "--print-layout", "--site", "lab", "--board", "rig7"]) == 0

    printed = capsys.readouterr().out
    assert "lab/rig7/state" in printed
    assert "board51/rig1" not in printed


@pytest.mark.parametrize(
    ("text", "parts"),
    [("127.0.0.1:4840", ("127.0.0.1", 4840)), ("[::1]:1", ("::1", 1)), ("scada.plant:4840", ("scada.plant", 4840))],
)
def test_an_address_is_host_and_port(text: str, parts: tuple[str, int]) -> None:
    assert address(text) == parts


def test_the_shipped_page_names_what_exists() -> None:
    page = (Path(board51.__file__).parent / "gateway" / "views" / "README.md").read_text()

    assert "board51 opcua" in page
    assert all(word in page for word in ("Ignition", "Node-RED", "Grafana", "PlotJuggler", "zenoh"))


@pytest.mark.parametrize(
    ("host", "secured", "guarded", "may"),
    [
        ("127.0.0.1", False, False, "engineer"),  # as everybody on this machine may on the bus
        ("127.0.0.1", False, True, "viewer"),  # the bus has roles, and this client none
        ("0.0.0.0", False, False, "viewer"),
        ("127.0.0.1", True, True, "off"),
        ("0.0.0.0", True, True, "off"),
    ],
)
def test_what_a_client_without_a_name_may_do(host: str, secured: bool, guarded: bool, may: str) -> None:
    assert anonymous(host, secured=secured, guarded=guarded) == may
