"""Log the bus to MCAP without a gateway, until SIGTERM or Ctrl-C: `<site>/**`, all boards, all logged topics.

The raw bytes of the UART do not travel on the bus: only the gateway's own log has them.
"""

from __future__ import annotations

import argparse
import json
import logging
import sys
import threading
from dataclasses import asdict
from pathlib import Path

from gateway.client.connection import BusBoard, add_bus_arguments, open_bus
from gateway.client.recording import Recording
from protocol.bus import topics
from protocol.bus.identity import find_identity
from protocol.ending import note_end, on_end_signal, wait_for_end
from protocol.errors import UsageError
from protocol.files import make_folder


def configure(parser: argparse.ArgumentParser) -> None:
    """Options of the command."""
    add_bus_arguments(parser)
    parser.add_argument(
        "-o", "--out", type=Path, required=True, metavar="DIR", help="directory for the parts; made if absent"
    )
    parser.add_argument("--prefix", default="bus", help="first part of the file names (default bus)")
    parser.add_argument("--board", default="*", help="only this board")
    parser.add_argument("--rotate-mb", type=float, default=500.0, help="close a part of this size (default 500)")
    parser.add_argument("--rotate-s", type=float, default=3600.0, help="close a part after this time (default 3600)")
    parser.add_argument("--seconds", type=float, help="stop after this time")
    parser.add_argument("--json", action="store_true", help="print the summary as JSON")
    parser.epilog = "example:\n  board51 record -o logs --connect tcp/127.0.0.1:7447"


def run(args: argparse.Namespace) -> int:
    """Record until told to stop; 1 where nothing came or something was lost."""
    if args.rotate_mb <= 0 or args.rotate_s <= 0 or (args.seconds is not None and args.seconds <= 0):
        raise UsageError("--rotate-mb, --rotate-s and --seconds are positive", remedy="Correct them")
    topics.check_name(args.prefix, what="--prefix")
    topics.check_name(args.site, what="--site")
    if args.board != "*":
        topics.check_name(args.board, what="--board")
    make_folder(args.out)
    stop = threading.Event()
    on_end_signal(stop.set)
    logging.basicConfig(level=logging.INFO, format="%(message)s")  # the events of the log
    with open_bus(args.connect, find_identity(args.identity)) as session:
        recording = Recording(
            BusBoard(session, args.site, args.board), args.out, connect=args.connect, prefix=args.prefix,
            rotate_bytes=round(args.rotate_mb * 1e6), rotate_s=args.rotate_s,
        )  # fmt: skip
        with recording.start():
            part = args.out / recording.stats.file
            print(f"recording {args.site}/{args.board}/** into {part}", file=sys.stderr, flush=True)
            wait_for_end(stop.wait, args.seconds)
        note_end()
    stats = recording.stats
    if args.json:
        print(json.dumps(asdict(stats)))
    else:
        print(f"{stats.written} messages in {stats.parts} part(s), {stats.dropped} dropped")
    return 0 if stats.written and not stats.dropped else 1
