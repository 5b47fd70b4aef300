"""Serves a recorded board (`byte_replay`) on a port of the emulator, for `board51 replay --bytes`.

It waits for the first HELLO, then sends the recorded bytes at the pace of the log.  It waits for a slow or absent
reader, so that no byte is lost.
"""

from __future__ import annotations

import argparse
import json
import threading
import time

from gateway.emulator.ports import EmulatedPort, pty_ports, tcp_ports
from gateway.record.byte_replay import RecordedBoard
from gateway.record.replay import contents
from gateway.views.listen import address
from protocol.bus import board51_pb2 as pb
from protocol.bus.encoding import parse
from protocol.errors import UsageError
from protocol.log.reader import LogReader

LOOK_S = 2e-3  # largest delay of an answer and of a request to stop
DRAIN_S = 0.5  # time to answer remaining commands at the end


def replay_bytes(args: argparse.Namespace, stop: threading.Event) -> int:
    """Replay the bytes of one board; return 0 if all were sent."""
    if (args.pty is None) == (args.tcp is None):
        raise UsageError("--bytes needs a destination", remedy="Give --pty PATH or --tcp HOST:PORT")
    if args.loop or args.rename or args.topic or args.connect or args.listen:
        raise UsageError("--bytes does not go with the options of the bus", remedy="Leave those out")
    reader = LogReader(args.logs)
    boards = list(dict.fromkeys(board for _, board, _ in contents(reader, topics_=("raw",), boards=args.board)))
    if len(boards) > 1:
        raise UsageError(f"The log has bytes of several boards: {', '.join(boards)}", remedy="Choose one with --board")
    records = reader.raw(topics_=("raw",), boards=args.board, start_s=args.start, end_s=args.end)
    messages = (parse(pb.RawBytes, record.data) for record in records)
    board = RecordedBoard(message for message in messages if message is not None)
    if args.pty is not None:
        (port,) = pty_ports(args.pty, 1)
    else:
        (port,) = tcp_ports(*address(args.tcp.removeprefix("socket://"), where="--tcp"), 1)
    port.open()
    try:
        print(f"board on {port.url}", flush=True)
        sent = serve(board, port, speed=args.speed, stop=stop)
    finally:
        port.close()
    account = {"pieces": sent, "of": len(board.pieces), "answers_removed": board.removed, "refused": board.refused}
    print(json.dumps(account) if args.json else ", ".join(f"{name} {value}" for name, value in account.items()))
    return 0 if sent == len(board.pieces) else 1


def serve(board: RecordedBoard, port: EmulatedPort, *, speed: float, stop: threading.Event) -> int:
    """Play the board until its last byte or `stop`, at `speed` log seconds per second (0: as fast as the host reads).

    Returns:
        Number of pieces sent.
    """
    out, position = b"", 0
    begin_s: float | None = None
    end_s: float | None = None
    while not stop.is_set():
        answer = board.answer(port.read(4096), position=position)
        out += answer
        now_s, wait_s = time.monotonic(), LOOK_S
        if answer and begin_s is None:
            begin_s = now_s
        if begin_s is not None and not out and position < len(board.pieces):
            piece = board.pieces[position]
            due_s = (piece.time_ns - board.pieces[0].time_ns) / 1e9 / speed if speed > 0 else 0.0
            wait_s = min(wait_s, begin_s + due_s - now_s)
            if wait_s <= 0.0:
                out = piece.data
                position += 1
        elif position >= len(board.pieces) and not out:
            end_s = end_s or now_s + DRAIN_S
            if now_s >= end_s:
                break
        out = out[port.write(out, LOOK_S) :]
        if wait_s > 0.0:
            stop.wait(wait_s)
    return position
