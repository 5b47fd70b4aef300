"""Test a board on its serial port: link, converters, coil, sensor, safety; each line says what to do.

Before you start: the ball lies at the bottom, its way up is free, and no gateway uses the port.  The board is stopped
and restarted first.  The coil is off at the end, also after Ctrl-C; keep a hand on its plug.
"""

from __future__ import annotations

import argparse
import json
import signal
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict
from pathlib import Path

from gateway.selftest.bench import Bench
from gateway.selftest.connection import Connection
from gateway.selftest.report import Report, write_report
from gateway.selftest.rigs import RIGS
from gateway.selftest.runner import run_checks, switch_off
from gateway.selftest.table import CHECKS, Check
from gateway.selftest.verdict import Verdict, line
from gateway.selftest.wire import open_wire
from protocol.ending import on_signals
from protocol.errors import UsageError

_NAMES = [check.name for check in CHECKS]


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare the options; the list of checks comes from their table."""
    parser.epilog = (
        "examples:\n"
        "  board51 selftest --board /dev/ttyUSB0\n"
        "  board51 selftest --board /dev/ttyACM0 --rig magnetoshield --only link --only converters\n"
        "  board51 selftest --board /dev/ttyACM0 --rig magnetoshield --only calibration --calibrate\n"
        "  board51 selftest --board tcp://127.0.0.1:5100 --yes --quick --json\n\n"
        f"checks:\n{_listing()}\n\n"
        "exit code: 0 no fault, 1 faults, 2 it could not run"
    )
    parser.add_argument("--board", metavar="PORT", help="serial device, pty, or tcp://HOST:PORT of the board")
    parser.add_argument("--rig", choices=tuple(RIGS), default="ce152", help="rig of the board (default: %(default)s)")
    parser.add_argument("--baud", type=int, default=115200, help="speed of the line, bit/s (default: %(default)s)")
    parser.add_argument("--only", action="append", choices=_NAMES, metavar="CHECK", help="only this; repeatable")
    parser.add_argument("--skip", action="append", choices=_NAMES, metavar="CHECK", help="not this; repeatable")
    parser.add_argument("--list", action="store_true", help="list the checks and end")
    parser.add_argument(
        "--calibrate",
        action="store_true",
        help="correct x in the board: it then reads 0 at the bottom stop and the travel at the top stop",
    )
    parser.add_argument("--quick", action="store_true", help="fewer repetitions: 15 s instead of 70 s")
    parser.add_argument("--yes", action="store_true", help="do not ask before current flows")
    parser.add_argument("--json", action="store_true", help="print one JSON object per line")
    parser.add_argument(
        "--log-dir", type=Path, default=Path("logs"), metavar="DIR", help="folder of the report (default: %(default)s)"
    )


def run(args: argparse.Namespace) -> int:
    """Run the checks; return 0 without a fault, 1 with one."""
    if args.list:
        print(_listing())
        return 0
    if args.board is None:
        raise UsageError("No board is given", remedy="Give --board /dev/ttyUSB0, or --list")
    if not 300 <= args.baud <= 4_000_000:
        raise UsageError(f"--baud {args.baud} is out of range", remedy="Give 57600, 115200 or 250000")
    checks = [check for check in CHECKS if check.name in (args.only or _NAMES) and check.name not in (args.skip or ())]
    if not checks:
        raise UsageError("No check is left", remedy="Leave out a --skip")
    if args.calibrate and "calibration" not in {check.name for check in checks}:
        raise UsageError("--calibrate belongs to the check calibration", remedy="Add --only calibration")
    _confirm(checks, assent=args.yes)
    wire = open_wire(args.board, args.baud)
    console = Console(as_json=args.json)
    bench = Bench(
        line=Connection(wire), rig=RIGS[args.rig], port=args.board, baud=args.baud, quick=args.quick,
        calibrate=args.calibrate, progress=console.progress,
    )  # fmt: skip
    started_s = time.time()
    try:
        with on_signals(_interrupt, signal.SIGTERM, signal.SIGINT):
            verdicts = run_to_the_end(bench, checks, console.show)
    finally:
        wire.close()
    report = Report(
        verdicts=verdicts, rig=bench.rig.title, port=args.board, started_s=started_s, duration_s=time.time() - started_s
    )
    console.end(report, write_report(report, args.log_dir))
    return 1 if report.faults else 0


class Console:
    """Prints the verdicts to stdout, and progress to stderr if it is a terminal."""

    def __init__(self, *, as_json: bool) -> None:
        self._as_json = as_json
        self._live = sys.stderr.isatty() and not as_json
        self._status = ""

    def progress(self, text: str, share: float) -> None:
        """Show what goes on, on a line that the next verdict overwrites."""
        status = f"... {text}, {100 * share:.0f} %"
        if self._live and status != self._status:
            print(f"\r\x1b[K{status}", end="", file=sys.stderr, flush=True)
            self._status = status

    def show(self, verdict: Verdict) -> None:
        """Print a verdict."""
        if self._status:
            print("\r\x1b[K", end="", file=sys.stderr, flush=True)
            self._status = ""
        print(json.dumps(asdict(verdict)) if self._as_json else line(verdict), flush=True)

    def end(self, report: Report, paths: Sequence[Path]) -> None:
        """Print the answer, and where the report is."""
        if self._as_json:
            print(json.dumps({"answer": report.answer, "faults": report.faults, "report": [str(p) for p in paths]}))
        else:
            hint = "" if len(paths) > 1 else "; a page, too, with the extra 'web'"
            print(f"\n{report.answer}\nreport: {', '.join(map(str, paths))}{hint}")


def run_to_the_end(bench: Bench, checks: Sequence[Check], show: Callable[[Verdict], None]) -> list[Verdict]:
    """Run the checks, and switch the coil off whatever happens."""
    verdicts: list[Verdict] = []
    try:
        for verdict in run_checks(bench, checks):
            verdicts.append(verdict)
            show(verdict)
    finally:
        with on_signals(lambda: None, signal.SIGTERM, signal.SIGINT):  # a second Ctrl-C must not stop the STOP
            verdicts.append(switch_off(bench))
            show(verdicts[-1])
    return verdicts


def _interrupt() -> None:
    raise KeyboardInterrupt


def _listing() -> str:
    return "\n".join(f"  {c.name:<12} {c.summary}{'; current flows' if c.current else ''}" for c in CHECKS)


def _confirm(checks: Sequence[Check], *, assent: bool) -> None:
    """Ask before current flows.

    Raises:
        UsageError: the answer is no, or stdin is not a terminal.
    """
    names = [check.name for check in checks if check.current]
    if assent or not names:
        return
    without = " ".join(f"--only {check.name}" for check in CHECKS if not check.current)
    if not sys.stdin.isatty():
        raise UsageError("Current will flow, and there is no terminal to ask", remedy=f"Give --yes, or {without}")
    print(f"Current will flow ({', '.join(names)}): the ball may be lifted to its ceiling.", file=sys.stderr)
    print("Is its way free, and the plug of the coil within reach? [y/N] ", end="", file=sys.stderr, flush=True)
    if sys.stdin.readline().strip().lower() not in ("y", "yes"):
        raise UsageError("Not confirmed", remedy=f"Without current: {without}")
