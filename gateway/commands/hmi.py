"""The control room in a browser: every rig of the bus, live; commands, alarms, recordings, logs.

It is a client of the bus: it ends, hangs or dies without touching gateway or board.  Without --users everybody who
reaches the page may do what `board51 send` may: that is for this machine alone.
"""

from __future__ import annotations

import argparse
import ipaddress
import math
import sys
from pathlib import Path

from gateway.client import add_bus_arguments
from protocol.bus.endpoint import check_endpoint
from protocol.bus.topics import check_name
from protocol.errors import ConfigError, UsageError

DEFAULT_LISTEN = "127.0.0.1:8051"


def configure(parser: argparse.ArgumentParser) -> None:
    """Where it listens, who may log in, which folders it shows."""
    parser.epilog = (
        "examples:\n  board51 hmi                      then open http://127.0.0.1:8051\n"
        "  board51 hmi --log-dir logs --reports diagnosis\n"
        "  board51 hmi --listen 0.0.0.0:8051 --users security/users.toml --cert security/hmi.crt --key security/hmi.key"
    )
    add_bus_arguments(parser)
    parser.add_argument(
        "--listen", default=DEFAULT_LISTEN, metavar="HOST:PORT", help=f"of the page (default {DEFAULT_LISTEN})"
    )
    parser.add_argument("--users", type=Path, metavar="FILE", help="users.toml; without it nobody logs in")
    parser.add_argument("--cert", type=Path, metavar="FILE", help="certificate for https (PEM)")
    parser.add_argument("--key", type=Path, metavar="FILE", help="its key, readable by its owner alone")
    parser.add_argument("--insecure", action="store_true", help="listen beyond loopback without users or https")
    parser.add_argument(
        "--log-dir", type=Path, default=Path("logs"), metavar="DIR", help="of the gateway (default logs)"
    )
    parser.add_argument(
        "--data",
        type=Path,
        default=Path("hmi-data"),
        metavar="DIR",
        help="for recordings and campaigns (default hmi-data)",
    )
    parser.add_argument(
        "--reports", type=Path, action="append", default=[], metavar="DIR",
        help="a folder below which `board51 diagnose` writes; repeatable (default diagnosis, and that of --data)",
    )  # fmt: skip
    parser.add_argument(
        "--idle-min", type=float, default=30.0, metavar="MIN", help="a session ends without an act (30)"
    )
    parser.add_argument("--session-h", type=float, default=12.0, metavar="H", help="and after this time anyway (12)")


def run(args: argparse.Namespace) -> int:
    """Serve until SIGTERM or SIGINT."""
    host, port = address(args.listen)
    check_name(args.site, what="--site")
    check_endpoint(args.connect, where="--connect")
    for option, value in (("--idle-min", args.idle_min), ("--session-h", args.session_h)):
        if not (math.isfinite(value) and value > 0.0):
            raise UsageError(f"{option} {value} is not a positive number", remedy="Correct it")
    if (args.cert is None) != (args.key is None):
        raise UsageError("--cert and --key belong together", remedy="Give both, or neither")
    loopback = is_loopback(host)

    from gateway.access.private import check_private
    from gateway.access.users import Users

    users = Users.load(args.users) if args.users is not None else None
    if args.key is not None:
        check_private(args.key, what="The key")
    if not loopback and not args.insecure and (users is None or args.cert is None):
        raise ConfigError(
            f"--listen {args.listen} is open to the network without {'users' if users is None else 'https'}",
            remedy="Give --users, --cert and --key (`board51 security init` makes them), or --insecure",
        )
    return _serve(args, host, port, loopback=loopback, users=users)


def _serve(args: argparse.Namespace, host: str, port: int, *, loopback: bool, users: object) -> int:
    import zenoh

    from gateway.access.users import Users
    from gateway.views.hmi.app import HmiSettings, serve
    from protocol.bus.endpoint import zenoh_config

    assert users is None or isinstance(users, Users)
    settings = HmiSettings(
        host=host,
        port=port,
        site=args.site,
        users=users,
        guarded=False,
        certificate=args.cert,
        key=args.key,
        logs=args.log_dir,
        data=args.data,
        reports=tuple(args.reports) or (Path("diagnosis"), args.data),
        idle_s=args.idle_min * 60.0,
        lifetime_s=args.session_h * 3600.0,
        loopback=loopback,
        bus_words=("--connect", args.connect),
    )
    text = zenoh_config("client", connect=[args.connect], wait_for_router=False)
    with zenoh.open(zenoh.Config.from_json5(text)) as bus:
        scheme = "https" if args.cert is not None else "http"
        print(f"control room of {args.site} on {scheme}://{args.listen}", file=sys.stderr, flush=True)
        serve(settings, bus)
    return 0


def address(text: str) -> tuple[str, int]:
    """HOST:PORT in its parts.

    Raises:
        UsageError: it is not one.
    """
    host, _, port = text.rpartition(":")
    if not host or not port.isdecimal() or not 0 < int(port) < 65536:
        raise UsageError(f"--listen {text} is not an address", remedy=f"Write HOST:PORT, e.g. {DEFAULT_LISTEN}")
    return host.strip("[]"), int(port)


def is_loopback(host: str) -> bool:
    """Whether only this machine can reach it."""
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"
