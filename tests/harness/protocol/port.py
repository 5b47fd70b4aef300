"""A port that accepts any number of bytes."""

from __future__ import annotations

from typing import Protocol

from protocol.wire.exchange import SendQueue
from protocol.wire.session import Session


class Frames(Protocol):
    """A board, as `gateway.emulator.line.Board`."""

    def take_frame(self) -> bytes: ...


def take_output(sender: Session | SendQueue | Frames) -> bytes:
    """Return all bytes that `sender` has to write; they count as written."""
    if not isinstance(sender, Session | SendQueue):
        return b"".join(iter(sender.take_frame, b""))
    frames = b""
    while data := sender.output():
        frames += data
        sender.wrote(len(data))
    return frames
