"""Save the readable part of a broken log in a clean file, and report what was lost.

A log is broken if its writer was killed (it lacks its end), the disk was full, or the medium damaged it.  The broken
file is not changed.  Exit code 0: all intact messages are in the new file, even if others are lost.
"""

from __future__ import annotations

import argparse
import json
from dataclasses import asdict
from datetime import UTC, datetime
from pathlib import Path

from gateway.record.recover import Recovery, recover


def configure(parser: argparse.ArgumentParser) -> None:
    """Options of the command."""
    parser.add_argument("broken", type=Path, metavar="BROKEN", help="the MCAP file to save")
    parser.add_argument("-o", "--out", type=Path, required=True, metavar="CLEAN", help="the MCAP file to create")
    parser.add_argument("--json", action="store_true", help="print the summary as JSON")
    parser.epilog = "example:\n  board51 recover logs/board51-20260101T120000Z-003.mcap -o clean.mcap"


def run(args: argparse.Namespace) -> int:
    """Recover and say what was lost."""
    result = recover(args.broken, args.out)
    print(json.dumps(asdict(result), indent=2, default=str) if args.json else _as_text(result))
    return 0


def _as_text(result: Recovery) -> str:
    lines = [f"{result.clean}: {result.messages} messages from {result.broken}"]
    if result.last_good_s is not None and result.last_good_ns is not None:
        when = datetime.fromtimestamp(result.last_good_ns / 1e9, UTC).isoformat(timespec="milliseconds")
        lines.append(f"readable to {result.last_good_s:.3f} s after its start ({when})")
    if result.damages:
        lines.append(f"lost: {result.bytes_lost} of {result.bytes_read} bytes")
        lines += [f"  byte {damage.offset}: {damage.reason} ({damage.bytes} bytes)" for damage in result.damages]
        if result.seconds_lost is not None:
            lines.append(f"  {result.seconds_lost:.3f} s of data after the last message saved")
    elif not result.was_finished:
        lines.append("the file has no end, but nothing in it is damaged; the data that its writer still held is lost")
    else:
        lines.append("the file was complete: nothing lost")
    if result.messages_unidentified:
        lines.append(f"{result.messages_unidentified} messages belong to channels whose description is lost")
    if result.foreign:
        lines.append(f"{result.foreign} messages of other schemas were not copied")
    for gap in result.gaps[:20]:
        lines.append(f"gap: {gap.board}, {gap.missing} sample(s) after tick {gap.after_tick} ({gap.at_s:.3f} s)")
    if len(result.gaps) > 20:
        lines.append(f"and {len(result.gaps) - 20} more gaps; --json lists them")
    return "\n".join(lines)
