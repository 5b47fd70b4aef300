"""Ports: what opens, what does not, and why.  A tty is tried by its descriptor, and through pyserial as on Windows."""

from __future__ import annotations

import io
import os
import select
import socket
import struct
import time
import tty
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace

import pytest
import serial
from serial.tools import list_ports

from gateway.config import load_config
from gateway.link import port as module
from gateway.link.port import Port, PortProblem, check_url, open_port
from protocol.errors import ConfigError
from tests.harness.ports import free_port
from tests.harness.windows.sitecustomize import Module
from tests.patience import HANG_S


@pytest.fixture(params=["descriptor", "pyserial"])
def way(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    def no_descriptor(_device: serial.Serial) -> int:
        raise io.UnsupportedOperation("fileno")  # as that of Windows

    if request.param == "pyserial":
        monkeypatch.setattr(serial.Serial, "fileno", no_descriptor)


@pytest.fixture
def windows(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "os", Module(os, name="nt"))


@pytest.fixture
def pty(way: None) -> Iterator[tuple[int, str]]:
    master, slave = os.openpty()
    tty.setraw(slave)
    yield master, os.ttyname(slave)
    os.close(slave)
    os.close(master)


def problem(url: str) -> PortProblem:
    opened = open_port(url, 115200)
    assert isinstance(opened, PortProblem)
    return opened


def test_bytes_pass_both_ways_without_blocking(pty: tuple[int, str]) -> None:
    master, name = pty
    port = open_port(name, 115200)
    assert isinstance(port, Port)

    assert not port.read()
    os.write(master, b"\x00\x11\x13\x0a\x00")
    select.select([port.fd], [], [], 5.0)

    assert port.read() == b"\x00\x11\x13\x0a\x00"
    assert port.write(b"\x00\x0a\x04") == 3
    assert os.read(master, 10) == b"\x00\x0a\x04"
    port.close()


def test_a_second_gateway_on_a_tty_is_told_so(pty: tuple[int, str]) -> None:
    first = open_port(pty[1], 115200)
    assert isinstance(first, Port)

    second = problem(pty[1])
    first.close()

    assert second.kind == "port-busy"
    assert "second gateway" in second.text
    third = open_port(pty[1], 115200)
    assert isinstance(third, Port)
    third.close()


def test_what_is_not_there_is_absent(tmp_path: Path) -> None:
    assert problem(str(tmp_path / "ttyUSB0")).kind == "port-absent"
    assert problem(str(tmp_path / "ttyUSB*")).kind == "port-absent"
    assert problem(f"socket://127.0.0.1:{free_port()}").kind == "port-absent"


def test_a_file_is_not_a_serial_device(tmp_path: Path) -> None:
    (tmp_path / "notes.txt").write_text("hello")

    assert problem(str(tmp_path / "notes.txt")).kind == "port-failed"


@pytest.mark.skipif(os.geteuid() == 0, reason="root may open everything")
def test_a_port_without_permission_says_which_group(pty: tuple[int, str]) -> None:
    os.chmod(pty[1], 0)

    assert "dialout" in problem(pty[1]).text


def test_a_pattern_takes_the_first_match_that_is_free(pty: tuple[int, str], tmp_path: Path) -> None:
    (tmp_path / "usb-a-gone").symlink_to(tmp_path / "nothing")
    (tmp_path / "usb-b").symlink_to(pty[1])

    port = open_port(str(tmp_path / "usb-*"), 115200)

    assert isinstance(port, Port)
    assert port.name == str(tmp_path / "usb-b")
    port.close()


@pytest.mark.usefixtures("way")
def test_the_end_of_a_pty_is_the_end_of_the_port() -> None:
    master, slave = os.openpty()
    tty.setraw(slave)
    port = open_port(os.ttyname(slave), 115200)
    assert isinstance(port, Port)
    os.close(slave)

    os.close(master)

    select.select([port.fd], [], [], 5.0)
    assert port.read() == b""
    assert port.write(b"x") is None
    port.close()


def test_a_line_over_tcp_that_its_peer_has_reset_leaves_no_open_socket() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = open_port(f"socket://127.0.0.1:{server.getsockname()[1]}", 115200)
        assert isinstance(port, Port)
        peer, _ = server.accept()
        peer.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))  # its close is a reset
        peer.close()
        own = vars(port._device)["_socket"]
        select.select([own], [], [], HANG_S)
        port.close()

    assert own.fileno() == -1


def test_a_handler_without_a_descriptor_is_pumped() -> None:
    port = open_port("loop://", 115200)
    assert isinstance(port, Port)

    assert port.write(b"around") == 6
    received, deadline_s = b"", time.monotonic() + HANG_S
    while received != b"around" and time.monotonic() < deadline_s:
        select.select([port.fd], [], [], 1.0)
        received += port.read() or b""

    assert received == b"around"
    port.close()


@pytest.mark.usefixtures("windows")
@pytest.mark.parametrize(
    ("message", "kind"),
    [
        ("could not open port 'COM3': FileNotFoundError(2, 'The system cannot find the file.', None, 2)", "absent"),
        ("could not open port 'COM3': PermissionError(13, 'Access is denied.', None, 5)", "busy"),
        ("Cannot configure port, something went wrong.", "failed"),
    ],
)
def test_a_com_port_that_does_not_open_says_why(monkeypatch: pytest.MonkeyPatch, message: str, kind: str) -> None:
    def refuse(*_words: object, **_options: object) -> serial.Serial:
        raise serial.SerialException(message)

    monkeypatch.setattr(serial, "serial_for_url", refuse)
    monkeypatch.setattr(
        list_ports, "comports", lambda: [SimpleNamespace(device="COM3"), SimpleNamespace(device="LPT1")]
    )

    assert problem("COM3").kind == problem("COM*").kind == f"port-{kind}"
    assert problem("COM9*").text == "No device matches COM9*."


@pytest.mark.parametrize("name", ["COM3", r"\\.\COM10"])
def test_a_com_port_is_a_name_like_any_other(name: str) -> None:
    check_url(name)

    assert load_config(None, {"BOARD51_BOARDS": f"rig1={name}"}).boards[0].port == name


@pytest.mark.parametrize("url", ["nonsense://x", "socket://host", "socket://host:port", "socket://:80"])
def test_a_url_that_can_never_open_is_a_configuration_error(url: str) -> None:
    with pytest.raises(ConfigError, match="port"):
        check_url(url)
