"""A raw connection to a port of the emulator: sockets and file descriptors, nothing of the gateway."""

from __future__ import annotations

import contextlib
import os
import select
import socket
import termios
import time
from collections.abc import Callable
from typing import Self

from protocol.wire.decoder import Event, State, StreamDecoder
from protocol.wire.messages import EventCode, Message
from tests.harness.gateway.board_host import frame
from tests.patience import HANG_S


class Wire:
    """A raw connection to a URL of the emulator."""

    def __init__(self, url: str) -> None:
        self._socket: socket.socket | None = None
        if url.startswith("socket://"):
            host, _, port = url.removeprefix("socket://").rpartition(":")
            self._socket = socket.create_connection((host, int(port)), timeout=HANG_S)
            self._file = self._socket.fileno()
        else:
            self._file = os.open(url, os.O_RDWR | os.O_NOCTTY)
        os.set_blocking(self._file, False)
        self._decoder = StreamDecoder()
        self.events: list[Event] = []
        self.bytes_read = 0

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        if self._socket is not None:
            self._socket.close()
        else:
            os.close(self._file)

    def write(self, data: bytes) -> None:
        assert os.write(self._file, data) == len(data)

    def until(self, condition: Callable[[Event], bool]) -> Event:
        """Read until an event is what is wanted."""
        end = time.monotonic() + HANG_S
        while time.monotonic() < end:
            for event in self.read():
                if condition(event):
                    return event
        raise AssertionError(f"not among {len(self.events)} events: {self.events[-5:]}")

    def until_hung_up(self) -> None:
        """Read until the other end has gone: an end of file, or an error of the port."""
        end = time.monotonic() + HANG_S
        with contextlib.suppress(EOFError, OSError):
            while time.monotonic() < end:
                self.read()
        assert time.monotonic() < end

    def read(self) -> list[Event]:
        if not select.select([self._file], [], [], 0.1)[0]:
            return []
        data = os.read(self._file, 4096)
        if not data:
            raise EOFError
        self.bytes_read += len(data)
        events = self._decoder.feed(data)
        self.events += events
        return events

    def local_flags(self) -> int:
        """The terminal's c_lflag."""
        flags = termios.tcgetattr(self._file)[3]
        assert isinstance(flags, int)
        return flags

    def hello(self, session: int = 1) -> Message:
        self.write(frame("HELLO", id=200, session=session, version_min=1, version_max=1))
        event = self.until(lambda event: isinstance(event, Message) and event.name == "IDENTITY")
        assert isinstance(event, Message)
        return event

    def states(self) -> list[State]:
        return [event for event in self.events if isinstance(event, State)]


def is_state(event: Event) -> bool:
    return isinstance(event, State)


def is_event(code: EventCode) -> Callable[[Event], bool]:
    return lambda event: isinstance(event, Message) and event.name == "EVENT" and event.int("code") == code


def until(condition: Callable[[], bool]) -> None:
    end = time.monotonic() + HANG_S
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.002)
