"""Run gateway, twin and control room together, on a real or an emulated board, until Ctrl-C.

Each is a process of its own and is started again if it fails; its output goes to a file in the folder of the logs.
Ctrl-C sends no STOP: each board follows its host-loss policy (default: coil off after 1 s).
"""

from __future__ import annotations

import argparse
import contextlib
import math
import os
import shutil
import signal
import socket
import sys
import tempfile
import threading
from collections.abc import Callable
from functools import partial
from pathlib import Path

from gateway.access.listeners import endpoint_host, is_loopback
from gateway.commands.gateway import RETENTION, add_log_options, log_options
from gateway.commands.gateway import VIEWS as GATEWAY_VIEWS
from gateway.config import LogConfig
from gateway.link.port import closed_problem
from gateway.processes.command import EmulatedLine, emulated_line
from gateway.processes.supervisor import END_S, Service, running
from gateway.views.listen import ADDRESSES, address
from protocol.arguments import add_repeatable
from protocol.bus.endpoint import DEFAULT_ENDPOINT, check_endpoint
from protocol.ending import in_thread, on_signals, wait_for_end
from protocol.errors import ServiceError, UsageError, require
from protocol.files import make_folder, replace_text, writing
from protocol.viewer import open_viewer

PAGE = "127.0.0.1:8051"
READY_S = 90.0  # includes the first compilation of the kernels on a slow machine
POLL_S = 0.1
TELL_S = 2.0  # of waiting, before a message says what for
VIEWS = ("opcua", "foxglove")  # beside the web page
_COMPILES = "compiling the emulated board (only once after an installation)"
MB_PER_MINUTE = {False: 11.0, True: 10.0}  # by --lean: logged of a board in flight and its twin, T_s = 2 ms


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the arguments: which board, which model, where."""
    parser.epilog = (
        "examples:\n  board51 start --emulated\n  board51 start --emulated --effect coulomb-friction=2e-3\n"
        "  board51 start --board /dev/ttyUSB0 --plant my-rig.toml --opcua --keep-days 30\n"
        "  board51 start --emulated --rig heavy-ball.toml"
    )
    which = parser.add_mutually_exclusive_group(required=True)
    which.add_argument("--emulated", action="store_true", help="an emulated board, rig1")
    which.add_argument(
        "--board", action="append", metavar="[NAME=]PORT",
        help="a board and its pyserial URL; may be repeated (first name: rig1)",
    )  # fmt: skip
    add_repeatable(parser, "--effect", "NAME=VALUE", "hidden effect of the emulated plant; repeatable")
    parser.add_argument(
        "--rig", type=Path, metavar="FILE",
        help="file of another emulated rig, as for `board51 emulate`; states its plant, too",
    )  # fmt: skip
    stated = "state the plant card of a board: TOML with the [plant] of its rig, as for `campaign run`; repeatable"
    add_repeatable(parser, "--plant", "[NAME=]FILE", stated)
    parser.add_argument("--model", default="ce152", metavar="FILE", help="model of the twin (default ce152)")
    parser.add_argument(
        "--page", default=PAGE, metavar="HOST:PORT", help="address of the control room (default %(default)s)"
    )
    parser.add_argument(
        "--listen", default=DEFAULT_ENDPOINT, metavar="ENDPOINT", help="endpoint of the bus (default %(default)s)"
    )
    parser.add_argument(
        "--log-dir", type=Path, default=Path("logs"), metavar="DIR", help="folder of the MCAP logs (default logs)"
    )
    add_log_options(parser)
    for view in VIEWS:
        parser.add_argument(f"--{view}", action="store_true", help=f"{GATEWAY_VIEWS[view]} at {ADDRESSES[view]}, too")
    parser.add_argument("--no-browser", action="store_true", help="open no browser, only print the address")


def run(args: argparse.Namespace) -> int:
    """Run until a signal ends it; return 0."""
    require("all", "numba", "mcap", "scipy", "starlette", "uvicorn", *["asyncua"] * args.opcua)
    if (args.effect or args.rig) and not args.emulated:
        option = "--effect changes" if args.effect else "--rig describes"
        raise UsageError(f"{option} the emulated plant", remedy="Give it with --emulated")
    log_options(LogConfig(), args)  # checked here, as the gateway's own message would go to a file
    page = address(args.page, where="--page:")
    check_endpoint(args.listen, where="--listen")
    for host, what in ((page[0], f"--page {args.page}"), (endpoint_host(args.listen)[1], f"--listen {args.listen}")):
        if not is_loopback(host):
            raise UsageError(
                f"{what} would be open to the network, and this command has no logins",
                remedy="Give a loopback address, or start `board51 gateway --security DIR --hmi` and `board51 twin`",
            )
    _check_free(page, option="--page ")
    for view in VIEWS:
        if getattr(args, view):
            _check_free(address(ADDRESSES[view], where=""), option=f"`board51 gateway` with --{view} ")
    if args.listen.startswith("tcp/"):
        _check_free(address(args.listen.removeprefix("tcp/"), where="--listen:"), option="--listen tcp/")
    make_folder(args.log_dir)
    stopped = threading.Event()
    hang_up = (signal.SIGHUP,) if hasattr(signal, "SIGHUP") else ()
    with on_signals(in_thread(stopped.set), signal.SIGINT, signal.SIGTERM, *hang_up):
        _warn_of_ports(args.board or [])
        line = emulated_line(Path(tempfile.gettempdir())) if args.emulated else None
        services = _services(args, line)
        with running(services, end_s=END_S + 5.0):  # the gateway waits for its views
            page_answers = _await(partial(_listens, page), stopped)
            if page_answers and (line is None or _await(line.served, stopped, _COMPILES)):
                _print_services(args, services)
                wait_for_end(stopped.wait)
            elif not stopped.is_set():
                outputs = ", ".join(str(service.output) for service in services)
                problem = f"the control room at {args.page} or the emulated board did not appear within {READY_S:.0f} s"
                raise ServiceError(problem, remedy=f"The output of the processes is in {outputs}")
    print("everything stopped", file=sys.stderr)
    return 0


def _services(args: argparse.Namespace, line: EmulatedLine | None) -> list[Service]:
    commands: list[tuple[str, list[str]]] = []
    if line is not None:
        boards = [f"rig1={line.url}"]
        rig = ["--rig", str(args.rig)] if args.rig is not None else []
        commands.append(("emulate", [*line.options, *rig, *_repeated("--effect", args.effect)]))
    else:
        boards = _named(args.board)
    options = ["--listen", args.listen, "--log-dir", str(args.log_dir), "--hmi", args.page]
    options += [f"--{name}" for name in ("lean", *VIEWS) if getattr(args, name)]
    retention = {name: value for name in RETENTION if (value := getattr(args, name)) is not None}
    options += [f"--{name.replace('_', '-')}={value}" for name, value in retention.items()]
    options += [*_limits_of(args), *_repeated("--plant", args.plant or [str(args.rig)] * (args.rig is not None))]
    commands.append(("gateway", [*_repeated("--board", boards), *options]))
    commands.append(("twin", ["--connect", args.listen, "--model", args.model]))
    return [Service(name=n, arguments=tuple(words), output=args.log_dir / f"{n}.out") for n, words in commands]


def _limits_of(args: argparse.Namespace) -> list[str]:
    """Return the options that give the gateway the limits of another emulated rig; the default is a CE 152."""
    if args.rig is None:
        return []
    from gateway.emulator.own_rig import limits_toml, load_rig

    file = args.log_dir / "gateway.toml"
    with writing(file):
        replace_text(file, limits_toml(load_rig(args.rig)[1], "rig1"))
    return ["--config", str(file)]


def _warn_of_ports(boards: list[str]) -> None:
    """Print which ports cannot be opened now, as the gateway's own message goes to a file."""
    for board in _named(boards):
        name, _, port = board.partition("=")
        problem = closed_problem(port)
        if problem is not None:
            print(f"{name}: {problem.text} The gateway looks again twice a second.", file=sys.stderr, flush=True)


