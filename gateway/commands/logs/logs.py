"""Questions about many logs at once: which flights of which rig, when, on which model, with what result.

The catalogue (catalogue.sqlite, beside the logs) has a row for each session of a board in a log.  It is brought up to
date first: only logs that are new or have changed are read.

CONDITION is a condition in SQL over the columns; without one all rows are shown.
"""

from __future__ import annotations

import argparse
import csv
import json
import sys
from pathlib import Path
from typing import Any

from gateway.record.catalogue.store import COLUMNS, Answer, Update, query, selection, update
from protocol.errors import UsageError

SHOWN = ("began", "board", "session", "duration_s", "flown_s", "missing", "model", "causes", "alarms", "nis", "file")


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the sub-command."""
    parser.epilog = f"columns: {', '.join(COLUMNS)}\n{_EXAMPLES}"
    work = parser.add_subparsers(dest="work", required=True, metavar="WORK")
    asked = work.add_parser(
        "query",
        help="the sessions that satisfy a condition",
        description=__doc__,
        epilog=parser.epilog,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    asked.add_argument("condition", nargs="?", default="", metavar="CONDITION", help="in SQL; default: all")
    asked.add_argument("--folder", type=Path, default=Path("logs"), help="of the logs, with its sub-folders (logs)")
    asked.add_argument("--sql", metavar="SELECT", help="a whole SELECT over the table logs instead of a CONDITION")
    asked.add_argument("--no-update", action="store_true", help="ask the catalogue as it is")
    form = asked.add_mutually_exclusive_group()
    form.add_argument("--json", action="store_true", help="print all columns as JSON, one row a line")
    form.add_argument("--csv", action="store_true", help="print all columns as CSV")


_EXAMPLES = (
    "\nexamples:\n"
    "  board51 logs query \"board = 'rig7' and began like '2026-05%' and nis > 3\"\n"
    "  board51 logs query \"causes like '%coulomb-friction%' or alarms != ''\" --csv > flights.csv\n"
    '  board51 logs query --sql "SELECT board, sum(flown_s) / 3600 AS hours FROM logs GROUP BY board"'
)


def run(args: argparse.Namespace) -> int:
    """Bring the catalogue up to date, and print what was found; exit code 1: nothing was."""
    if args.sql and args.condition:
        raise UsageError("--sql excludes a CONDITION", remedy="Give one of the two")
    if not args.no_update:
        _tell(update(args.folder, lambda text: print(text, file=sys.stderr)))
    columns = COLUMNS if args.json or args.csv else SHOWN
    answer = query(args.folder, args.sql or selection(args.condition, columns))
    if args.json:
        for row in answer.rows:
            print(json.dumps(dict(zip(answer.columns, row, strict=True))))
    elif args.csv:
        csv.writer(sys.stdout).writerows([answer.columns, *answer.rows])
    else:
        print(as_text(answer))
    return 0 if answer.rows else 1


def as_text(answer: Answer) -> str:
    """Return a table for people, with the number of rows below it."""
    rows = [answer.columns, *([_cell(value) for value in row] for row in answer.rows)]
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    lines = ["  ".join(map(str.ljust, row, widths)).rstrip() for row in rows]
    return "\n".join([*lines, f"{len(answer.rows)} row{'s' * (len(answer.rows) != 1)}"])


def _cell(value: Any) -> str:
    if value is None:
        return "-"
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def _tell(done: Update) -> None:
    for name in done.unfinished:
        print(f"{name} is being written: it is in the catalogue once it is finished", file=sys.stderr)
    for text in done.unreadable:
        print(f"left out: {text}", file=sys.stderr)
