"""Merge the parts in FOLDER into one log: in order of time, each record once, whatever recorded or filled them in."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from gateway.record.merge import merge


def configure(parser: argparse.ArgumentParser) -> None:
    """Options of the command."""
    parser.add_argument("folder", type=Path, metavar="FOLDER", help="of the parts")
    parser.add_argument("-o", "--out", type=Path, required=True, metavar="FILE", help="the MCAP file to create")
    parser.add_argument("--board", action="append", help="only this board; may be repeated")
    parser.epilog = "example:\n  board51 merge recording -o whole.mcap"


def run(args: argparse.Namespace) -> int:
    """Merge; 1 where a part is damaged or cannot be read."""
    merged = merge(args.folder, args.out, boards=args.board, report=lambda line: print(line, file=sys.stderr))
    for problem in merged.unreadable:
        print(problem, file=sys.stderr)
    print(
        f"{args.out}: {merged.records} records of {merged.parts} parts, {merged.twice} that were there twice left out"
    )
    return 1 if merged.unreadable else 0
