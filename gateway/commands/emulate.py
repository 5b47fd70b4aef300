"""An emulated board: firmware, converters and the 'real' rig behind a pty or a TCP port.

It behaves as protocol/README.md says, at the pace of the UART, and prints the port to give to a gateway.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import sys
from collections.abc import Callable
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from gateway.access.listeners import is_loopback
from protocol.arguments import add_repeatable
from protocol.ending import on_end_signal
from protocol.errors import UsageError

if TYPE_CHECKING:
    from gateway.emulator.line import Board


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare the options; the lists of effects and faults come from their tables."""
    from firmware.sim import CHIPS
    from gateway.emulator.serve import RIGS

    parser.epilog = _examples()
    where = parser.add_mutually_exclusive_group()
    where.add_argument(
        "--pty", metavar="PATH", type=Path,
        help="serve a pty behind the link PATH (several boards: PATH-1, PATH-2, ...)",
    )  # fmt: skip
    where.add_argument(
        "--tcp", metavar="HOST:PORT", default="127.0.0.1:0",
        help="serve TCP; several boards take consecutive ports, port 0 free ones (default: %(default)s)",
    )  # fmt: skip
    parser.add_argument("--boards", type=int, default=1, metavar="N", help="number of boards (default: 1)")
    parser.add_argument(
        "--board-id", type=int, default=1, metavar="ID", help="serial number of the first board (default: 1)"
    )
    parser.add_argument(
        "--rig",
        metavar="|".join((*RIGS, "FILE")),
        default="ce152",
        help="the plant and its board, or a TOML file with the [plant] of another one and, in [emulated], its K_c, K_A"
        " and so on; the named strengths of effects are those of the CE 152 (default: %(default)s)",
    )
    flown = parser.add_mutually_exclusive_group()
    flown.add_argument(
        "--firmware",
        choices=("python", "c"),
        default="python",
        help="the firmware model in Python, or firmware/ in C, compiled on this machine at its first use "
        "(default: python)",
    )
    flown.add_argument(
        "--chip",
        choices=tuple(CHIPS),
        help="fly firmware/ in C as the image of this chip, instruction by instruction in its simulator",
    )
    parser.add_argument("--baud", type=int, default=115200, help="speed of the line, bits per second (default: 115200)")
    parser.add_argument(
        "--speed", type=float, default=1.0, metavar="N",
        help="multiple of real time; 0: as fast as possible, without --duration only while a host is connected",
    )  # fmt: skip
    parser.add_argument(
        "--latency-timer", type=float, default=0.0, metavar="MS",
        help="the adapter of the line collects what a board sends for MS milliseconds of its time, and a command waits "
        "as long: 8 saves nearly a quarter of the processor time of emulator and gateway, 16 is usual for USB adapters "
        "(default: 0, each tick sends)",
    )  # fmt: skip
    parser.add_argument("--duration", type=float, metavar="S", help="stop after S seconds of the boards' time")
    _add_deviations(parser)
    parser.add_argument("--json", action="store_true", help="print for machines: one JSON object per line")


def _examples() -> str:
    from gateway.emulator import faults
    from gateway.emulator.plant import effects

    return (
        "examples:\n"
        "  board51 emulate --pty /tmp/board51\n"
        "  board51 emulate --tcp 127.0.0.1:5100 --boards 4 --effect quadratic-drag=1.0\n"
        "  board51 emulate --pty /tmp/board51 --fault flip=1e-4 --fault stall=0.5@10/30 --fault reset@60\n"
        "  board51 emulate --pty /tmp/board51 --firmware c\n"
        "  board51 emulate --pty /tmp/board51 --chip avr\n"
        "  board51 emulate --pty /tmp/board51 --rig magnetoshield --chip avr\n"
        "  board51 emulate --pty /tmp/board51 --rig my-rig.toml\n"
        "  board51 emulate --tcp 127.0.0.1:0 --secret 7 --sealed sealed.json\n\n"
        f"{faults.HELP}\n\n"
        f"effects (--effect NAME=VALUE; VALUE a number, or one of the three given here as weak | medium | strong):\n"
        f"{effects.listing()}"
    )


def _add_deviations(parser: argparse.ArgumentParser) -> None:
    """Add what makes board, line and plant differ from the nominal ones."""
    add_repeatable(parser, "--effect", "NAME=VALUE", "effect that the twin's model does not have; repeatable")
    parser.add_argument("--secret", type=int, metavar="SEED", help="draw hidden effects from SEED")
    parser.add_argument("--sealed", type=Path, metavar="FILE", help="with --secret: file for the sealed effects")
    add_repeatable(parser, "--fault", "FAULT", "fault of board or line; repeatable")
    parser.add_argument(
        "--seed", type=int, default=0, help="seed of noise and faults; board n takes SEED + n (default: 0)"
    )


