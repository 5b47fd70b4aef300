"""Show the content of a log: boards, duration, counts and rates, gaps, ranges, sessions, metadata.  Damaged logs too.

Exit code 1: the log is damaged (board51 recover saves the rest).
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

from gateway.record.summary import as_json, as_text, summarise
from gateway.record.timeline import timeline
from protocol.errors import UsageError


def configure(parser: argparse.ArgumentParser) -> None:
    """Options of the command."""
    parser.add_argument("logs", type=Path, nargs="+", metavar="LOG", help="an MCAP file, or the parts of one log")
    parser.add_argument("--marks", action="store_true", help="only the times of events and alarms, of one LOG, as JSON")
    parser.add_argument("--json", action="store_true", help="print it as JSON")
    parser.epilog = "example:\n  board51 info logs/board51-20260101T120000Z-*.mcap"


def run(args: argparse.Namespace) -> int:
    """Print the summary, or the marks."""
    if args.marks:
        if len(args.logs) > 1:
            raise UsageError("--marks takes one LOG", remedy="Ask for each part by itself")
        print(json.dumps(timeline(args.logs[0])))
        return 0
    summary = summarise(args.logs)
    print(json.dumps(as_json(summary), indent=2) if args.json else as_text(summary))
    return 1 if summary.damages else 0
