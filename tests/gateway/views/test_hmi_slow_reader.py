"""A browser that never reads: it is cut off, costs no memory, and nobody else notices."""

from __future__ import annotations

import base64
import os
import socket
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

import pytest

from tests.harness.gateway.bus_peers import played_gateway, ticking
from tests.harness.gateway.gateway_peers import wait_for
from tests.harness.gateway.hmi_peers import Page, frame, hmi


@contextmanager
def never_reading(page: Page) -> Iterator[socket.socket]:
    """A WebSocket that asks for frames and takes none."""
    with socket.socket() as line:
        line.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        line.connect(("127.0.0.1", page.port))
        lines = [
            "GET /live/rig HTTP/1.1",
            f"Host: 127.0.0.1:{page.port}",
            f"Origin: {page.base}",
            "Upgrade: websocket",
            "Connection: Upgrade",
            f"Sec-WebSocket-Key: {base64.b64encode(os.urandom(16)).decode()}",
            "Sec-WebSocket-Version: 13",
            f"Sec-WebSocket-Protocol: board51, {page.token}",
            f"Cookie: {page.cookie_name}={page.cookie}",
        ]
        line.sendall(("\r\n".join(lines) + "\r\n\r\n").encode())
        yield line


def resident_mb(pid: int) -> float:
    text = Path(f"/proc/{pid}/status").read_text(encoding="ascii")
    return int(text.partition("VmRSS:")[2].split()[0]) / 1e3


def sockets(pid: int) -> int:
    count = 0
    for entry in os.listdir(f"/proc/{pid}/fd"):
        with suppress(FileNotFoundError):  # closed meanwhile
            count += os.readlink(f"/proc/{pid}/fd/{entry}").startswith("socket:")
    return count


@pytest.mark.slow
def test_others_get_their_frames_while_some_do_not_read(tmp_path: Path) -> None:
    with ExitStack() as stack:
        gateway = stack.enter_context(played_gateway())
        port, _ = stack.enter_context(hmi(tmp_path, gateway.endpoint))
        stack.enter_context(ticking(gateway, period_s=0.002))
        page = Page(port)
        page.open()
        for _ in range(4):
            stack.enter_context(never_reading(page))

        with page.live("/live/rig") as reader:
            wait_for(lambda: "now" in frame(reader), "the board")
            for _ in range(30):  # how fast: tests/bench/reactions.py
                assert "now" in frame(reader)


@pytest.mark.slow
def test_who_never_reads_is_cut_off_and_costs_no_memory(tmp_path: Path) -> None:
    with ExitStack() as stack:
        gateway = stack.enter_context(played_gateway())
        port, process = stack.enter_context(hmi(tmp_path, gateway.endpoint))
        stack.enter_context(ticking(gateway, period_s=0.002))
        page = Page(port)
        page.open()
        with page.live("/live/rig") as reader:
            wait_for(lambda: "now" in frame(reader), "the board")
        before, before_mb = sockets(process.pid), resident_mb(process.pid)

        for _ in range(8):
            stack.enter_context(never_reading(page))
        wait_for(lambda: sockets(process.pid) >= before + 8, "the eight")
        wait_for(lambda: sockets(process.pid) <= before, "the end of the eight")

        print(f"resident: {before_mb:.1f} MB before, {resident_mb(process.pid):.1f} MB after")
        assert resident_mb(process.pid) < before_mb + 20.0
