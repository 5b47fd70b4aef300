"""The gateway's configuration: one table of keys, TOML in, frozen dataclasses out.

Every key has a type, a unit, a default, bounds and a sentence; `board51 gateway --print-config` writes a commented file
from the same table.  Unknown keys are errors: a typo must not silently leave a default in force.

Environment: BOARD51_<SECTION>_<KEY> overrides a key outside [[board]] (BOARD51_LOG_DIRECTORY=/data/logs), and
BOARD51_BOARDS="rig1=/dev/ttyUSB0,rig2=socket://10.0.0.5:4001" replaces the boards; compose and systemd use these.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import MISSING, Field, dataclass, field, fields, replace
from pathlib import Path
from typing import Any

from protocol.bus.endpoint import DEFAULT_ENDPOINT, check_endpoint
from protocol.bus.topics import DEFAULT_SITE, check_name
from protocol.errors import ConfigError
from protocol.files import parse_toml, read_small
from protocol.toml_table import shown


def _key(
    default: Any,
    about: str,
    *,
    unit: str = "",
    low: float | None = None,
    high: float | None = None,
    choices: tuple[str, ...] = (),
) -> Any:
    metadata = {"about": about, "unit": unit, "low": low, "high": high, "choices": choices}
    if default is MISSING:
        return field(metadata=metadata)
    if isinstance(default, list):
        return field(default_factory=lambda: tuple(default), metadata=metadata)
    return field(default=default, metadata=metadata)


@dataclass(frozen=True, kw_only=True)
class LimitsConfig:
    """What may be commanded, tighter than or equal to what the board allows; checked before the wire."""

    x_ref_min_m: float = _key(0.3e-3, "lowest reference", unit="m", low=0.0, high=0.1)
    x_ref_max_m: float = _key(5.2e-3, "highest reference", unit="m", low=0.0, high=0.1)
    x_ref_step_m: float = _key(2.5e-3, "largest jump of the reference at once", unit="m", low=0.0, high=0.1)
    x_ref_slew_m_s: float = _key(
        20e-3, "rate at which the allowance for jumps refills", unit="m/s", low=1e-6, high=100.0
    )
    u_max_v: float = _key(5.0, "largest u_c of an excitation", unit="V", low=0.0, high=100.0)
    gain_max: float = _key(1e6, "largest magnitude of any gain, SI", low=0.0)
    commands_per_s: float = _key(
        50.0, "commands per second and board; STOP is never refused for this", unit="1/s", low=0.1, high=1000.0
    )
    host_loss_min_s: float = _key(
        1.0,
        "shortest host-loss time-out; less only on a computer that is never late (gateway/README.md, Host loss)",
        unit="s",
        low=0.05,
        high=60.0,
    )
    excitation_max_s: float = _key(
        600.0, "longest excitation; 0: no bound, endless ones too", unit="s", low=0.0, high=1e6
    )


@dataclass(frozen=True, kw_only=True)
class BoardConfig:
    """One board: `[[board]]`."""

    name: str = _key(MISSING, "chunk of the key and of file names: lower-case letters, digits, - and _")
    port: str = _key(
        MISSING,
        "pyserial URL: /dev/ttyUSB0, socket://host:port, rfc2217://...; "
        "a glob such as /dev/serial/by-id/*Board51* takes whichever name the adapter comes back under",
    )
    baud: int = _key(115200, "of the UART; sockets and ptys ignore it", unit="bit/s", low=300, high=4_000_000)
    board_id: int = _key(0, "refuse any board with another serial number; 0 takes any", low=0, high=0xFFFFFFFF)
    stream_divider: int = _key(1, "ask the board for every n-th tick", low=1, high=1000)
    host_loss: str = _key(
        "coil-off", "what the board does when this gateway is gone", choices=("keep", "coil-off", "hold")
    )
    host_loss_timeout_s: float = _key(1.0, "after how long", unit="s", low=0.05, high=60.0)
    command_timeout_s: float = _key(0.1, "wait for an answer before repeating", unit="s", low=0.02, high=10.0)
    command_retries: int = _key(4, "repetitions before giving up", low=0, high=20)
    stale_s: float = _key(1.0, "no valid frame for this long: the link is silent", unit="s", low=0.1, high=60.0)
    reconnect_s: float = _key(0.5, "between attempts to open the port", unit="s", low=0.05, high=60.0)
    limits: LimitsConfig = field(default_factory=LimitsConfig)


@dataclass(frozen=True, kw_only=True)
class ZenohConfig:
    """The bus: `[zenoh]`."""

    mode: str = _key(
        "router",
        "router: this process is the router, nothing to install; client: connect to one elsewhere",
        choices=("router", "client"),
    )
    listen: tuple[str, ...] = _key([DEFAULT_ENDPOINT], "endpoints to open (mode router)")
    connect: tuple[str, ...] = _key([], "endpoints to reach (mode client)")
    queue: int = _key(8192, "samples that may wait for the bus; the oldest is dropped and counted", low=64, high=10**7)


@dataclass(frozen=True, kw_only=True)
class LogConfig:
    """The MCAP log: `[log]`."""

    enabled: bool = _key(True, "write a log")
    directory: str = _key("logs", "where; made if absent")
    prefix: str = _key("board51", "start of the file names")
    rotate_bytes: int = _key(256_000_000, "begin a new part at this size", unit="B", low=100_000, high=10**12)
    rotate_s: float = _key(3600.0, "and after this time", unit="s", low=1.0, high=1e6)
    flush_s: float = _key(
        0.1, "hand everything to the operating system; what kill -9 may cost", unit="s", low=0.01, high=0.2
    )
    queue: int = _key(
        50_000, "messages that may wait for the disk; the oldest is dropped and counted", low=64, high=10**7
    )
    min_free_bytes: int = _key(
        50_000_000, "stop logging when less is free, resume when it is back", unit="B", low=0, high=10**13
    )
    compression: str = _key("lz4", "of the chunks", choices=("lz4", "zstd", "none"))
    raw: bool = _key(True, "log the bytes of the UART too")


@dataclass(frozen=True, kw_only=True)
class SecurityConfig:
    """Who may do what: `[security]`."""

    directory: str = _key("", "folder that `board51 security init` made; empty: the bus is not guarded")
    insecure: bool = _key(False, "open listeners to the network without protection all the same")


@dataclass(frozen=True, kw_only=True)
class OpcuaConfig:
    """The OPC UA server: `[opcua]`."""

    listen: str = _key("", "serve here, as a process beside the gateway, e.g. 127.0.0.1:4840; empty: not at all")
    rate_hz: float = _key(20.0, "values per second of each variable, with min and max", unit="Hz", low=10.0, high=50.0)
    history_s: float = _key(300.0, "how far HistoryRead goes back", unit="s", low=10.0, high=3600.0)


@dataclass(frozen=True, kw_only=True)
class HmiConfig:
    """The web page: `[hmi]`."""

    listen: str = _key("", "serve here, e.g. 127.0.0.1:8051; empty: not at all")


@dataclass(frozen=True, kw_only=True)
class FoxgloveConfig:
    """The live Foxglove WebSocket: `[foxglove]`."""

    listen: str = _key("", "serve here, e.g. 127.0.0.1:8765; empty: not at all")


@dataclass(frozen=True, kw_only=True)
class GatewayConfig:
    """The whole file."""

    site: str = _key(DEFAULT_SITE, "first chunk of every key")
    boards: tuple[BoardConfig, ...] = ()
    zenoh: ZenohConfig = field(default_factory=ZenohConfig)
    log: LogConfig = field(default_factory=LogConfig)
    security: SecurityConfig = field(default_factory=SecurityConfig)
    opcua: OpcuaConfig = field(default_factory=OpcuaConfig)
    hmi: HmiConfig = field(default_factory=HmiConfig)
    foxglove: FoxgloveConfig = field(default_factory=FoxgloveConfig)


_SECTIONS: dict[str, type[Any]] = {
    "zenoh": ZenohConfig, "log": LogConfig, "security": SecurityConfig,
    "opcua": OpcuaConfig, "hmi": HmiConfig, "foxglove": FoxgloveConfig,
}  # fmt: skip


def load_config(path: Path | None, environment: Mapping[str, str] = os.environ) -> GatewayConfig:
    """Read a TOML file (None: defaults), apply the environment, check everything.

    Raises:
        ConfigError: names the file, the key, the value and what is allowed.
    """
    where = "environment" if path is None else str(path)
    table: dict[str, Any] = {}
    if path is not None:
        remedy = "Give an existing file; `board51 gateway --print-config` writes one"
        table = parse_toml(read_small(path, remedy=remedy, error=ConfigError), where=str(path))
    _apply_environment(table, environment)
    unknown = table.keys() - {"site", "board", *_SECTIONS}
    if unknown:
        raise ConfigError(
            f"{where}: unknown key {sorted(unknown)[0]!r}",
            remedy=f"Known: site, [[board]], {', '.join(f'[{name}]' for name in _SECTIONS)}",
        )
    raw_boards = table.get("board", [])
    if not isinstance(raw_boards, list) or not all(isinstance(b, dict) for b in raw_boards):
        raise ConfigError(f"{where}: board is not a list of tables", remedy="Write each board under its own [[board]]")
    config = GatewayConfig(
        site=check_name(_value(table.get("site", DEFAULT_SITE), "str", f"{where}: site"), what=f"{where}: site"),
        boards=tuple(_board(b, f"{where}: [[board]] {n}") for n, b in enumerate(raw_boards, 1)),
        **{name: _section(kind, table.get(name, {}), f"{where}: [{name}]") for name, kind in _SECTIONS.items()},
    )
    _cross_check(config, where)
    return config


def _board(table: dict[str, Any], where: str) -> BoardConfig:
    limits = _section(LimitsConfig, table.get("limits", {}), f"{where} [limits]")
    board: BoardConfig = _section(BoardConfig, {k: v for k, v in table.items() if k != "limits"}, where, limits=limits)
    check_name(board.name, what=f"{where} name")
    if limits.x_ref_min_m >= limits.x_ref_max_m:
        raise ConfigError(
            f"{where}: x_ref_min_m {limits.x_ref_min_m} is not below x_ref_max_m {limits.x_ref_max_m}",
            remedy="Give a range with room in it",
        )
    if board.host_loss_timeout_s < limits.host_loss_min_s:
        raise ConfigError(
            f"{where}: host_loss_timeout_s {board.host_loss_timeout_s:g} is below host_loss_min_s"
            f" {limits.host_loss_min_s:g}: on a busy computer the gateway itself is silent for longer now and then,"
            " and the board would act",
            remedy="Give a longer one; where this computer is never late, set host_loss_min_s in [board.limits]",
        )
    return board


def _section(kind: type[Any], table: object, where: str, **done: Any) -> Any:
    if not isinstance(table, dict):
        raise ConfigError(f"{where} is not a table", remedy="Write it as a TOML section")
    known = {f.name: f for f in fields(kind) if f.metadata}
    for name in table:
        if name not in known:
            raise ConfigError(f"{where}: unknown key {name!r}", remedy=f"Known: {', '.join(known)}")
    for name, f in known.items():
        if name in table:
            done[name] = _checked(f, table[name], f"{where} {name}")
        elif f.default is MISSING and f.default_factory is MISSING:
            raise ConfigError(f"{where}: {name} is missing", remedy=f"Add {name} = ...: {f.metadata['about']}")
    return kind(**done)


def _value(value: object, kind: str, where: str) -> Any:
    """`value` as the annotated type, else ConfigError; an int is a good float, a bool is not a good int."""
    good = {
        "str": isinstance(value, str),
        "bool": isinstance(value, bool),
        "int": isinstance(value, int) and not isinstance(value, bool),
        "float": isinstance(value, int | float) and not isinstance(value, bool),
        "tuple[str, ...]": isinstance(value, list) and all(isinstance(v, str) for v in value),
    }[kind]
    if not good:
        wanted = {"str": "a string", "bool": "true or false", "int": "a whole number", "float": "a number"}
        raise ConfigError(
            f"{where} = {shown(value)} has the wrong type", remedy=f"Give {wanted.get(kind, 'a list of strings')}"
        )
    if kind == "float":
        return float(value)  # type: ignore[arg-type]  # checked above
    return tuple(value) if isinstance(value, list) else value


def _checked(f: Field[Any], value: object, where: str) -> Any:
    unit, low, high, choices = (f.metadata[k] for k in ("unit", "low", "high", "choices"))
    good = _value(value, str(f.type), where)
    if choices and good not in choices:
        raise ConfigError(f"{where} = {shown(good)} is not a choice", remedy=f"Give one of {', '.join(choices)}")
    if (low is not None and not good >= low) or (high is not None and not good <= high):
        raise ConfigError(f"{where} = {good} is out of bounds", remedy=f"Give {_range(low, high)} {unit}".rstrip())
    return good


def changed(section: Any, where: str, **values: object) -> Any:
    """`section` with other values, each checked like a key of the file; `where` is named in the ConfigError."""
    known = {f.name: f for f in fields(section)}
    return replace(section, **{name: _checked(known[name], value, where) for name, value in values.items()})


def _range(low: float | None, high: float | None) -> str:
    return f"{low if low is not None else '-inf'} .. {high if high is not None else 'inf'}"


def _cross_check(config: GatewayConfig, where: str) -> None:
    names = [board.name for board in config.boards]
    ports = [board.port for board in config.boards]
    for what, values in (("name", names), ("port", ports)):
        twice = sorted({v for v in values if values.count(v) > 1})
        if twice:
            raise ConfigError(
                f"{where}: two boards have the {what} {twice[0]!r}", remedy=f"Give each board its own {what}"
            )
    for key, endpoints in (("listen", config.zenoh.listen), ("connect", config.zenoh.connect)):
        for endpoint in endpoints:
            check_endpoint(endpoint, where=f"{where}: [zenoh] {key}")
    if config.zenoh.mode == "client" and not config.zenoh.connect:
        raise ConfigError(f"{where}: [zenoh] mode client without connect", remedy='Add connect = ["tcp/HOST:7447"]')


def _apply_environment(table: dict[str, Any], environment: Mapping[str, str]) -> None:
    if "BOARD51_SITE" in environment:
        table["site"] = environment["BOARD51_SITE"]
    if "BOARD51_BOARDS" in environment:
        table["board"] = [boards_from_text(item) for item in environment["BOARD51_BOARDS"].split(",") if item.strip()]
    for section, kind in _SECTIONS.items():
        for f in fields(kind):
            name = f"BOARD51_{section}_{f.name}".upper()
            if name in environment:
                table.setdefault(section, {})[f.name] = _from_text(environment[name], str(f.type), name)


def boards_from_text(item: str) -> dict[str, str]:
    """`rig1=/dev/ttyUSB0` as a `[[board]]` table."""
    name, equals, port = item.strip().partition("=")
    if not equals or not name or not port:
        raise ConfigError(f"{item.strip()!r} does not name a board", remedy="Write NAME=PORT, e.g. rig1=/dev/ttyUSB0")
    return {"name": name, "port": port}


def _from_text(text: str, kind: str, where: str) -> Any:
    try:
        if kind == "int":
            return int(text)
        if kind == "float":
            return float(text)
    except ValueError:
        raise ConfigError(f"{where}={text!r} is not a number", remedy="Give a number") from None
    if kind == "bool":
        if text.lower() not in ("true", "false", "1", "0"):
            raise ConfigError(f"{where}={text!r} is not a truth value", remedy="Give true or false")
        return text.lower() in ("true", "1")
    return [t.strip() for t in text.split(",") if t.strip()] if kind.startswith("tuple") else text


def documented_toml() -> str:
    """A complete file with every key, its default, unit and bounds: for `--print-config` and the README."""
    site = next(f for f in fields(GatewayConfig) if f.name == "site")
    lines = [
        "# Board51 gateway.  Every key is optional but name and port of a board; values shown are the defaults.",
        "",
    ]
    lines += [f"# {_about(site)}", f'site = "{DEFAULT_SITE}"', ""]
    sections: dict[str, type[Any]] = {"[[board]]": BoardConfig, "[board.limits]": LimitsConfig}
    for title, kind in (sections | {f"[{name}]": kind for name, kind in _SECTIONS.items()}).items():
        lines.append(title)
        for f in fields(kind):
            if not f.metadata:
                continue
            example = {"name": "rig1", "port": "/dev/ttyUSB0"}.get(f.name)
            default = f.default_factory() if f.default_factory is not MISSING else f.default
            lines += [f"# {_about(f)}", f"{f.name} = {_toml(default if example is None else example)}"]
        lines.append("")
    return "\n".join(lines)


def _about(f: Field[Any]) -> str:
    notes = [str(f.metadata["about"])]
    if f.metadata["unit"]:
        notes.append(f"[{f.metadata['unit']}]")
    if f.metadata["low"] is not None or f.metadata["high"] is not None:
        notes.append(f"({_range(f.metadata['low'], f.metadata['high'])})")
    if f.metadata["choices"]:
        notes.append(f"({' | '.join(f.metadata['choices'])})")
    return " ".join(notes)


def _toml(value: object) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, tuple):
        return "[" + ", ".join(f'"{v}"' for v in value) + "]"
    return f'"{value}"' if isinstance(value, str) else repr(value)
