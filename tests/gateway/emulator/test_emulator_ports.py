"""Ports and the server, with raw sockets and file descriptors: nothing of the gateway in between."""

from __future__ import annotations

import os
import select
import termios
from collections.abc import Iterator
from pathlib import Path

import pytest

import board51
from gateway.emulator.ports import PtyPort
from gateway.emulator.serve import Emulator
from protocol.errors import ServiceError, UsageError
from protocol.wire.decoder import BadFrame, State
from protocol.wire.messages import EventCode
from tests.harness.gateway.board_host import frame
from tests.harness.gateway.raw_wire import Wire, is_event, is_state, until
from tests.patience import HANG_S


@pytest.fixture(params=["tcp", "pty"])
def emulator(request: pytest.FixtureRequest) -> Iterator[Emulator]:
    with Emulator(tcp=request.param == "tcp") as emulator:
        yield emulator


def test_a_round_trip_over_the_real_port(emulator: Emulator) -> None:
    with Wire(emulator.urls[0]) as wire:
        identity = wire.hello()
        wire.write(frame("SET_MODE", id=2, mode=2))
        wire.until(lambda event: isinstance(event, State) and abs(event.x - event.x_ref) < 50)

    assert identity.int("board_id") == 1
    assert not any(isinstance(event, BadFrame) for event in wire.events[1:])  # it may begin in the middle of a frame


def test_hosts_come_and_go_and_find_no_stale_bytes(emulator: Emulator) -> None:
    with Wire(emulator.urls[0]) as first:
        first.until(is_state)
        left_at = first.states()[-1].sequence
    until(lambda: emulator.counts().bytes_not_taken > 2000)

    with Wire(emulator.urls[0]) as second:
        second.until(is_state)

    assert second.states()[0].sequence > left_at + 2000 // 15 - 10


def test_what_one_host_left_unread_is_not_for_the_next(tmp_path: Path) -> None:
    port = PtyPort(tmp_path / "board")
    port.open()

    def sent(data: bytes) -> int:
        """A host that has `data` to read."""
        host = os.open(port.url, os.O_RDWR | os.O_NOCTTY)
        port.read(1)
        assert port.write(data) == len(data)
        assert select.select([host], [], [], HANG_S)[0]
        return host

    os.close(sent(b"old"))
    assert port.read(1) == b""
    host = sent(b"new")
    assert os.read(host, 100) == b"new"
    os.close(host)
    port.close()


def test_unplug_ends_the_connection_and_plug_brings_it_back(emulator: Emulator) -> None:
    with Wire(emulator.urls[0]) as wire:
        wire.until(is_state)
        emulator.disconnect()
        wire.until_hung_up()
    with pytest.raises(OSError, match=r"refused|No such file"):
        Wire(emulator.urls[0])

    emulator.reconnect()

    with Wire(emulator.urls[0]) as wire:
        wire.until(is_state)


def test_reset_shows_as_a_new_start(emulator: Emulator) -> None:
    with Wire(emulator.urls[0]) as wire:
        wire.until(lambda event: isinstance(event, State) and event.sequence > 50)
        emulator.reset_board()
        wire.until(is_event(EventCode.RESET_POWER_ON))
        state = wire.until(is_state)

    assert isinstance(state, State)
    assert state.sequence < 50


def test_a_pty_is_raw_and_may_come_back_under_another_name(tmp_path: Path) -> None:
    link = tmp_path / "rig"
    with Emulator(tcp=False, pty=link) as emulator:
        with Wire(str(link)) as wire:
            wire.until(is_state)
            local_flags = wire.local_flags()
        emulator.disconnect()
        emulator.reconnect(renamed=True)
        with Wire(emulator.urls[0]) as wire:
            wire.until(is_state)
        renamed = emulator.urls[0]
        assert not link.exists()

    assert local_flags & (termios.ECHO | termios.ICANON | termios.ISIG) == 0
    assert renamed == f"{link}-renamed"
    assert list(tmp_path.iterdir()) == []


def test_one_host_at_a_time_on_tcp() -> None:
    with Emulator() as emulator, Wire(emulator.urls[0]) as first:
        first.until(is_state)
        with Wire(emulator.urls[0]) as second:
            second.until_hung_up()
        first.until(is_state)


def test_a_host_that_does_not_read_costs_bytes_and_not_the_board() -> None:
    with Emulator(tcp=False, speed=50.0) as emulator, Wire(emulator.urls[0]) as wire:
        until(lambda: emulator.counts().bytes_not_taken > 100_000)
        until(lambda: bool(wire.read()) and emulator.counts().time_s > 1.0)
        wire.until(is_state)


def test_a_fault_can_be_injected_while_it_runs() -> None:
    with Emulator() as emulator, Wire(emulator.urls[0]) as wire:
        wire.until(is_state)
        emulator.inject("flip=0.05:tx")
        wire.until(lambda event: isinstance(event, BadFrame))

        with pytest.raises(UsageError):
            emulator.inject("flop=1")


def test_several_boards_differ_in_id_and_noise_only() -> None:
    with Emulator(boards=3, board_id=40) as emulator:
        boards = []
        for url in emulator.urls:
            with Wire(url) as wire:
                boards.append((wire.hello().int("board_id"), tuple(state.x for state in wire.states())))

    assert [board for board, _ in boards] == [40, 41, 42]
    assert len({readings for _, readings in boards}) == 3


def test_a_port_in_use_is_an_error_and_leaves_nothing_open(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(UsageError, match="File exists"):
        Emulator(tcp=False, pty=tmp_path / "file")

    with Emulator() as emulator:
        port = int(emulator.urls[0].rpartition(":")[2])
        assert board51.main(["emulate", "--tcp", f"127.0.0.1:{port}"]) == ServiceError.exit_code
