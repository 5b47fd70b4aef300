"""The works `archive` and `fetch` of `board51 logs`: a folder of logs into a bucket, and single logs back."""

from __future__ import annotations

import argparse
import os
import sys
import time
from contextlib import suppress
from pathlib import Path
from typing import Any

from gateway.record.archive.bucket import Bucket
from gateway.record.archive.copies import Archiver, Tally, fetch
from protocol.arguments import interval
from protocol.ending import end_at_once
from protocol.errors import Board51Error, UsageError
from protocol.files import make_folder

_NICE = 5  # a gateway on the same machine comes first
_KEYS = "The keys come from the environment: AWS_ACCESS_KEY_ID and AWS_SECRET_ACCESS_KEY."
_ARCHIVE = f"""Copy the finished logs of FOLDER to object storage that speaks S3.  Nothing is deleted, here or there.

Only what is new or has changed is copied.  You may stop, kill and start it again at any time.  The column archived of
`board51 logs query` then has the addresses, and the rows stay when a log is deleted here.

{_KEYS}"""
_FETCH = f"""Copy archived logs back, whole and checked, by the addresses that `board51 logs query` shows as archived.

{_KEYS}"""


def configure(work: argparse._SubParsersAction[Any]) -> None:
    """Add the two works."""

    def add(name: str, purpose: str, text: str, example: str) -> argparse.ArgumentParser:
        parser: argparse.ArgumentParser = work.add_parser(
            name, help=purpose, description=text, epilog=f"example:\n  {example}"
        )
        parser.add_argument(
            "--endpoint", metavar="URL", help="endpoint of the server (AWS_ENDPOINT_URL, or Amazon's own)"
        )
        return parser

    server = "--endpoint https://storage.plant:9000"
    example = f"board51 logs archive logs --to s3://plant/hall-3 {server} --every 300"
    archiving = add("archive", "copy logs to object storage", _ARCHIVE, example)
    archiving.set_defaults(run=_archive)
    archiving.add_argument("folder", type=Path, metavar="FOLDER", help="folder of the logs, with its sub-folders")
    archiving.add_argument("--to", required=True, metavar="ADDRESS", help="s3://BUCKET/PREFIX, one for each FOLDER")
    archiving.add_argument("--every", type=interval, metavar="S", help="repeat every S seconds")
    example = f"board51 logs fetch s3://plant/hall-3/board51-20260501T120000Z-000.mcap {server}"
    fetching = add("fetch", "copy logs back from there", _FETCH, example)
    fetching.set_defaults(run=_fetch)
    fetching.add_argument("addresses", nargs="+", metavar="ADDRESS", help="address of a log: s3://BUCKET/PREFIX/NAME")
    fetching.add_argument("-o", "--out", type=Path, default=Path("fetched"), help="folder, made if absent (fetched)")


def _archive(args: argparse.Namespace) -> int:
    """Archive once, or until it is ended."""
    end_at_once()
    with suppress(AttributeError, OSError):  # Windows has no such priority
        os.nice(_NICE)
    archiver = Archiver(args.folder, Bucket(args.to, args.endpoint), _print_line)
    if args.every is None:
        _print_line(_as_text(archiver.copy()))
        return 0
    printed = ""
    while True:
        try:
            tally = archiver.copy()
            text = _as_text(tally) if tally.copied else ""
        except Board51Error as error:  # the network, the server or the disk: all may come back
            text = str(error)
        if text and text != printed:
            _print_line(text)
        printed = text
        time.sleep(args.every)


def _fetch(args: argparse.Namespace) -> int:
    """Fetch, and print the paths."""
    end_at_once()
    for address in args.addresses:
        prefix, _, name = address.rpartition("/")
        if not name:
            raise UsageError(f"{address} is not the address of a log", remedy="Write s3://BUCKET/PREFIX/NAME")
        bucket = Bucket(prefix, args.endpoint)
        make_folder(args.out)
        _print_line(f"{address} to {args.out}")
        print(fetch(bucket, name, args.out), flush=True)
    return 0


def _as_text(tally: Tally) -> str:
    text = f"logs copied: {tally.copied} ({tally.bytes / 1e6:.1f} MB), archived: {tally.archived}"
    return f"{text}, waiting: {tally.waiting}" if tally.waiting else text


def _print_line(line: str) -> None:
    print(line, file=sys.stderr, flush=True)
