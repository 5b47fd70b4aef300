"""Convert a topic of a log to CSV, MATLAB or Parquet, for MATLAB and pandas; one file per board.

Columns are the fields of the message with their units (protocol/README.md), t_s first.  An existing file is never
overwritten; a damaged log is refused (board51 recover first).
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

from gateway.record.tables.export import Format, export
from protocol.bus import topics
from protocol.errors import UsageError

_SUFFIXES: dict[str, Format] = {".csv": "csv", ".mat": "mat", ".parquet": "parquet"}


def configure(parser: argparse.ArgumentParser) -> None:
    """Options of the command."""
    names = [topic.name for topic in topics.TOPICS if topic.logged]
    parser.add_argument("logs", type=Path, nargs="+", metavar="LOG", help="an MCAP file, or the parts of one log")
    parser.add_argument("-o", "--out", type=Path, required=True, help="file to create")
    parser.add_argument("--format", choices=sorted(_SUFFIXES.values()), help="default: by the file's suffix")
    parser.add_argument("--topic", choices=names, default="state", metavar="TOPIC", help=f"one of {', '.join(names)}")
    parser.add_argument("--board", action="append", help="only this board; repeatable")
    parser.add_argument("--start", type=float, default=0.0, metavar="S", help="from the first message of the log")
    parser.add_argument("--end", type=float, metavar="S", help="the same")
    parser.add_argument("--json", action="store_true", help="print files and rows as JSON")
    parser.epilog = (
        "examples:\n"
        "  board51 export run.mcap -o run.csv\n"
        "  board51 export run-*.mcap -o twin.parquet --topic twin/divergence --start 10 --end 20"
    )


def run(args: argparse.Namespace) -> int:
    """Export."""
    form = args.format or _SUFFIXES.get(args.out.suffix)
    if form is None:
        problem = f"-o {args.out}: its suffix names no format"
        raise UsageError(problem, remedy="Use .csv, .mat or .parquet, or give --format")
    files = export(
        args.logs, args.out, form=form, topic=args.topic, boards=args.board, start_s=args.start, end_s=args.end
    )
    if args.json:
        print(json.dumps([{"file": str(path), "rows": rows} for path, rows in files], indent=2))
    else:
        print("\n".join(f"{path}: {rows} rows of {args.topic}" for path, rows in files))
    return 0
