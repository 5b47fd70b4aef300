"""Serves a recorded board on a pty or a TCP port: the I/O of `byte_replay`.

It waits for the first HELLO, then sends the recorded bytes at the pace of the log.  It waits for a slow or absent
reader, so that no byte is lost.
"""

from __future__ import annotations

import os
import select
import socket
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import NamedTuple

from gateway.record.byte_replay import RecordedBoard
from protocol.errors import ServiceError, UsageError

POLL_S = 0.1  # largest delay of a request to stop
DRAIN_S = 0.5  # time to answer remaining commands at the end


class Line(NamedTuple):
    """The board's end of a line, which does not block."""

    descriptor: int  # to wait for
    read: Callable[[int], bytes]
    write: Callable[[bytes], int]


@contextmanager
def open_pty(link: Path) -> Iterator[Line]:
    """Open a pty; yield the board's end, and make the other end available as `link`.

    Raises:
        UsageError: this system has no ptys.
        ServiceError: the link exists or cannot be made.
    """
    if os.name != "posix":
        raise UsageError("A pty needs Linux or macOS", remedy="Give --tcp HOST:PORT instead")
    import tty

    board, host = os.openpty()
    try:
        tty.setraw(host)
        try:
            link.symlink_to(os.ttyname(host))
        except OSError as error:
            raise ServiceError(
                f"Pty {link} cannot be made: {(error.strerror or 'unknown').lower()}", remedy="Choose another path"
            ) from None
        try:
            os.set_blocking(board, False)
            yield Line(board, partial(os.read, board), partial(os.write, board))
        finally:
            link.unlink(missing_ok=True)
    finally:
        os.close(board)
        os.close(host)  # open until now: otherwise the board's end reports an error while it has no reader


@contextmanager
def open_tcp(host: str, port: int, *, stop: threading.Event) -> Iterator[Line | None]:
    """Wait for the first connection to host:port and yield it; None if `stop` is set first.

    Raises:
        ServiceError: the port cannot be opened.
    """
    try:
        server = socket.create_server((host, port))
    except OSError as error:
        raise ServiceError(
            f"Port {host}:{port} cannot be opened: {(error.strerror or str(error)).lower()}",
            remedy="Free it or choose another",
        ) from None
    with server:
        server.settimeout(POLL_S)
        while not stop.is_set():
            try:
                connection, _ = server.accept()
            except TimeoutError:
                continue
            with connection:
                connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                connection.setblocking(False)
                yield Line(connection.fileno(), connection.recv, connection.send)
            return
        yield None


def serve(board: RecordedBoard, port: Line, *, speed: float, stop: threading.Event) -> int:
    """Play the board on an open line until its last byte, `stop`, or the host hangs up.

    Args:
        board: Board to play.
        port: Its end of the line.
        speed: Log seconds per second; 0 is as fast as the host reads.
        stop: Set it to end early.

    Returns:
        Number of pieces sent.
    """
    out = b""
    position = 0
    begin_s: float | None = None
    end_s: float | None = None
    while not stop.is_set():
        now_s = time.monotonic()
        wait_s = POLL_S
        if begin_s is not None and not out and position < len(board.pieces):
            piece = board.pieces[position]
            due_s = (piece.time_ns - board.pieces[0].time_ns) / 1e9 / speed if speed > 0 else 0.0
            wait_s = min(wait_s, begin_s + due_s - now_s)
            if wait_s <= 0.0:
                out += piece.data
                position += 1
                wait_s = 0.0
        elif position >= len(board.pieces) and not out:
            end_s = end_s or now_s + DRAIN_S
            if now_s >= end_s:
                break
        readable, writable, _ = select.select([port.descriptor], [port.descriptor] if out else [], [], max(0.0, wait_s))
        try:
            if readable:
                data = port.read(4096)
                if not data:
                    break
                answer = board.answer(data, position=position)
                out += answer
                if answer and begin_s is None:
                    begin_s = time.monotonic()
            if writable or out:
                out = out[port.write(out) :] if out else out
        except BlockingIOError:
            select.select([], [port.descriptor], [], POLL_S)
        except OSError:  # the host hung up
            break
    return position
