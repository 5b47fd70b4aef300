"""Options and lines of progress that `board51 campaign run` and `board51 investigate` have in common."""

from __future__ import annotations

import argparse
import math
import shlex
import sys
from pathlib import Path

from gateway.client.connection import add_bus_arguments
from protocol.arguments import argument, number

_not_negative = argument(number, lambda value: math.isfinite(value) and value >= 0.0, "is not a number of at least 0")


def add_rig_arguments(parser: argparse.ArgumentParser, *, who: str) -> None:
    """Add the options of the bus, the plant, the signals and the sender, whose name is `who` by default."""
    add_bus_arguments(parser)
    parser.add_argument(
        "--plant",
        type=Path,
        metavar="FILE",
        help="TOML with the [plant] of this rig (default: that of FOLDER, else the rig's plant card, else a CE 152)",
    )
    parser.add_argument("--seed", type=int, default=1, help="seed of the random signals (default 1)")
    for option, unit, what in (
        ("--u-max", "V", "highest u_c"),
        ("--x-min", "MM", "lowest reference"),
        ("--x-max", "MM", "highest reference"),
    ):
        parser.add_argument(option, type=_not_negative, metavar=unit, help=f"{what} (default: the board's limit)")
    parser.add_argument(
        "--issued",
        type=int,
        default=0,
        metavar="NS",
        help="when the campaign was ordered, Unix time; a later STOP ends it",
    )
    parser.add_argument("--who", default=who, help=f"who sends the commands, for the log (default {who})")


def same_command(name: str) -> str:
    """Return the command line of this process, to repeat it; it runs `board51 NAME`, or is a program of another."""
    return "board51 " + shlex.join(sys.argv[1:]) if sys.argv[1:2] == [name] else "the same command"


def write_line(text: str) -> None:
    """Write a line of progress to stderr."""
    print(text, file=sys.stderr, flush=True)  # noqa: T201  # of the commands, whose results go to stdout
