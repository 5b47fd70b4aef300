"""Summaries of a log that many browsers ask for at once, and the processes that read it."""

from __future__ import annotations

import contextlib
import random
import socket
from pathlib import Path

from gateway.record.writer import LogWriter
from protocol.bus import board51_pb2 as pb
from tests.harness.gateway.hmi_peers import Page
from tests.patience import HANG_S


def write_log(path: Path, messages: int) -> None:
    """A log whose summary takes as long as its size asks for."""
    rng, writer = random.Random(31), LogWriter(path)
    for tick in range(messages):
        at_ns = 1_700_000_000_000_000_000 + tick * 2_000_000
        state = pb.State(tick=tick, session=1, host_time_ns=at_ns, x_m=rng.random(), i_c_a=rng.random())
        writer.write("board51/rig/state", state.SerializeToString(), at_ns)
    writer.close()


def children(pid: int) -> list[int]:
    """The processes of a page's server that read a log."""
    pids = []
    for entry in Path("/proc").iterdir():
        with contextlib.suppress(OSError, ValueError):
            stat = (entry / "stat").read_text()
            words = (entry / "cmdline").read_bytes().split(b"\0")
            if int(stat.rpartition(")")[2].split()[1]) == pid and b"info" in words:
                pids.append(int(entry.name))
    return pids


class Viewers:
    """Browsers that ask for the summary of a log and wait."""

    def __init__(self, page: Page) -> None:
        self._page = page
        self._sockets: list[socket.socket] = []

    def request_summaries(self, count: int) -> None:
        for _ in range(count):
            browser = socket.create_connection(("127.0.0.1", self._page.port), timeout=HANG_S)
            head = f"Host: 127.0.0.1:{self._page.port}\r\nCookie: {self._page.cookie_name}={self._page.cookie}"
            browser.sendall(f"GET /api/summary/logs/big.mcap HTTP/1.1\r\n{head}\r\n\r\n".encode())
            self._sockets.append(browser)

    def statuses(self) -> list[int]:
        """Return the statuses of the requests that were answered so far."""
        codes = []
        for browser in self._sockets:
            browser.setblocking(False)
            with contextlib.suppress(BlockingIOError):
                codes.append(int(browser.recv(16, socket.MSG_PEEK).split()[1]))
        return codes

    def leave(self) -> None:
        while self._sockets:
            self._sockets.pop().close()