def run(args: argparse.Namespace) -> int:
    """Serve until SIGTERM, SIGINT or the end of --duration."""
    from gateway.emulator.plant import effects, secret
    from gateway.emulator.ports import pty_ports, tcp_ports
    from gateway.emulator.serve import Server, build_lines

    _check(args)
    strengths = dict(effects.parse(text) for text in args.effect)
    commitment = None
    if args.secret is not None:
        strengths = secret.draw(args.secret)
        commitment = secret.seal(args.sealed, strengths)
    ports = pty_ports(args.pty, args.boards) if args.pty else tcp_ports(*_address(args), args.boards)
    lines = build_lines(
        ports, effects=strengths, faults=args.fault, seed=args.seed, baud=args.baud, board_id=args.board_id,
        firmware=_firmware(args), rig=args.rig,
    )  # fmt: skip
    server = Server(lines, speed=args.speed, latency_timer_s=args.latency_timer * 1e-3)
    on_end_signal(server.stop)
    for n, line in enumerate(lines):
        facts = {"board_id": args.board_id + n, "url": line.port.url}
        _print(json.dumps(facts) if args.json else f"board {facts['board_id']}: {facts['url']}")
    if args.pty is None and not is_loopback(_address(args)[0]):
        print(
            f"board51 emulate: --tcp {args.tcp} is open to the network WITHOUT PROTECTION: whoever reaches it may "
            "command the emulated board; 127.0.0.1 serves this machine alone",
            file=sys.stderr,
        )
    if commitment is not None:
        text = f"effects sealed in {args.sealed}: {commitment}"
        _print(json.dumps({"commitment": commitment}) if args.json else text)

    server.run(args.duration)
    for n, line in enumerate(lines):
        counts = asdict(line.counts) | {"late_ticks": server.overdue_ticks, "worst_lateness_s": server.worst_lateness_s}
        if args.json:
            _print(json.dumps({"board_id": args.board_id + n, "counts": counts}))
        else:
            summary = ", ".join(f"{name} {value:.6g}" for name, value in counts.items())
            print(f"board {args.board_id + n}: {summary}", file=sys.stderr)
    return 0


def _firmware(args: argparse.Namespace) -> Callable[..., Board]:
    from firmware.sim import CHIPS
    from gateway.emulator.firmware_model.board import Firmware
    from gateway.emulator.native.board import NativeFirmware

    if args.chip is not None:
        return partial(CHIPS[args.chip], baud=args.baud)
    return Firmware if args.firmware == "python" else NativeFirmware


def _print(line: str) -> None:
    """Print a line; if the reader of the addresses has ended, or its disk is full, the boards go on."""
    try:
        print(line, flush=True)
    except OSError:  # Python would fail again when it exits
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _check(args: argparse.Namespace) -> None:
    from gateway.emulator.serve import RIGS

    for option, value, low, high in (
        ("--boards", args.boards, 1, 64),
        ("--board-id", args.board_id, 0, 0xFFFFFFFF - 64),
        ("--baud", args.baud, 300, 4_000_000),
        ("--speed", args.speed, 0.0, 1000.0),
        ("--latency-timer", args.latency_timer, 0.0, 100.0),
        ("--duration", 0.0 if args.duration is None else args.duration, 0.0, math.inf),
        ("--seed", args.seed, 0, 2**63),
        ("--secret", args.secret or 0, 0, 2**63),
    ):
        if not low <= value <= high:
            raise UsageError(f"{option} {value} is out of range", remedy=f"Give a number from {low} to {high}")
    if (args.secret is None) != (args.sealed is None):
        raise UsageError("--secret and --sealed belong together", remedy="Give both, or --effect instead")
    if args.chip is not None and args.rig not in RIGS:
        problem = f"--rig {args.rig}: the image of a chip holds the numbers of its rig"
        raise UsageError(problem, remedy="Leave out --chip, or --rig FILE")
    if args.secret is not None and args.rig != "ce152":
        problem = "--secret draws the strengths of a CE 152's effects"
        raise UsageError(problem, remedy="Leave --rig out, or give --effect")
    if args.secret is not None and args.effect:
        raise UsageError("--effect with --secret would reveal a part of it", remedy="Give one of the two")


def _address(args: argparse.Namespace) -> tuple[str, int]:
    host, _, port = args.tcp.rpartition(":")
    if not host or not port.isdecimal() or int(port) + args.boards - 1 > 65535:
        raise UsageError(f"--tcp {args.tcp} is not an address for {args.boards} board(s)", remedy="Give HOST:PORT")
    return host.strip("[]"), int(port)
