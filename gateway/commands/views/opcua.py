"""Serve the rigs over OPC UA, for SCADA systems: reads, subscriptions, history, alarms; setpoints and methods.

It joins the bus like any other client: nothing that an OPC UA client does can hold up the gateway.  Without --security
it serves this machine only, and everybody on it may command; with it, sessions are encrypted and people have roles.
"""

from __future__ import annotations

import argparse
import asyncio
import logging
from pathlib import Path
from typing import TYPE_CHECKING

from gateway.client.connection import open_bus
from gateway.views.listen import add_view_arguments, listener, views_identity
from protocol.bus.identity import Identity
from protocol.ending import on_end_signal
from protocol.errors import UsageError

if TYPE_CHECKING:  # asyncua and pydantic take a second to import: --help answers at once
    from gateway.views.opcua.server import OpcuaSettings


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the arguments: address, rate, users."""
    parser.epilog = (
        "examples:\n  board51 opcua                                   opc.tcp://127.0.0.1:4840/board51/\n"
        "  board51 opcua --security /etc/board51 --listen 0.0.0.0:4840 --rate 50\n"
        "  board51 opcua --export-nodeset board51.NodeSet2.xml     RigType and its parts, for engineering tools"
    )
    add_view_arguments(
        parser, "opcua", security="encryption, logins, roles", insecure="serve other machines without --security"
    )
    parser.add_argument(
        "--rate", type=float, metavar="HZ", help="10 to 50 values per second, each with min and max (20)"
    )
    parser.add_argument("--history", type=float, metavar="S", help="length of the history, 10 to 3600 s (300)")
    parser.add_argument(
        "--anonymous",
        choices=("off", "viewer", "operator", "engineer"),
        help="role of a client without a name (default: off with --security; viewer if other machines reach the "
        "server or the bus has roles; else engineer)",
    )
    parser.add_argument(
        "--export-nodeset", metavar="FILE", type=Path, help="write the types as a NodeSet2 file and end"
    )


def run(args: argparse.Namespace) -> int:
    """Serve until SIGTERM or SIGINT."""
    if args.export_nodeset is not None:
        from gateway.views.opcua.types import nodeset

        args.export_nodeset.write_text(nodeset(), encoding="utf-8")
        return 0
    from gateway.access.listeners import is_loopback
    from gateway.access.roles import Role
    from gateway.config import OpcuaConfig, changed
    from gateway.views.opcua.security import Security
    from gateway.views.opcua.server import OpcuaSettings

    host, port = listener(args, "OPC UA", remedy="Give --security DIR, made by `board51 security init DIR`")
    served = OpcuaConfig()
    if args.rate is not None:
        served = changed(served, "--rate", rate_hz=args.rate)
    if args.history is not None:
        served = changed(served, "--history", history_s=args.history)
    identity = views_identity(args.identity)
    word = args.anonymous or anonymous(host, secured=args.security is not None, guarded=identity is not None)
    if word in ("operator", "engineer") and not is_loopback(host):
        problem = f"--anonymous {word} would let everybody in the network command"
        raise UsageError(problem, remedy="Listen on 127.0.0.1, or give people names with `board51 security add-user`")
    settings = OpcuaSettings(
        host=host, port=port, rate_hz=served.rate_hz, history_s=served.history_s,
        anonymous=None if word == "off" else Role[word.upper()],
        security=Security(args.security) if args.security is not None else None,
    )  # fmt: skip
    logging.getLogger("asyncua").setLevel(logging.CRITICAL)  # it writes a line or a traceback per bad request
    return asyncio.run(_serve(args, settings, identity))


def anonymous(host: str, *, secured: bool, guarded: bool) -> str:
    """Return the role of a client without a name: as on the bus, where everybody who reaches it may command."""
    from gateway.access.listeners import is_loopback

    if secured:
        return "off"
    return "engineer" if is_loopback(host) and not guarded else "viewer"


async def _serve(args: argparse.Namespace, settings: OpcuaSettings, identity: Identity | None) -> int:
    from gateway.views.feed import Feed
    from gateway.views.opcua.server import serve

    stop, loop = asyncio.Event(), asyncio.get_running_loop()
    on_end_signal(lambda: loop.call_soon_threadsafe(stop.set))
    with open_bus(args.connect, identity) as session:
        feed = Feed(session, args.site, guarded=identity is not None)
        host = settings.host if settings.host not in ("0.0.0.0", "::") else "HOST"
        await serve(feed, settings, stop, lambda port: print(f"OPC UA on opc.tcp://{host}:{port}/board51/", flush=True))
        feed.close()
    return 0
