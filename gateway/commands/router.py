"""Run a standalone zenoh router for the bus, if gateway, twin and clients run separately.

The configuration file is zenoh's own, and a plain `zenohd -c FILE` takes the same file.  This process loads no plug-ins
(REST, storage): they need zenohd.
"""

from __future__ import annotations

import argparse
import json
import re
import sys
import threading
from pathlib import Path

import zenoh

from gateway.access.folder import SecurityFolder
from gateway.access.listeners import check_bus_listeners
from protocol.bus.endpoint import DEFAULT_ENDPOINT, check_endpoint
from protocol.ending import on_end_signal, wait_for_end
from protocol.errors import ConfigError, ServiceError
from protocol.files import DEEPEST, read_small

SHIPPED = Path(__file__).parent.parent / "router.json5"


def configure(parser: argparse.ArgumentParser) -> None:
    """Configuration file and endpoints."""
    parser.epilog = (
        "examples:\n  board51 router\n  board51 router --security keys --listen tls/0.0.0.0:7447\n"
        "  zenohd -c gateway/router.json5\n  zenohd -c keys/bus/router.json5"
    )
    source = parser.add_mutually_exclusive_group()
    source.add_argument("--config", type=Path, default=SHIPPED, metavar="FILE", help="zenoh configuration (JSON5)")
    source.add_argument(
        "--security", type=Path, metavar="DIR", help="guard it with the folder that `board51 security init DIR` made"
    )
    parser.add_argument("--insecure", action="store_true", help="listen on the network without protection")
    parser.add_argument(
        "--listen", action="append", metavar="ENDPOINT", help="endpoint, instead of those of the file; repeat for more"
    )
    parser.add_argument("--print-config", action="store_true", help="print the shipped file and exit")


def _reason(error: zenoh.ZError) -> str:
    """Return the reason of an error, without the line of zenoh's source at its end."""
    return str(error).partition(" at /")[0].rstrip(". ")


def _guarded(config: zenoh.Config) -> bool:
    """Return whether a configuration authenticates its clients and denies what is not allowed."""
    access = json.loads(config.get_json("access_control"))
    dictionary = json.loads(config.get_json("transport/auth/usrpwd/dictionary_file"))
    return bool(access["enabled"] and access["default_permission"] == "deny" and dictionary)


def _endpoints(config: zenoh.Config) -> list[str]:
    """Return the endpoints on which it listens; zenoh's default is a port on every interface."""
    endpoints = json.loads(config.get_json("listen/endpoints"))
    if isinstance(endpoints, dict):
        endpoints = endpoints.get("router", [])
    return [str(endpoint) for endpoint in endpoints] or ["tcp/[::]:7447"]


def _check_readable(path: Path) -> None:
    """Check the file before zenoh opens it.

    zenoh would wait for a pipe for ever, and a text of brackets only overflows its stack.
    """
    depth = 0
    for bracket in re.findall(r"[\[{}\]]", read_small(path, remedy="Give a zenoh configuration", error=ConfigError)):
        depth += 1 if bracket in "[{" else -1
        if depth > DEEPEST:
            raise ConfigError(f"{path} is nested too deeply", remedy="Give a zenoh configuration")


def run(args: argparse.Namespace) -> int:
    """Route until SIGTERM or SIGINT."""
    if args.print_config:
        print(SHIPPED.read_text(encoding="utf-8"), end="")
        return 0
    try:
        if args.security is not None:
            folder = SecurityFolder(args.security)
            folder.check()
            config = zenoh.Config.from_json5(folder.router([DEFAULT_ENDPOINT]))
        else:
            _check_readable(args.config)
            config = zenoh.Config.from_file(args.config)
        if config.get_json("mode") != '"router"':
            raise ConfigError(f"{args.config}: mode is {config.get_json('mode')}", remedy='Set mode: "router"')
        if args.listen:
            endpoints = [check_endpoint(endpoint, where="--listen") for endpoint in args.listen]
            config.insert_json5("listen/endpoints", json.dumps(endpoints))
    except zenoh.ZError as error:
        problem = f"{args.config} is not a zenoh configuration: {_reason(error)}"
        raise ConfigError(problem, remedy="Correct the file") from None
    check_bus_listeners(_endpoints(config), guarded=_guarded(config), insecure=args.insecure)
    stop = threading.Event()
    on_end_signal(stop.set)
    listen = config.get_json("listen/endpoints")
    try:
        session = zenoh.open(config)
    except zenoh.ZError as error:
        problem = f"Cannot listen on {listen}: {_reason(error)}"
        raise ServiceError(problem, remedy="Free the port or choose another --listen") from None
    with session:
        print(f"router {session.info.zid()} listens on {listen}", flush=True)
        wait_for_end(stop.wait)
    print("router stopped", file=sys.stderr)
    return 0
