"""Tests of the time after the end of the serial thread: a late command, a port that opens late."""

from __future__ import annotations

import os
import pty
import threading

import pytest

from gateway.config import BoardConfig
from gateway.link import io_thread
from gateway.link.clock import HostClock
from gateway.link.driver import BoardDriver
from gateway.link.io_thread import LinkThread
from gateway.link.port import Port, PortProblem, open_port
from protocol.bus import board51_pb2 as pb
from tests.harness.gateway.gateway_peers import Collector, anybody, wait_for
from tests.patience import HANG_S


def test_a_command_after_the_end_is_told_that_the_link_is_down() -> None:
    driver = BoardDriver(BoardConfig(name="rig", port="/nowhere"), Collector(), HostClock())
    link = LinkThread([driver])
    link.start()
    link.stop()
    replies: list[pb.CommandReply] = []

    link.command(driver, pb.Command(id="late", ping=pb.Ping()).SerializeToString(), replies.append, anybody())

    assert [reply.refused_by for reply in replies] == ["link"]
    assert not link.post(lambda: None)


def test_a_port_that_opens_after_the_end_is_closed_again(monkeypatch: pytest.MonkeyPatch) -> None:
    """Else it stays locked against the next gateway for as long as the process lives."""
    leader, follower = pty.openpty()
    go_on, opened = threading.Event(), list[Port | PortProblem]()

    def open_slowly(url: str, baud: int) -> Port | PortProblem:
        go_on.wait(HANG_S)
        opened.append(open_port(url, baud))
        return opened[0]

    monkeypatch.setattr(io_thread, "open_port", open_slowly)
    driver = BoardDriver(BoardConfig(name="rig", port=os.ttyname(follower)), Collector(), HostClock())
    link = LinkThread([driver])
    link.start()
    opener = wait_for(lambda: next((t for t in threading.enumerate() if t.name == "open-rig"), None), "opener")
    link.stop()

    go_on.set()
    opener.join(30.0)

    assert isinstance(opened[0], Port)
    with pytest.raises(OSError, match="Bad file descriptor"):
        os.fstat(opened[0].fd)
    os.close(leader)
    os.close(follower)
