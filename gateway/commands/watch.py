"""Print what travels on the bus: one line a message, decoded; or with --table one line a rig, refreshed."""

from __future__ import annotations

import argparse
import json
import sys
import time

from google.protobuf.json_format import MessageToDict
from google.protobuf.message import Message

from gateway.client.connection import BusBoard, add_bus_arguments, open_bus
from gateway.client.message_queue import MessageQueue
from gateway.commands.watch_table import TABLE_TOPICS, show
from protocol.bus import topics
from protocol.bus.identity import find_identity
from protocol.errors import UsageError

TABLE_S = 0.5  # between two tables
LONGEST = 200  # characters of a text on a line for people

_OFTEN = ("every tick", "every 20 ms")  # rates that are printed on request only


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the arguments: which keys, how many, how often."""
    parser.epilog = (
        "examples:\n  board51 watch                       everything but samples, one line per message"
        "\n  board51 watch --topic state --every 0.5\n  board51 watch --table               all rigs, one line each"
    )
    add_bus_arguments(parser)
    parser.add_argument("--board", default="*", help="only this board")
    parser.add_argument(
        "--topic",
        action="append",
        choices=topics.RECEIVED,
        help="only this topic; repeat for more (default: those slower than the tick)",
    )
    parser.add_argument(
        "--table",
        action="store_true",
        help="one line per rig, refreshed: mode, x, reference, i_c, x minus the twin's, alarms",
    )
    parser.add_argument("--every", type=float, default=0.0, metavar="S", help="at most one line per key in this time")
    parser.add_argument("--count", type=int, default=0, help="stop after this number of lines or tables")
    parser.add_argument("--timeout", type=float, default=0.0, metavar="S", help="stop after this time")
    parser.add_argument("--json", action="store_true", help="one JSON object per line")


def _line(key: str, message: Message, *, as_json: bool) -> str:
    # With zeros: else the mode of an idle board, which is 0, would be missing.
    fields = MessageToDict(message, preserving_proto_field_name=True, always_print_fields_with_no_presence=True)
    if as_json:
        return json.dumps({"key": key, **fields})
    return f"{key}  " + "  ".join(f"{name}={_format(value)}" for name, value in fields.items())


def _format(value: object) -> str:
    if isinstance(value, str) and len(value) > LONGEST:  # a whole model file
        return f"({len(value)} characters)"
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def run(args: argparse.Namespace) -> int:
    """Print messages; return 0 if any arrived, 1 if none did before the time-out."""
    rare = [name for name in topics.RECEIVED if not topics.TOPIC_OF_NAME[name].rate.startswith(_OFTEN)]
    names = args.topic or rare
    if args.table and (args.topic or args.json):
        raise UsageError("--table has its own columns", remedy="Leave out --topic and --json")
    printed, last = 0, dict[str, float]()
    end = time.monotonic() + args.timeout if args.timeout else None
    with (
        open_bus(args.connect, find_identity(args.identity)) as session,
        MessageQueue(BusBoard(session, args.site, args.board), TABLE_TOPICS if args.table else names) as queue,
    ):
        if args.table:
            return 0 if show(queue, every_s=args.every or TABLE_S, count=args.count, end_s=end) else 1
        while not args.count or printed < args.count:
            arrival = queue.take(max(0.0, end - time.monotonic()) if end else None)
            if arrival is None:
                break
            key, message, size = arrival
            if message is None:
                print(f"{key}: {size} bytes that are not a message of this topic", file=sys.stderr)
                continue
            now = time.monotonic()
            if now - last.get(key, -1e9) >= args.every:
                last[key] = now
                printed += 1
                print(_line(key, message, as_json=args.json), flush=True)
    if queue.dropped:
        print(f"{queue.dropped} messages were lost: printing took too long", file=sys.stderr)
    return 0 if printed else 1
