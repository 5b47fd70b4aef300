"""Show the rigs live in Foxglove: a WebSocket server with the topics and schemas of the logs, and ready-made layouts.

In Foxglove: Open connection, Foxglove WebSocket, ws://localhost:8765; then Layouts, Import from file.  The same layout
opens the MCAP logs.  The Log panel shows events, alarms and refused commands, the 3D panel the rig.  LOG -o makes
a copy of a log for these two panels.  Foxglove cannot send commands.
"""

from __future__ import annotations

import argparse
import threading
from importlib.resources import files
from pathlib import Path

from gateway.client.connection import open_bus
from gateway.views.listen import add_view_arguments, listener
from protocol.bus import topics
from protocol.ending import on_end_signal
from protocol.errors import UsageError

LAYOUTS = {"foxglove": "foxglove.json", "plotjuggler": "plotjuggler.xml"}


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the arguments: address, layouts and logs."""
    parser.epilog = (
        "examples:\n  board51 foxglove                                        ws://127.0.0.1:8765\n"
        "  board51 foxglove --print-layout > board51.json          for rig1; --board NAME for another\n"
        "  board51 foxglove --print-layout plotjuggler > board51.xml\n"
        "  board51 foxglove logs/*.mcap -o shown.mcap              a log with the topics of the Log and 3D panels"
    )
    parser.add_argument("logs", type=Path, nargs="*", metavar="LOG", help="an MCAP file, or the parts of one log")
    parser.add_argument("-o", "--out", type=Path, metavar="OUT", help="MCAP file to create of LOG")
    add_view_arguments(parser, "foxglove", insecure="serve other machines: there is no login")
    parser.add_argument(
        "--print-layout", nargs="?", const="foxglove", choices=tuple(LAYOUTS), help="print a layout and end"
    )
    parser.add_argument("--board", default="rig1", help="the board of the layout (rig1)")


def layout(kind: str, site: str, board: str) -> str:
    """The shipped layout for one board."""
    text = (files("gateway.views") / "layouts" / LAYOUTS[kind]).read_text(encoding="utf-8")
    # The keys, and the frame of the 3D panel.
    return text.replace("board51/rig1/", f"{site}/{board}/").replace('"rig1"', f'"{board}"')


def run(args: argparse.Namespace) -> int:
    """Serve until SIGTERM or SIGINT."""
    topics.check_name(args.site, what="--site")
    topics.check_name(args.board, what="--board")
    if args.print_layout:
        print(layout(args.print_layout, args.site, args.board), end="")
        return 0
    if (args.out is None) != (not args.logs):
        raise UsageError("LOG and -o go together", remedy="Give both, or neither to serve the rigs live")
    if args.out is not None:
        from gateway.views.foxglove.panel_log import write_with_panels

        print(f"{args.out}: the log and {write_with_panels(args.logs, args.out)} messages for the Log and 3D panels")
        return 0
    from gateway.views.foxglove.server import serve
    from protocol.bus.identity import find_identity

    remedy = "It has no login: reach it through an ssh tunnel (ssh -L 8765:127.0.0.1:8765 HOST)"
    host, port = listener(args, "Foxglove", remedy=remedy)
    stop = threading.Event()
    on_end_signal(stop.set)
    with open_bus(args.connect, find_identity(args.identity)) as session:
        serve(session, args.site, host, port, stop, lambda bound: print(f"Foxglove on ws://{host}:{bound}", flush=True))
    return 0
