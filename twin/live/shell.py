"""`board51 diagnose --live`: options, the campaign that they ask for, and the hand-over afterwards.

Rule: this file and `source.py` have the clock and the bus; cutting and writing are elsewhere.
"""

from __future__ import annotations

import argparse
import math
import os
from collections.abc import Callable
from pathlib import Path

from protocol.bus.endpoint import DEFAULT_ENDPOINT, check_endpoint
from protocol.bus.identity import HELP, find_identity
from protocol.bus.topics import DEFAULT_SITE, check_name
from protocol.errors import UsageError

LONGEST_MIN = 60.0  # 500 Hz of it are 2 million samples
_NICE = 5  # the gateway and the twin of a rig in flight go first
_LIVE_OPTIONS = ("board", "connect", "plant", "hand_over")


def configure_live(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    live = parser.add_argument_group("live data, in place of CAMPAIGN")
    live.add_argument(
        "--live", type=float, metavar="MINUTES", help="the newest minutes of a board, from the gateway's log or the bus"
    )
    live.add_argument("--board", help="name of the board (default: the only one)")
    live.add_argument("--site", default=DEFAULT_SITE, help="first chunk of the keys (%(default)s)")
    live.add_argument(
        "--connect", action="append", metavar="ENDPOINT", help=f"where the gateway listens (default {DEFAULT_ENDPOINT})"
    )
    live.add_argument("--identity", metavar="FOLDER", help=HELP)
    live.add_argument("--logs", type=Path, default=Path("logs"), metavar="DIR", help="the gateway's log folder (logs)")
    live.add_argument(
        "--plant",
        type=Path,
        metavar="FILE",
        help="file with a [plant] (default: the rig's plant card, else that of the live twin)",
    )
    live.add_argument("--hand-over", action="store_true", help="give the extended model to the running twin")


def check_options(args: argparse.Namespace) -> None:
    """Check that there is either a campaign or --live, with its options.  Raises UsageError."""
    if args.live is None:
        if args.campaign is None:
            raise UsageError("there is nothing to diagnose", remedy="Name a CAMPAIGN, or give --live MINUTES")
        for name in _LIVE_OPTIONS:
            if getattr(args, name):
                raise UsageError(f"--{name.replace('_', '-')} is for live data", remedy="Add --live MINUTES")
        return
    if args.campaign is not None:
        raise UsageError("CAMPAIGN and --live exclude each other", remedy="Leave one of them out")
    if not (math.isfinite(args.live) and 0.1 <= args.live <= LONGEST_MIN):
        raise UsageError(f"--live {args.live:g} is outside 0.1 .. {LONGEST_MIN:g} minutes", remedy="Try --live 2")
    if args.out is None:
        raise UsageError("--live writes recordings and needs a folder", remedy="Give --out DIR")
    check_name(args.site, what="--site")
    if args.board:
        check_name(args.board, what="--board")
    endpoints_of(args)


def endpoints_of(args: argparse.Namespace) -> tuple[str, ...]:
    """Return the endpoints of the router.  Raises ConfigError."""
    return tuple(check_endpoint(endpoint, where="--connect") for endpoint in args.connect or [DEFAULT_ENDPOINT])


def record_live(args: argparse.Namespace, progress: Callable[[str], None]) -> tuple[Path, str]:
    """Make the campaign; its folder, and the board's name.

    Raises:
        Board51Error: no gateway, no samples, too little flight, a folder that cannot be written.
    """
    from protocol.campaign import load_plant
    from twin.live.folder import changes_of, plant_of, write
    from twin.live.pieces import cut, moves
    from twin.live.source import find_board, from_bus, from_log
    from twin.mirror.bus.client import open_client

    if hasattr(os, "nice"):  # Windows has none
        os.nice(_NICE)
    plant = load_plant(args.plant) if args.plant else None
    span_s = 60.0 * args.live
    with open_client(endpoints_of(args), find_identity(args.identity)) as session:
        board, status = find_board(session, args.site, args.board)
        live = from_log(status, args.logs, args.site, board, span_s)
        if live is None:
            live = from_bus(session, args.site, board, span_s, progress)
    pieces = cut(list(live.states), live.captures, changes_of(live.parameters))
    folder = write(live, pieces, plant or plant_of(live), args.out, site=args.site, board=board)
    listed = ", ".join(f"{piece.name} {piece.duration_s:.0f} s" for piece in pieces)
    progress(f"{args.site}/{board}, from {live.where}: {listed}")
    if not moves(pieces):
        progress("! the reference hardly moves: force and drag come from noise alone; fly steps of the reference")
    progress(f"recordings in {folder}")
    return folder, board


def give_to_twin(args: argparse.Namespace, model: Path, board: str, progress: Callable[[str], None]) -> bool:
    """Hand the model over and tell what the twin makes of it; False where it was refused."""
    from twin.live.surprise import hand_over_and_compare
    from twin.mirror.bus.client import open_client
    from twin.mirror.bus.handover import believe
    from twin.model.parameters import Model

    endpoints = endpoints_of(args)
    belief = believe(Model.load(model), who="diagnose")
    identity = find_identity(args.identity)
    with open_client(endpoints, identity) as session:
        accepted, lines = hand_over_and_compare(
            session, belief, site=args.site, board=board, endpoints=endpoints, identity=identity
        )
    for line in lines:
        progress(line)
    return accepted
