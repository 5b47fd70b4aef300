"""Interface for the output of a board's driver.  Methods must not block: the serial thread calls them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

from google.protobuf.message import Message as ProtoMessage

from protocol.bus import board51_pb2 as pb

Reply = Callable[[pb.CommandReply], None]  # answers one query; called once, from the serial thread


class Sink(Protocol):
    """The output of one board to bus and log."""

    def states(self, payloads: list[bytes], host_time_ns: int, read_mono_ns: int) -> None:
        """Send the pb.State messages of one read; its last byte was read at `read_mono_ns` (monotonic)."""

    def send(self, topic: str, message: ProtoMessage, host_time_ns: int) -> None:
        """Send a message of any other topic."""

    def raw(self, data: bytes, host_time_ns: int, *, to_board: bool) -> None:
        """Log bytes as they crossed the UART."""

    def alive(self, *, alive: bool) -> None:
        """Hold or drop the liveliness token."""
