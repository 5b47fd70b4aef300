"""Serve a folder of logs on the bus, so that `board51 fill` at another site gets what its recording has missed.

It runs beside the gateway, on the folder that the gateway writes, and only reads: also the part that is being written.
"""

from __future__ import annotations

import argparse
import os
import sys
import threading
from contextlib import suppress
from pathlib import Path

from gateway.client.connection import add_bus_arguments, open_bus
from gateway.sites.server import LogServer
from protocol.bus import topics
from protocol.bus.identity import find_identity
from protocol.ending import on_end_signal
from protocol.errors import UsageError

_NICE = 5  # a gateway on the same machine comes first


def configure(parser: argparse.ArgumentParser) -> None:
    """Options of the command."""
    parser.add_argument("folder", type=Path, metavar="FOLDER", help="folder of the gateway's log: its --log-dir")
    add_bus_arguments(parser)
    parser.epilog = "example:\n  board51 serve-log logs --connect tcp/127.0.0.1:7447"


def run(args: argparse.Namespace) -> int:
    """Serve until SIGTERM or SIGINT."""
    topics.check_name(args.site, what="--site")
    if not args.folder.is_dir():
        raise UsageError(f"{args.folder} is not a folder", remedy="Give the folder of the gateway's log")
    with suppress(AttributeError, OSError):  # Windows has no such priority
        os.nice(_NICE)
    stop = threading.Event()
    on_end_signal(stop.set)
    with open_bus(args.connect, find_identity(args.identity)) as session:
        print(f"serving {args.folder} as {args.site}/{topics.LOGS}/{session.info.zid()}", file=sys.stderr, flush=True)
        LogServer(args.folder, args.site).serve(session, stop)
    return 0
