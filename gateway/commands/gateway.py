"""Run the gateway daemon: boards on one side, zenoh and an MCAP log on the other.

It reads every board, publishes each sample in SI units under <site>/<board>/state, answers commands on
<site>/<board>/command, and logs everything.  It sends no STOP when it ends: each board follows its host-loss policy
(default: coil off after 1 s).
"""

from __future__ import annotations

import argparse
import sys
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from gateway.views.listen import ADDRESSES
from protocol.arguments import add_repeatable
from protocol.bus.endpoint import check_endpoint
from protocol.bus.identity import login_name
from protocol.bus.topics import check_name
from protocol.errors import ConfigError

if TYPE_CHECKING:  # importing pydantic is slow, and --help does not need it
    from gateway.config import BoardConfig, GatewayConfig, LogConfig

RETENTION = ("keep_days", "keep_gb")  # options, and keys of [log]
VIEWS = {"opcua": "OPC UA server", "hmi": "control room in a browser", "foxglove": "live Foxglove WebSocket"}


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the options.  They override the environment, and the environment overrides the file."""
    parser.epilog = (
        "examples:\n  board51 gateway --board rig1=/dev/ttyUSB0\n"
        "  board51 gateway --board rig1='/dev/serial/by-id/*Board51*' --board rig2=socket://10.0.0.5:4001\n"
        "  board51 gateway --print-config > gateway.toml; board51 gateway --config gateway.toml\n"
        "  board51 gateway --board rig1=/dev/ttyUSB0 --plant my-rig.toml\n"
        "  board51 gateway --board rig1=/dev/ttyUSB0 --opcua --opcua-rate 50 --hmi"
    )
    parser.add_argument("--config", type=Path, metavar="FILE", help="TOML; every key is optional except the boards")
    add_repeatable(
        parser, "--board", "NAME=PORT", "a board and its pyserial URL; may be repeated; replaces those of the file"
    )
    stated = "state the plant card of a board now: TOML with the [plant] of its rig; may be repeated"
    add_repeatable(parser, "--plant", "[NAME=]FILE", stated)
    parser.add_argument("--site", help="first chunk of every key (default board51)")
    add_repeatable(parser, "--listen", "ENDPOINT", "be the router here (default tcp/127.0.0.1:7447)")
    joined = "be a client of the router there instead; with --listen: be a router that joins it"
    add_repeatable(parser, "--connect", "ENDPOINT", joined)
    log = parser.add_mutually_exclusive_group()
    log.add_argument("--log-dir", metavar="DIR", help="where the MCAP log goes (default logs)")
    log.add_argument("--no-log", action="store_true", help="write no log")
    add_log_options(parser)
    guard = parser.add_argument_group("who may do what")
    guard.add_argument(
        "--security", metavar="DIR", help="guard the bus with the folder that `board51 security init DIR` made"
    )
    guard.add_argument("--insecure", action="store_true", help="open listeners to the network without protection")
    views = parser.add_argument_group("views, each a process of its own; or [opcua], [hmi], [foxglove] of the file")
    for name, description in VIEWS.items():
        default = ADDRESSES[name]
        views.add_argument(
            f"--{name}", nargs="?", const=default, metavar="HOST:PORT", help=f"{description} (default {default})"
        )
    views.add_argument(
        "--opcua-rate", type=float, metavar="HZ", help="values per second over OPC UA, 10 to 50 (default 20)"
    )
    parser.add_argument("--print-config", action="store_true", help="print a commented configuration and end")
    parser.add_argument("--check", action="store_true", help="check the configuration and end")


def add_log_options(parser: argparse.ArgumentParser) -> None:
    """Add the options on what is logged, and for how long it is kept."""
    parser.add_argument("--lean", action="store_true", help="log no raw bytes of the UART: a tenth less")
    parser.add_argument(
        "--keep-days", type=float, metavar="DAYS", help="delete own logs that are older (default: never)"
    )
    parser.add_argument("--keep-gb", type=float, metavar="GB", help="delete the oldest own logs beyond this size")


def log_options(log: LogConfig, args: argparse.Namespace) -> LogConfig:
    """Return `log` with the options of `add_log_options`.  Raises ConfigError."""
    from gateway.config import changed

    if args.lean:
        log = replace(log, raw=False)
    for name in RETENTION:
        if (bound := getattr(args, name)) is not None:
            log = changed(log, f"--{name.replace('_', '-')}", **{name: bound})
    return log


def configuration(args: argparse.Namespace) -> GatewayConfig:
    """Return the configuration from file, environment and flags.

    Raises:
        ConfigError: one of them is wrong.
    """
    from gateway.config import changed, load_config

    config = load_config(args.config)
    if args.site is not None:
        config = replace(config, site=check_name(args.site, what="--site"))
    if args.board:
        boards = tuple(_board(text, config) for text in args.board)
        names, ports = [b.name for b in boards], [b.port for b in boards]
        if len(set(names)) < len(names) or len(set(ports)) < len(ports):
            problem = "--board names the same board or port twice"
            raise ConfigError(problem, remedy="Give each board its own name and port")
        config = replace(config, boards=boards)
    for flag in ("listen", "connect"):
        for endpoint in getattr(args, flag):
            check_endpoint(endpoint, where=f"--{flag}")
    if args.connect:
        config = replace(config, zenoh=replace(config.zenoh, mode="client", connect=tuple(args.connect)))
    if args.listen:  # with --connect too: a router that links to another one
        config = replace(config, zenoh=replace(config.zenoh, mode="router", listen=tuple(args.listen)))
    if args.log_dir is not None:
        config = replace(config, log=replace(config.log, enabled=True, directory=args.log_dir))
    config = replace(config, log=log_options(config.log, args))
    if args.no_log:
        config = replace(config, log=replace(config.log, enabled=False))
    if args.security is not None:
        config = replace(config, security=replace(config.security, directory=args.security))
    if args.insecure:
        config = replace(config, security=replace(config.security, insecure=True))
    for name in VIEWS:
        if (listen := getattr(args, name)) is not None:
            config = replace(config, **{name: replace(getattr(config, name), listen=listen)})
    if args.opcua_rate is not None:
        config = replace(config, opcua=changed(config.opcua, "--opcua-rate", rate_hz=args.opcua_rate))
    return config


def _board(text: str, config: GatewayConfig) -> BoardConfig:
    """A board of the command line; where the file has one of that name, only its port changes."""
    from gateway.config import BoardConfig, boards_from_text

    table = boards_from_text(text)
    name = check_name(table["name"], what="--board")
    known = next((board for board in config.boards if board.name == name), None)
    return replace(known, port=table["port"]) if known else BoardConfig(name=name, port=table["port"])


def _plant(text: str, config: GatewayConfig) -> tuple[str, Path]:
    """Return board and file of a `--plant`, both of which must exist."""
    from protocol.campaign import load_stated_plant

    boards = [board.name for board in config.boards]
    name, equals, file = text.rpartition("=")
    if not equals and len(boards) == 1:
        name = boards[0]
    if name not in boards:
        problem = f"--plant {text}: {name or 'nothing'} is not the name of a board"
        raise ConfigError(problem, remedy=f"Give one of {', '.join(boards)}=FILE")
    load_stated_plant(Path(file))
    return name, Path(file)


def run(args: argparse.Namespace) -> int:
    """Serve until SIGTERM or SIGINT."""
    if args.print_config:
        from gateway.config import documented_toml

        print(documented_toml())
        return 0
    from gateway import daemon  # importing zenoh and foxglove is slow, and --print-config does not need them
    from gateway.bus.plant_cards import state_now
    from gateway.processes.supervisor import running
    from gateway.views.launch import views_for

    config = configuration(args)
    plants = [_plant(text, config) for text in args.plant]
    views = views_for(config)
    if args.check:
        daemon.check(config)
        print(f"{len(config.boards)} boards: {', '.join(f'{b.name} at {b.port}' for b in config.boards)}")
        return 0
    for board, file in plants:
        for objection in state_now(config, board, file, login_name("command line")):
            print(f"board51 gateway: --plant {file}: {objection.key}: {objection.text}", file=sys.stderr)
    with running(views) if views else nullcontext():
        return daemon.serve(config)
