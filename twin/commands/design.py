"""Design a controller for the board from a model: LQI or PID gains, with an analysis of the loop.

Takes a model.json of `identify`, or the name of a shipped model (ce152, inteco, magnetoshield).  Without weights it
chooses them by Bryson's rule.  Prints gains, poles and margins of the loop that the board will run, and the effect of
the speed estimate and of the converters.  Says whether the loop is stable over the model's uncertainty.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from protocol.arguments import quantity
from protocol.bus.endpoint import DEFAULT_ENDPOINT
from protocol.bus.identity import HELP, find_identity
from protocol.bus.topics import DEFAULT_SITE
from protocol.errors import UsageError
from twin.commands import add_show, show_text


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    parser.epilog = (
        "examples:\n"
        "  board51 design model.json --out controller.json\n"
        "  board51 design ce152 --operating-point 2e-3 --settling-time 0.1\n"
        "  board51 design model.json --Q 17 3e6 7e3 1.3e9 --R 1.5 --observer\n"
        "  board51 design model.json --send rig1\n"
        "\nexit code 0: done; 1: the board's loop is unstable on the model itself, nothing is written or sent,\n"
        "or the board did not accept the gains; 2: bad input"
    )
    parser.add_argument("model", metavar="MODEL", help="model.json, or a shipped model: ce152, inteco, magnetoshield")
    parser.add_argument(
        "--operating-point",
        type=quantity("x"),
        metavar="X_M",
        help="position in m, up from the bottom stop (mid-travel)",
    )
    parser.add_argument("--law", choices=("lqi", "pid"), default="lqi", help="law on the board (%(default)s)")
    parser.add_argument(
        "--Q",
        type=float,
        nargs=4,
        metavar=("I", "X", "V", "S"),
        help="weights of i_c 1/A^2, x 1/m^2, speed s^2/m^2, integral of the error 1/(m s)^2 (Bryson's rule)",
    )
    parser.add_argument("--R", type=float, metavar="U", help="weight of u_c, 1/V^2 (Bryson's rule)")
    parser.add_argument(
        "--settling-time",
        type=float,
        metavar="S",
        help="for Bryson's rule: how long an error may last (four time constants of the falling ball)",
    )
    parser.add_argument("--sample-time", type=quantity("t"), default=2e-3, metavar="S", help="T_s (%(default)s)")
    parser.add_argument(
        "--observer", action="store_true", help="compare with a Kalman filter (the board cannot run it)"
    )
    parser.add_argument(
        "--u-max", type=quantity("u_c"), default=5.0, metavar="V", help="end of the input's range (%(default)s)"
    )
    parser.add_argument("--i-lsb", type=quantity("i_c"), metavar="A", help="one count of i_c (2 A / 4096)")
    parser.add_argument("--x-lsb", type=quantity("x"), metavar="M", help="one count of x (5 V / 4096 / 855 V/m)")
    parser.add_argument("--u-lsb", type=quantity("u_c"), metavar="V", help="one count of u_c (5 V / 4096)")
    parser.add_argument(
        "--seed", type=int, default=1, help="seed of the parameters drawn from their intervals (%(default)s)"
    )
    parser.add_argument(
        "--before",
        type=Path,
        metavar="CONTROLLER.json",
        help="gains to be replaced; their margins are shown beside those of the new gains",
    )
    parser.add_argument("--out", type=Path, metavar="CONTROLLER.json", help="write law, gains and operating point")
    parser.add_argument("--analysis", type=Path, metavar="FILE.json", help="write the output of --json to a file")
    parser.add_argument("--json", action="store_true", help="print everything as JSON")
    add_show(parser)
    _add_board_options(parser)


def _add_board_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of the board that receives the gains."""
    parser.add_argument("--send", metavar="BOARD", help="load gains and operating point into this board")
    parser.add_argument("--site", default=DEFAULT_SITE, help="first chunk of the keys (default %(default)s)")
    parser.add_argument(
        "--connect",
        default=DEFAULT_ENDPOINT,
        metavar="ENDPOINT",
        help="where its gateway listens (default %(default)s)",
    )
    parser.add_argument("--identity", metavar="FOLDER", help=HELP)


def run(args: argparse.Namespace) -> int:
    """Design, print, write."""
    # Imported here: --help must not wait for numba and scipy.
    from twin.api.functions import design
    from twin.api.results import as_text, write_text
    from twin.control_design.board import Converters

    if args.observer and args.send is not None:
        raise UsageError(
            "--observer with --send", remedy="The board cannot run an observer: leave out the one or other"
        )
    lsb = {"i_lsb_a": args.i_lsb, "x_lsb_m": args.x_lsb, "u_lsb_v": args.u_lsb}
    result = design(
        args.model,
        x_m=args.operating_point,
        law=args.law,
        sample_time_s=args.sample_time,
        Q=None if args.Q is None else tuple(args.Q),
        R=args.R,
        settling_time_s=args.settling_time,
        converters=Converters(**{name: value for name, value in lsb.items() if value is not None}),
        u_max_v=args.u_max,
        with_observer=args.observer,
        seed=args.seed,
        before=args.before,
    )
    print(as_text(result.report()) if args.json else result.table())
    if args.json:
        for warning in result.warnings:
            print(f"! {warning}", file=sys.stderr)
    if args.show:
        page = (args.out or Path("design")).with_suffix(".html")
        show_text(page, f"Controller from {Path(args.model).name}", result.table())
    if not result.stable:
        return 1
    if args.analysis is not None:
        write_text(args.analysis, as_text(result.report()) + "\n")
    if args.out is not None:
        write_text(args.out, as_text(result.to_json()) + "\n")
    if args.send is not None:
        from twin.control_design.send import send

        identity = find_identity(args.identity)
        reply = send(result.details, site=args.site, board=args.send, endpoint=args.connect, identity=identity)
        print(reply, file=sys.stderr)
    return 0
