"""The gateway's configuration: TOML in, frozen dataclasses out, checked against their own annotations.

Every key has a type, a unit, a default, bounds and a sentence; `board51 gateway --print-config` writes a commented file
from them.  Unknown keys are errors: a typo must not silently leave a default in force.

Environment: BOARD51_<SECTION>_<KEY> overrides a key outside [[board]] (BOARD51_LOG_DIRECTORY=/data/logs), and
BOARD51_BOARDS="rig1=/dev/ttyUSB0,rig2=socket://10.0.0.5:4001" replaces the boards; compose and systemd use these.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import MISSING, dataclass, field, fields, replace
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal, get_args, get_origin

from pydantic import AfterValidator, Field
from pydantic.fields import FieldInfo

from protocol.bus.endpoint import DEFAULT_ENDPOINT, check_endpoint
from protocol.bus.topics import DEFAULT_SITE, check_name
from protocol.checked import Flag, Keys, Number, RuleError, Whole, bounds, checked, key, keys_of, plain_of, rule
from protocol.errors import ConfigError
from protocol.files import parse_toml, read_small

Name = Annotated[str, rule(partial(check_name, what=""))]
Endpoint = Annotated[str, rule(partial(check_endpoint, where=""))]


def _room(limits: LimitsConfig) -> LimitsConfig:
    if limits.x_ref_min_m >= limits.x_ref_max_m:
        raise RuleError(
            f": x_ref_min_m {limits.x_ref_min_m} is not below x_ref_max_m {limits.x_ref_max_m}",
            remedy="Give x_ref_min_m below x_ref_max_m",
        )
    return limits


def _patient(board: BoardConfig) -> BoardConfig:
    if board.host_loss_timeout_s < board.limits.host_loss_min_s:
        raise RuleError(
            f": host_loss_timeout_s {board.host_loss_timeout_s:g} is below host_loss_min_s"
            f" {board.limits.host_loss_min_s:g}: on a busy computer the gateway is sometimes silent for longer, and"
            " the board would act",
            remedy="Give a longer one; if this computer is never late, set host_loss_min_s in [board.limits]",
        )
    return board


def _different(boards: tuple[BoardConfig, ...]) -> tuple[BoardConfig, ...]:
    for what, values in (("name", [board.name for board in boards]), ("port", [board.port for board in boards])):
        twice = next((value for value in values if values.count(value) > 1), None)
        if twice is not None:
            raise RuleError(f": two boards have the {what} {twice!r}", remedy=f"Give each board its own {what}")
    return boards


def _reaches(zenoh: ZenohConfig) -> ZenohConfig:
    if zenoh.mode == "client" and not zenoh.connect:
        raise RuleError(": mode client without connect", remedy='Add connect = ["tcp/HOST:7447"]')
    return zenoh


@dataclass(frozen=True, kw_only=True)
class LimitsConfig(Keys):
    """The limits of commands, at most those of the board; checked before a command is sent."""

    x_ref_min_m: Annotated[Number, key("lowest reference [m]", 0.0, 0.1)] = 0.3e-3
    x_ref_max_m: Annotated[Number, key("highest reference [m]", 0.0, 0.1)] = 5.2e-3
    x_ref_step_m: Annotated[Number, key("largest jump of the reference at once [m]", 0.0, 0.1)] = 2.5e-3
    x_ref_slew_m_s: Annotated[Number, key("rate at which the allowance for jumps refills [m/s]", 1e-6, 100.0)] = 20e-3
    u_max_v: Annotated[Number, key("largest u_c of an excitation [V]", 0.0, 100.0)] = 5.0
    gain_max: Annotated[Number, key("largest magnitude of any gain, SI", 0.0)] = 1e6
    commands_per_s: Annotated[
        Number, key("commands per second and board; STOP is never refused for this [1/s]", 0.1, 1000.0)
    ] = 50.0
    host_loss_min_s: Annotated[
        Number,
        key(
            "shortest host-loss time-out; less only on a computer that is never late (gateway/README.md, Host loss)"
            " [s]",
            0.05,
            60.0,
        ),
    ] = 1.0
    excitation_max_s: Annotated[Number, key("longest excitation; 0: no bound, endless ones too [s]", 0.0, 1e6)] = 600.0


@dataclass(frozen=True, kw_only=True)
class BoardConfig(Keys):
    """A board: `[[board]]`."""

    name: Annotated[Name, key("chunk of the key and of file names: lower-case letters, digits, - and _")]
    port: Annotated[
        str,
        key(
            "pyserial URL: /dev/ttyUSB0, socket://host:port, rfc2217://...; "
            "a pattern such as /dev/serial/by-id/*Board51* finds the adapter under any name"
        ),
    ]
    baud: Annotated[Whole, key("speed of the UART; sockets and ptys ignore it [bit/s]", 300, 4_000_000)] = 115200
    board_id: Annotated[Whole, key("refuse any board with another serial number; 0 accepts any", 0, 0xFFFFFFFF)] = 0
    stream_divider: Annotated[Whole, key("ask the board for every n-th tick", 1, 1000)] = 1
    host_loss: Annotated[
        Literal["keep", "coil-off", "hold"], key("action of the board when this gateway falls silent")
    ] = "coil-off"
    host_loss_timeout_s: Annotated[
        Number, key("time without a frame from the gateway before the board acts [s]", 0.05, 60.0)
    ] = 1.0
    command_timeout_s: Annotated[Number, key("wait for an answer before repeating [s]", 0.02, 10.0)] = 0.1
    command_retries: Annotated[Whole, key("repetitions before giving up", 0, 20)] = 4
    stale_s: Annotated[Number, key("no valid frame for this long: the link is silent [s]", 0.1, 60.0)] = 1.0
    reconnect_s: Annotated[Number, key("time between attempts to open the port [s]", 0.05, 60.0)] = 0.5
    plant: Annotated[
        str,
        key(
            "TOML file with the [plant] of this rig: ball, travel, x_max; empty: as stated over the bus, of which the"
            " newer one counts"
        ),
    ] = ""
    limits: Annotated[LimitsConfig, AfterValidator(_room)] = field(default_factory=LimitsConfig)


@dataclass(frozen=True, kw_only=True)
class ZenohConfig(Keys):
    """The bus: `[zenoh]`."""

    mode: Annotated[
        Literal["router", "client"],
        key("router: this process is the router, nothing to install; client: connect to one elsewhere"),
    ] = "router"
    listen: Annotated[tuple[Endpoint, ...], key("endpoints to open (mode router)")] = (DEFAULT_ENDPOINT,)
    connect: Annotated[tuple[Endpoint, ...], key("endpoints to reach (mode client)")] = ()
    queue: Annotated[Whole, key("samples that may wait for the bus; the oldest is dropped and counted", 64, 10**7)] = (
        8192
    )


@dataclass(frozen=True, kw_only=True)
class LogConfig(Keys):
    """The MCAP log: `[log]`."""

    enabled: Annotated[Flag, key("write a log")] = True
    directory: Annotated[str, key("folder of the logs; made if absent")] = "logs"
    prefix: Annotated[str, key("start of the file names")] = "board51"
    rotate_bytes: Annotated[Whole, key("begin a new part at this size [B]", 100_000, 10**12)] = 256_000_000
    rotate_s: Annotated[Number, key("begin a new part after this time [s]", 1.0, 1e6)] = 3600.0
    flush_s: Annotated[
        Number,
        key("longest time until data is handed to the operating system; kill -9 may lose as much [s]", 0.01, 0.2),
    ] = 0.1
    queue: Annotated[
        Whole, key("messages that may wait for the disk; the oldest is dropped and counted", 64, 10**7)
    ] = 50_000
    min_free_bytes: Annotated[Whole, key("stop logging when less is free, resume when it is back [B]", 0, 10**13)] = (
        50_000_000
    )
    keep_days: Annotated[
        Number, key("delete own logs that are older, when a part begins; 0: keep all [days]", 0.0, 1e5)
    ] = 0.0
    keep_gb: Annotated[
        Number, key("delete the oldest own logs beyond this total size, when a part begins; 0: keep all [GB]", 0.0, 1e6)
    ] = 0.0
    keep_unarchived: Annotated[Flag, key("do not delete logs that `board51 logs archive` has not copied yet")] = False
    compression: Annotated[Literal["lz4", "zstd", "none"], key("of the chunks")] = "lz4"
    raw: Annotated[Flag, key("log the bytes of the UART too; `replay --bytes` needs them")] = True


@dataclass(frozen=True, kw_only=True)
class SecurityConfig(Keys):
    """The access control: `[security]`."""

    directory: Annotated[str, key("folder that `board51 security init` made; empty: the bus is not guarded")] = ""
    insecure: Annotated[Flag, key("open listeners to the network without protection all the same")] = False


@dataclass(frozen=True, kw_only=True)
class OpcuaConfig(Keys):
    """The OPC UA server: `[opcua]`."""

    listen: Annotated[
        str, key("address of the server, a process of its own, e.g. 127.0.0.1:4840; empty: not at all")
    ] = ""
    rate_hz: Annotated[Number, key("values per second of each variable, with min and max [Hz]", 10.0, 50.0)] = 20.0
    history_s: Annotated[Number, key("how far HistoryRead goes back [s]", 10.0, 3600.0)] = 300.0


@dataclass(frozen=True, kw_only=True)
class HmiConfig(Keys):
    """The web page: `[hmi]`."""

    listen: Annotated[str, key("serve here, e.g. 127.0.0.1:8051; empty: not at all")] = ""


@dataclass(frozen=True, kw_only=True)
class FoxgloveConfig(Keys):
    """The live Foxglove WebSocket: `[foxglove]`."""

    listen: Annotated[str, key("serve here, e.g. 127.0.0.1:8765; empty: not at all")] = ""


@dataclass(frozen=True, kw_only=True)
class GatewayConfig(Keys):
    """The whole file."""

    site: Annotated[Name, key("first chunk of every key")] = DEFAULT_SITE
    boards: Annotated[
        tuple[Annotated[BoardConfig, AfterValidator(_patient)], ...], AfterValidator(_different), Field(alias="board")
    ] = ()
    zenoh: Annotated[ZenohConfig, AfterValidator(_reaches)] = field(default_factory=ZenohConfig)
    log: LogConfig = field(default_factory=LogConfig)
    security: SecurityConfig = field(default_factory=SecurityConfig)
    opcua: OpcuaConfig = field(default_factory=OpcuaConfig)
    hmi: HmiConfig = field(default_factory=HmiConfig)
    foxglove: FoxgloveConfig = field(default_factory=FoxgloveConfig)


def load_config(path: Path | None, environment: Mapping[str, str] = os.environ) -> GatewayConfig:
    """Read a TOML file (None: defaults), apply the environment, check everything.

    Raises:
        ConfigError: names the file or the variable, the key, the value and what is allowed.
    """
    where = "environment" if path is None else str(path)
    table: dict[str, Any] = {}
    if path is not None:
        remedy = "Give an existing file; `board51 gateway --print-config` writes one"
        table = parse_toml(read_small(path, remedy=remedy, error=ConfigError), where=where)
    _apply_environment(table, environment)
    config: GatewayConfig = checked(GatewayConfig, table, where=where)
    return config


def changed(section: Any, where: str, **values: object) -> Any:
    """Return `section` with other values, each checked like a key of the file; `where` is named in the ConfigError."""
    known = keys_of(type(section))
    return replace(section, **{name: checked(known[name], value, where=where) for name, value in values.items()})


def _apply_environment(table: dict[str, Any], environment: Mapping[str, str]) -> None:
    if "BOARD51_SITE" in environment:
        table["site"] = environment["BOARD51_SITE"]
    if "BOARD51_BOARDS" in environment:
        table["board"] = [boards_from_text(item) for item in environment["BOARD51_BOARDS"].split(",") if item.strip()]
    for section, kind in _sections().items():
        for name, hint in keys_of(kind).items():
            variable = f"BOARD51_{section}_{name}".upper()
            text = environment.get(variable)
            values = table.setdefault(section, {}) if text is not None else None
            if text is not None and isinstance(values, dict):
                several = "tuple" in str(hint)
                items = [item.strip() for item in text.split(",") if item.strip()]
                values[name] = items if several else checked(hint, text, where=variable, from_text=True)


def boards_from_text(item: str) -> dict[str, str]:
    """Return `rig1=/dev/ttyUSB0` as a `[[board]]` table."""
    name, equals, port = item.strip().partition("=")
    if not equals or not name or not port:
        raise ConfigError(f"{item.strip()!r} does not name a board", remedy="Write NAME=PORT, e.g. rig1=/dev/ttyUSB0")
    return {"name": name, "port": port}


def _sections() -> dict[str, type[Any]]:
    """Return every table of the file except [[board]], by name."""
    return {f.name: type(f.default_factory()) for f in fields(GatewayConfig) if f.default_factory is not MISSING}


def documented_toml() -> str:
    """A complete file with every key, its default, unit and bounds: for `--print-config` and the README."""
    lines = [
        "# Board51 gateway.  Every key is optional but name and port of a board; values shown are the defaults.",
        "",
        *_documented(GatewayConfig),
        "",
    ]
    sections: dict[str, type[Any]] = {"[[board]]": BoardConfig, "[board.limits]": LimitsConfig}
    for title, kind in (sections | {f"[{name}]": kind for name, kind in _sections().items()}).items():
        lines += [title, *_documented(kind), ""]
    return "\n".join(lines)


def _documented(kind: type[Any]) -> list[str]:
    lines: list[str] = []
    for f, hint in zip(fields(kind), keys_of(kind).values(), strict=True):
        description = FieldInfo.from_annotation(hint).description
        if description:
            default = {"name": "rig1", "port": "/dev/ttyUSB0"}[f.name] if f.default is MISSING else f.default
            lines += [f"# {description}{_allowed(hint)}", f"{f.name} = {_toml(default)}"]
    return lines


def _allowed(hint: Any) -> str:
    low, high = bounds(hint)
    if low is not None:
        return f" ({low} .. {high})" if high is not None else f" ({low} or more)"
    plain = plain_of(hint)
    return f" ({' | '.join(get_args(plain))})" if get_origin(plain) is Literal else ""


def _toml(value: object) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, tuple):
        return "[" + ", ".join(f'"{v}"' for v in value) + "]"
    return f'"{value}"' if isinstance(value, str) else repr(value)
