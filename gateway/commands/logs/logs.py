"""Search many logs at once: which flights of which rig, when, on which model.  Archive them on an S3 server.

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

from gateway.commands.logs import archive
from gateway.record.catalogue.store import COLUMNS, Answer, Update, query, selection, update
from protocol.errors import UsageError

COLUMNS_OF_TABLE = "began board session duration_s flown_s model causes alarms nis file archived".split()


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the works."""
    parser.epilog = f"columns: {', '.join(COLUMNS)}\n{_EXAMPLES}"
    work = parser.add_subparsers(dest="work", required=True, metavar="WORK")
    parser_of_query = work.add_parser(
        "query", help="list the sessions that satisfy a condition", description=__doc__, epilog=parser.epilog
    )
    parser_of_query.add_argument("condition", nargs="?", default="", metavar="CONDITION", help="in SQL; default: all")
    parser_of_query.add_argument(
        "--folder", type=Path, default=Path("logs"), help="folder of the logs, with its sub-folders (logs)"
    )
    parser_of_query.add_argument(
        "--sql", metavar="SELECT", help="a whole SELECT over the table logs instead of a CONDITION"
    )
    parser_of_query.add_argument("--no-update", action="store_true", help="do not bring the catalogue up to date first")
    parser_of_query.add_argument("--quiet", action="store_true", help="no progress on stderr")
    form = parser_of_query.add_mutually_exclusive_group()
    form.add_argument("--json", action="store_true", help="print all columns as JSON, one row a line")
    form.add_argument("--csv", action="store_true", help="print all columns as CSV")
    parser_of_query.set_defaults(run=_query)
    archive.configure(work)


_EXAMPLES = (
    "\nexamples:\n"
    "  board51 logs query \"board = 'rig7' and began like '2026-05%' and nis > 3\"\n"
    "  board51 logs query \"causes like '%coulomb-friction%' or alarms != ''\" --csv > flights.csv\n"
    '  board51 logs query --sql "SELECT board, sum(flown_s) / 3600 AS hours FROM logs GROUP BY board"'
)


def run(args: argparse.Namespace) -> int:
    """Do the work."""
    return int(args.run(args))


def _query(args: argparse.Namespace) -> int:
    """Bring the catalogue up to date, and print what was found; exit code 1: nothing was."""
    if args.sql and args.condition:
        raise UsageError("--sql excludes a CONDITION", remedy="Give one of the two")
    if not args.no_update:
        result = update(args.folder, (lambda _: None) if args.quiet else _write_progress)
        _write_progress(*_left_out(result))
    columns = COLUMNS if args.json or args.csv else COLUMNS_OF_TABLE
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


def _left_out(result: Update) -> list[str]:
    written = [f"{name} is being written: it is in the catalogue once it is finished" for name in result.unfinished]
    return written + [f"left out: {text}" for text in result.unreadable]


def _write_progress(*lines: str) -> None:
    for line in lines:
        print(line, file=sys.stderr)
