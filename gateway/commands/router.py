"""A standalone zenoh router for the bus, where gateway, twin and clients run apart.

The configuration file is zenoh's own: a stock `zenohd -c FILE` takes the same one.  Plug-ins (REST, storage)
need zenohd: this process loads none.
"""

from __future__ import annotations

import argparse
import signal
import sys
import threading
from pathlib import Path

import zenoh

from protocol.bus.endpoint import check_endpoint
from protocol.errors import ConfigError, ServiceError

SHIPPED = Path(__file__).parent.parent / "router.json5"


def configure(parser: argparse.ArgumentParser) -> None:
    """Configuration file and endpoints."""
    parser.epilog = (
        "examples:\n  board51 router\n  board51 router --listen tcp/0.0.0.0:7447\n  zenohd -c gateway/router.json5"
    )
    parser.add_argument("--config", type=Path, default=SHIPPED, metavar="FILE", help="zenoh configuration (JSON5)")
    parser.add_argument("--listen", action="append", metavar="ENDPOINT", help="instead of the file's; repeat for more")
    parser.add_argument("--print-config", action="store_true", help="print the shipped file and exit")


def _reason(error: zenoh.ZError) -> str:
    """What went wrong, without the place in zenoh's source that it ends with."""
    return str(error).partition(" at /")[0].rstrip(". ")


def run(args: argparse.Namespace) -> int:
    """Route until SIGTERM or SIGINT."""
    if args.print_config:
        print(SHIPPED.read_text(encoding="utf-8"), end="")
        return 0
    try:
        config = zenoh.Config.from_file(args.config)
        if config.get_json("mode") != '"router"':
            raise ConfigError(f"{args.config}: mode is {config.get_json('mode')}", remedy='Set mode: "router"')
        if args.listen:
            endpoints = [check_endpoint(endpoint, where="--listen") for endpoint in args.listen]
            config.insert_json5("listen/endpoints", str(endpoints))
    except zenoh.ZError as error:
        raise ConfigError(
            f"{args.config} is no zenoh configuration: {_reason(error)}", remedy="Correct the file"
        ) from None
    stop = threading.Event()
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda *_: stop.set())
    listen = config.get_json("listen/endpoints")
    try:
        session = zenoh.open(config)
    except zenoh.ZError as error:
        raise ServiceError(
            f"Cannot listen on {listen}: {_reason(error)}",
            remedy="Free the port or choose another --listen",
        ) from None
    with session:
        print(f"router {session.info.zid()} listens on {listen}", flush=True)
        stop.wait()
    print("router stopped", file=sys.stderr)
    return 0