def _log_size(args: argparse.Namespace) -> str:
    """Return how much is logged in a minute, and for how long the disk has room."""
    rate_mb = MB_PER_MINUTE[args.lean] * max(1, len(args.board or ()))
    bound_gb = min(shutil.disk_usage(args.log_dir).free / 1e9, args.keep_gb or math.inf)
    then = "then the oldest logs are deleted" if args.keep_gb and bound_gb == args.keep_gb else "then the disk is full"
    return f"about {rate_mb:g} MB a minute: {bound_gb * 1e3 / rate_mb / 60:.3g} h in {bound_gb:.3g} GB, {then}"


def _named(boards: list[str]) -> list[str]:
    """Return the boards with their names; a URL may contain =, but not before its first slash."""
    return [
        board if "=" in board.partition("/")[0] else f"rig{number}={board}" for number, board in enumerate(boards, 1)
    ]


def _repeated(option: str, values: list[str]) -> list[str]:
    return [word for value in values for word in (option, value)]


def _check_free(address: tuple[str, int], *, option: str) -> None:
    host, port = address
    try:
        with socket.create_server((host, port), family=socket.AF_INET6 if ":" in host else socket.AF_INET):
            pass
    except OSError as error:
        raise UsageError(
            f"Cannot listen on {host}:{port} ({os.strerror(error.errno or 0)})",  # Python repeats the address
            remedy=f"If another board51 runs here, stop it, or give {option}HOST:PORT",
        ) from None


def _listens(address: tuple[str, int]) -> bool:
    with contextlib.suppress(OSError), socket.create_connection(address, timeout=1.0):
        return True
    return False


def _await(ready: Callable[[], bool], stopped: threading.Event, why: str = "") -> bool:
    """Wait for `ready`, and print after TELL_S `why` it takes so long; False after READY_S, or when stopped."""
    for look in range(round(READY_S / POLL_S)):
        if ready():
            return True
        if why and look == round(TELL_S / POLL_S):
            print(why, file=sys.stderr, flush=True)
        if stopped.wait(POLL_S):
            return False
    return False


def _print_services(args: argparse.Namespace, services: list[Service]) -> None:
    url = f"http://{args.page}"
    print(f"control room  {url}")
    print(f"bus           {args.listen}")
    for view in VIEWS:
        if getattr(args, view):
            print(f"{view:<13} {ADDRESSES[view]}")
    print(f"logging       {_log_size(args)}")
    print(f"logs          {args.log_dir}; output of {', '.join(s.name for s in services)}: {args.log_dir}/*.out")
    print("Ctrl-C stops everything", flush=True)
    if not args.no_browser:
        open_viewer(url)
