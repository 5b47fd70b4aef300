"""Replay a log onto the bus at any speed, or its raw bytes to a pty or TCP port for a gateway to read.

The bus gets everything that the gateway published, under the old keys (--as renames the board).  twin/* is left out
unless --topic asks for it, because a live twin computes it again.  With --bytes a gateway gets the bytes of the
board as they were, with their noise.  HELLO, GET_PARAMETERS and PING are answered from the log.  Every other command is
refused with NOT_AVAILABLE, because a command cannot change a recording.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import queue
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from gateway.access.listeners import check_bus_listeners
from protocol.bus import topics
from protocol.bus.endpoint import DEFAULT_ENDPOINT, Mode, check_endpoint, zenoh_config
from protocol.bus.identity import HELP, find_identity
from protocol.ending import on_end_signal
from protocol.errors import DataError, ServiceError, UsageError
from protocol.log.reader import LogReader, RawLogRecord

if TYPE_CHECKING:
    import zenoh

    from gateway.record.replay import BusReplay

SETTLE_S = 0.1  # a subscription that has just appeared takes up to 60 ms until data flows to it (measured)


def configure(parser: argparse.ArgumentParser) -> None:
    """Options of the command."""
    names = topics.RECORDED
    parser.add_argument("logs", type=Path, nargs="+", metavar="LOG", help="an MCAP file, or the parts of one log")
    parser.add_argument(
        "--speed", type=float, default=1.0, metavar="N", help="multiple of real time; 0: as fast as possible"
    )
    parser.add_argument("--start", type=float, default=0.0, metavar="S", help="begin S seconds after the log begins")
    parser.add_argument("--end", type=float, metavar="S", help="end S seconds after the log begins")
    parser.add_argument("--board", action="append", help="only this board; repeatable")
    bus = parser.add_argument_group("onto the bus")
    bus.add_argument("--connect", action="append", metavar="ENDPOINT", help=f"router (default {DEFAULT_ENDPOINT})")
    bus.add_argument("--listen", action="append", metavar="ENDPOINT", help="be a router instead of joining one")
    bus.add_argument(
        "--identity", metavar="FOLDER", help=f"{HELP}; only the identity of the gateway may publish its topics"
    )
    bus.add_argument("--insecure", action="store_true", help="--listen on the network without protection")
    bus.add_argument("--topic", action="append", choices=names, metavar="TOPIC", help=f"of: {', '.join(names)}")
    bus.add_argument("--as", dest="rename", metavar="NAME", help="publish the board under this name")
    bus.add_argument(
        "--as-site", metavar="SITE", help="publish under this site, so that nobody mistakes the replay for a live rig"
    )
    bus.add_argument("--loop", action="store_true", help="repeat without end; each pass has its own session numbers")
    bus.add_argument(
        "--control",
        action="store_true",
        help="take orders from standard input, one a line: pause, play, seek S, speed N; stay at the end",
    )
    bus.add_argument("--wait", type=float, default=2.0, metavar="S", help="longest wait for a subscriber (default 2)")
    raw = parser.add_argument_group("as a board")
    raw.add_argument("--bytes", action="store_true", help="the raw bytes of the UART")
    raw.add_argument("--pty", type=Path, metavar="PATH", help="make a new pty, with this link to it")
    raw.add_argument("--tcp", metavar="HOST:PORT", help="port to open; the gateway's URL is socket://HOST:PORT")
    parser.add_argument("--json", action="store_true", help="print the summary as JSON")
    parser.epilog = (
        "examples:\n"
        "  board51 replay run.mcap --speed 10\n"
        "  board51 replay run.mcap --speed 0 --start 5 --end 20 --as ghost\n"
        "  board51 replay run.mcap --bytes --pty /tmp/board   then   board51 gateway --board rig=/tmp/board"
    )


def run(args: argparse.Namespace) -> int:
    """Replay until the end, SIGTERM or SIGINT."""
    if args.control and (args.loop or args.bytes or not args.speed > 0.0):
        raise UsageError("--control excludes --loop, --bytes and --speed 0", remedy="Leave those out")
    if args.speed < 0.0 or not args.speed < float("inf"):
        raise UsageError(f"--speed {args.speed} is not a speed", remedy="Give 0 or a positive number")
    stop = threading.Event()
    on_end_signal(stop.set)
    if args.bytes:
        from gateway.commands.logs.replay_bytes import replay_bytes

        return replay_bytes(args, stop)
    if args.pty or args.tcp:
        raise UsageError("--pty and --tcp take bytes", remedy="Add --bytes")
    return _bus(args, stop)


def _bus(args: argparse.Namespace, stop: threading.Event) -> int:
    from gateway.record.replay import DEFAULT_TOPICS, BusReplay, contents
    from protocol.bus.closing import closing

    if args.connect and args.listen:
        raise UsageError("--connect and --listen exclude each other", remedy="Give one of the two")
    if args.rename:
        topics.check_name(args.rename, what="--as")
    if args.as_site:
        topics.check_name(args.as_site, what="--as-site")
    for endpoint in (args.connect or []) + (args.listen or []):
        check_endpoint(endpoint, where="--connect or --listen")
    reader = LogReader(args.logs)
    topics_ = tuple(args.topic or DEFAULT_TOPICS)
    channels = contents(reader, topics_=topics_, boards=args.board)
    if not channels:
        _raise_empty(reader, args)
    boards = list(dict.fromkeys((site, board) for site, board, _ in channels))
    begin_s = time.monotonic()
    session = _session(args)
    with closing(session), BusReplay(session, boards, rename=args.rename, site=args.as_site) as replay:
        replay.declare(channels)
        deadline_s = time.monotonic() + args.wait
        while not replay.matched() and time.monotonic() < deadline_s and not stop.is_set():
            stop.wait(0.02)
        if not replay.matched() and not args.json:
            print("no subscriber yet", file=sys.stderr)
        stop.wait(SETTLE_S)
        sent, passes, log_s = _play(reader, replay, args, topics_, stop)
    if args.control:
        return 0
    lasted_s = time.monotonic() - begin_s
    if args.json:
        print(json.dumps({"messages": sent, "passes": passes, "seconds": lasted_s, "log_seconds": log_s}))
    else:
        print(f"{sent} messages, {log_s:.3f} s of the log, in {lasted_s:.3f} s")
    reader.check(last_ns=None)
    return 0 if sent else 1


def _session(args: argparse.Namespace) -> zenoh.Session:
    """Open the bus, as its router with --listen.

    Raises:
        ServiceError: no router answers, or the port is in use.
    """
    import zenoh

    connect = [] if args.listen else args.connect or [DEFAULT_ENDPOINT]
    check_bus_listeners(args.listen or [], guarded=False, insecure=args.insecure)
    mode: Mode = "router" if args.listen else "client"
    identity = find_identity(args.identity)
    config = zenoh_config(mode, listen=args.listen or [], connect=connect, identity=identity)
    try:
        return zenoh.open(zenoh.Config.from_json5(config))
    except zenoh.ZError:
        where = f"Cannot listen on {args.listen[0]}" if args.listen else f"No router answers at {connect[0]}"
        raise ServiceError(where, remedy="Start board51 gateway or router, or replay with --listen") from None


def _play(
    reader: LogReader, replay: BusReplay, args: argparse.Namespace, topics_: tuple[str, ...], stop: threading.Event
) -> tuple[int, int, float]:
    """Play once, in a loop, or as standard input orders; return messages, passes and the log time of all passes, s.

    Under orders, each change of state is printed as a line of JSON.
    """
    from gateway.record.player import Player
    from gateway.record.replay import SESSIONS_PER_PASS, from_time

    sent, passes, log_s = 0, 0, 0.0
    progress = _Progress(quiet=args.json or args.control)

    def send(record: RawLogRecord) -> None:
        nonlocal sent
        replay.send(record)
        sent += 1
        progress.at(record.time_ns, reader.start_ns)

    def next_session() -> None:
        replay.session_offset += SESSIONS_PER_PASS  # nothing is continuous across a seek, or from pass to pass

    def no_order(limit_s: float) -> None:
        stop.wait(limit_s)

    player = Player(
        lambda start_s: from_time(reader, start_s, topics_=topics_, boards=args.board, end_s=args.end),
        send,
        next_order=_orders() if args.control else no_order,
        sought=next_session,
        report=lambda state: print(json.dumps(state), flush=True),
        stop=stop,
    )
    if args.control:
        player.run(args.start, args.speed)
    while not stop.is_set():
        before = sent
        log_s += player.play(args.start, args.speed)
        passes += 1
        next_session()
        if not args.loop or sent == before:
            break
    progress.end()
    return sent, passes, log_s


def _orders() -> Callable[[float], str | None]:
    """Return a function of seconds to wait, which returns the next line of standard input, or None."""
    orders: queue.Queue[str] = queue.Queue()  # a signal may prolong the time limit of a SimpleQueue for ever

    def listen() -> None:
        for line in sys.stdin:
            orders.put(line)

    def next_order(limit_s: float) -> str | None:
        with contextlib.suppress(queue.Empty):
            return orders.get(timeout=limit_s)
        return None

    threading.Thread(target=listen, name="orders", daemon=True).start()
    return next_order


def _raise_empty(reader: LogReader, args: argparse.Namespace) -> None:
    reader.check(last_ns=None)
    available = sorted({channel.topic for scan in reader.scans for channel in scan.channels.values()})
    selection = " ".join([*(args.topic or ()), *(args.board or ())]) or "any topic of the bus"
    raise DataError(f"Log {reader.name} has no messages of {selection}", remedy=f"It has: {', '.join(available)}")


class _Progress:
    """A line of progress on a terminal, once a second."""

    def __init__(self, *, quiet: bool) -> None:
        self._is_enabled = not quiet and sys.stderr.isatty()
        self._next_s = 0.0

    def at(self, time_ns: int, start_ns: int) -> None:
        if self._is_enabled and time.monotonic() >= self._next_s:
            self._next_s = time.monotonic() + 1.0
            print(f"\r{(time_ns - start_ns) / 1e9:10.1f} s", end="", file=sys.stderr, flush=True)

    def end(self) -> None:
        if self._is_enabled:
            print(file=sys.stderr)
