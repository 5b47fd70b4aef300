"""Fill the gaps of the recording in FOLDER from the log servers of its site (`board51 serve-log`).

It writes the records that were missed while a line between two sites was cut, as further parts fill-*.mcap.  You may
stop, kill and start it again at any time.  Exit code 0: the recording has all records of the servers; 1: no server
answers, or one has records that are younger than --settle.
"""

from __future__ import annotations

import argparse
import math
import os
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from gateway.client.connection import BusBoard, add_bus_arguments, open_bus
from gateway.sites.filler import Filler, Tally
from protocol.arguments import argument, interval, number
from protocol.bus import topics
from protocol.bus.identity import find_identity
from protocol.ending import on_end_signal
from protocol.errors import Board51Error, UsageError

_SETTLE = argument(number, lambda seconds: 0.0 <= seconds < math.inf, "is no age; give seconds, 0 or more")
_DAYS = argument(number, lambda days: 0.0 < days < math.inf, "is no number of days; give one above 0")


def configure(parser: argparse.ArgumentParser) -> None:
    """Options of the command."""
    parser.add_argument(
        "folder", type=Path, metavar="FOLDER", help="folder of the recording: the --out of `board51 record`"
    )
    add_bus_arguments(parser)
    parser.add_argument("--board", help="only this board")
    parser.add_argument("--every", type=interval, metavar="S", help="repeat every S seconds")
    parser.add_argument(
        "--settle", type=_SETTLE, default=60.0, metavar="S",
        help="leave out younger records, which may still arrive by themselves (default 60)",
    )  # fmt: skip
    parser.add_argument(
        "--days", type=_DAYS, default=7.0, help="look at parts that were written to in the last DAYS (default 7)"
    )
    parser.epilog = "example:\n  board51 fill recording --connect tcp/127.0.0.1:7447 --every 60"


def run(args: argparse.Namespace) -> int:
    """Fill once, or until SIGTERM or SIGINT."""
    topics.check_name(args.site, what="--site")
    if args.board is not None:
        topics.check_name(args.board, what="--board")
    if not args.folder.is_dir():
        raise UsageError(f"{args.folder} is not a folder", remedy="Give the folder of the recording")
    stop = threading.Event()
    on_end_signal(stop.set)
    with _locked(args.folder), open_bus(args.connect, find_identity(args.identity)) as session:
        filler = Filler(
            BusBoard(session, args.site, "*" if args.board is None else args.board), args.folder,
            settle_s=args.settle, days=args.days, report=_print_line, stop=stop,
        )  # fmt: skip
        if args.every is None:
            tally = filler.fill()
            _print_line(_as_text(tally))
            return 1 if tally.settling else 0
        printed = ""
        while not stop.is_set():
            try:
                text = _as_text(tally) if (tally := filler.fill()).records else ""
            except Board51Error as error:  # the line, a server or the disk: all may come back
                text = "" if stop.is_set() else str(error)
            if text and text != printed:
                _print_line(text)
            printed = text
            stop.wait(args.every)
    return 0


def _as_text(tally: Tally) -> str:
    text = (
        f"{tally.records} record(s) filled in ({tally.bytes / 1e6:.1f} MB),"
        f" {tally.compared} block(s) compared with {tally.servers} log server(s)"
    )
    if tally.refused:
        text += f", {tally.refused} record(s) refused: not what was asked for"
    if tally.settling:
        text += f"; {tally.settling} part(s) also have records younger than --settle: fill again later"
    return text


def _print_line(line: str) -> None:
    print(line, file=sys.stderr, flush=True)


@contextmanager
def _locked(folder: Path) -> Iterator[None]:
    """Let one process at a time fill a folder: two would fill in the same records."""
    try:
        import fcntl
    except ImportError:  # Windows
        yield
        return
    handle = os.open(folder, os.O_RDONLY)
    try:
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            raise UsageError(f"{folder} is being filled by another process", remedy="End that one first") from None
        yield
    finally:
        os.close(handle)
