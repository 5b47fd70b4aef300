"""A port that accepts any number of bytes."""

from __future__ import annotations

from protocol.wire.outgoing import SendQueue
from protocol.wire.session import Session


def take_output(sender: Session | SendQueue) -> bytes:
    """Return all bytes that `sender` has to write; they count as written."""
    frames = b""
    while data := sender.output():
        frames += data
        sender.wrote(len(data))
    return frames
