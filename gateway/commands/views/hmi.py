"""Serve the control room for a browser: every rig of the bus, live; commands, alarms, recordings, logs.

It is a client of the bus: if it ends or hangs, gateway and board are not affected.  Without --security or --users
everybody who reaches the page may do what `board51 send` may, so only this machine reaches it.

Programs without zenoh use the HTTP API; /api/v1/ lists its requests.  Prometheus reads /metrics.
"""

from __future__ import annotations

import argparse
import math
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from gateway.access.listeners import is_loopback
from gateway.client.connection import open_bus
from gateway.views.listen import ACCOUNT, add_view_arguments, listener, views_identity
from protocol.bus.endpoint import check_endpoint, zenoh_config
from protocol.errors import UsageError

if TYPE_CHECKING:  # the server takes its time to import: --help answers at once
    from gateway.access.folder import SecurityFolder
    from gateway.access.users import Users


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the arguments: where it listens, who may log in, which folders it shows."""
    parser.epilog = (
        "examples:\n  board51 hmi                      then open http://127.0.0.1:8051\n"
        "  board51 hmi --log-dir logs --reports diagnosis\n"
        "  board51 hmi --security /etc/board51 --listen 0.0.0.0:8051"
    )
    add_view_arguments(
        parser, "hmi", security="https, logins, and the page's identity on the bus",
        insecure="listen beyond loopback without --security",
    )  # fmt: skip
    parser.add_argument("--users", type=Path, metavar="FILE", help="logins without https, on loopback only")
    parser.add_argument(
        "--log-dir", type=Path, default=Path("logs"), metavar="DIR", help="logs of the gateway (default logs)"
    )
    parser.add_argument(
        "--data", type=Path, default=Path("hmi-data"), metavar="DIR",
        help="folder for recordings and campaigns (default hmi-data)",
    )  # fmt: skip
    parser.add_argument(
        "--reports", type=Path, action="append", default=[], metavar="DIR",
        help="a folder below which `board51 diagnose` writes; repeatable (diagnosis, and that of --data)",
    )  # fmt: skip
    for option, unit, default, when in (
        ("--idle-min", "MIN", 30.0, "after this time without an action"),
        ("--session-h", "H", 12.0, "after this time in any case"),
    ):
        text = f"a session ends {when} (default {default:g})"
        parser.add_argument(option, type=float, default=default, metavar=unit, help=text)


def run(args: argparse.Namespace) -> int:
    """Serve until SIGTERM or SIGINT."""
    from gateway.access.folder import SecurityFolder
    from gateway.access.users import Users

    check_endpoint(args.connect, where="--connect")
    for option, value in (("--idle-min", args.idle_min), ("--session-h", args.session_h)):
        if not (math.isfinite(value) and value > 0.0):
            raise UsageError(f"{option} {value} is not a positive number", remedy="Correct it")
    if args.security is not None and args.users is not None:
        raise UsageError("--security has users of its own", remedy="Leave out --users")
    remedy = "Give --security DIR (made by `board51 security init DIR`)"
    host, port = listener(args, "The web page", remedy=remedy)
    folder = SecurityFolder(args.security) if args.security is not None else None
    users_file = folder.users if folder is not None else args.users
    users = Users(users_file) if users_file is not None else None
    if args.users is not None and users is not None and not users.names():
        raise UsageError(
            f"{args.users} has no user, so nobody could log in",
            remedy="Write each user as [users.NAME]; `board51 security add-user` sets role and password",
        )
    return _serve(args, host, port, folder, users)


def _serve(args: argparse.Namespace, host: str, port: int, folder: SecurityFolder | None, users: Users | None) -> int:
    from datetime import UTC, datetime

    import zenoh

    from gateway.access.certificates import check_certificate
    from gateway.access.private import check_private
    from gateway.views.hmi.actions import Routes
    from gateway.views.hmi.app import HmiSettings, listen, serve

    now = datetime.now(UTC)
    certificate = key = None
    if folder is not None:
        certificate, key = folder.server("hmi")
        check_private(key, what="The key of the web page")
        check_certificate(certificate, what="The certificate of the web page", now=now)
    identity = views_identity(args.identity or (str(folder.identity_path(ACCOUNT)) if folder is not None else None))
    listener = listen(host, port)
    with listen("127.0.0.1", 0) as probe:  # a port that nobody has now
        replay = f"tcp/127.0.0.1:{probe.getsockname()[1]}"
    settings = HmiSettings(
        users=users,
        guarded=identity is not None,
        certificate=certificate,
        key=key,
        reports=tuple(args.reports) or (Path("diagnosis"), args.data),
        idle_s=args.idle_min * 60.0,
        lifetime_s=args.session_h * 3600.0,
        loopback=is_loopback(host),
        routes=Routes(
            logs=args.log_dir,
            data=args.data,
            connect=args.connect,
            site=args.site,
            replay=replay,
            identities=folder.path / "identities" if folder is not None else None,
        ),
    )
    # A client, not a router without listeners: the access control of a guarded router tells nobody but the gateway who
    # answers commands, and a router asks only whom it knows of.
    replay_text = zenoh_config("router", listen=[replay])
    with open_bus(args.connect, identity) as bus, zenoh.open(zenoh.Config.from_json5(replay_text)) as replay_bus:
        scheme = "http" if certificate is None else "https"
        print(f"control room of {args.site} on {scheme}://{args.listen}", file=sys.stderr, flush=True)
        serve(settings, listener, bus, replay_bus)
    return 0
