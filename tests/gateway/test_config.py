"""The configuration: what is written is what is in force, and every mistake is named with its place."""

from __future__ import annotations

import tomllib
from pathlib import Path

import pytest

from gateway.config import BoardConfig, GatewayConfig, documented_toml, load_config
from protocol.errors import ConfigError


def _load(tmp_path: Path, text: str, **environment: str) -> GatewayConfig:
    path = tmp_path / "gateway.toml"
    path.write_text(text, encoding="utf-8")
    return load_config(path, environment)


def test_the_documented_file_holds_exactly_the_defaults(tmp_path: Path) -> None:
    config = _load(tmp_path, documented_toml())

    assert config == GatewayConfig(boards=(BoardConfig(name="rig1", port="/dev/ttyUSB0"),))


def test_every_key_is_documented_with_a_sentence() -> None:
    lines = documented_toml().splitlines()

    keys = [n for n, line in enumerate(lines) if " = " in line and not line.startswith("#")]

    assert len(keys) >= 30
    assert all(lines[n - 1].startswith("# ") for n in keys)


def test_the_environment_overrides_the_file(tmp_path: Path) -> None:
    environment = {
        "BOARD51_SITE": "lab",
        "BOARD51_LOG_DIRECTORY": "/data",
        "BOARD51_LOG_RAW": "false",
        "BOARD51_ZENOH_LISTEN": "tcp/0.0.0.0:7447,tcp/[::1]:7448",
        "BOARD51_BOARDS": "a=/dev/ttyS0,b=socket://host:4001",
    }

    config = _load(
        tmp_path, '[[board]]\nname = "x"\nport = "y"\n[log]\ndirectory = "here"\nrotate_s = 5', **environment
    )

    assert config.site == "lab"
    assert config.log.directory == "/data"
    assert config.log.raw is False
    assert config.log.rotate_s == 5.0
    assert config.zenoh.listen == ("tcp/0.0.0.0:7447", "tcp/[::1]:7448")
    assert [(b.name, b.port) for b in config.boards] == [("a", "/dev/ttyS0"), ("b", "socket://host:4001")]


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ("x", "not TOML"),
        ("colour = 1", ": colour = 1 is not a key. Remove it; the keys are site, board, zenoh"),
        ("site = 3", ": site = 3 is not text. Give text: first chunk of every key"),
        ('site = "a/b"', ": site 'a/b' is not a name"),
        ("[board]\nname = 'a'", ": board = {'name': 'a'} is not a list of tables. Add at least one [[board]]"),
        ('[[board]]\nname = "a"', ": board 1 (a).port is missing (pyserial URL"),
        (
            '[[board]]\nname = "a"\nport = "p"\nbaud = 1',
            ": board 1 (a).baud = 1 is not in 300 .. 4000000. Give 300 .. 4000000: speed of the UART",
        ),
        ('[[board]]\nname = "a"\nport = "p"\nbaud = true', ".baud = True is not a whole number"),
        (
            '[[board]]\nname = "a"\nport = "p"\nhost_loss = "panic"',
            ".host_loss = 'panic' is not one of keep | coil-off | hold. Choose one of them",
        ),
        (
            '[[board]]\nname = "a"\nport = "p"\n[board.limits]\nx_ref_min_m = 0.006',
            ": board 1 (a).limits: x_ref_min_m 0.006 is not below x_ref_max_m 0.0052",
        ),
        (
            '[[board]]\nname = "a"\nport = "p"\nhost_loss_timeout_s = 0.3',
            ": board 1 (a): host_loss_timeout_s 0.3 is below host_loss_min_s 1",
        ),
        (
            '[[board]]\nname = "a"\nport = "p"\n[board.limits]\nx_ref_min_mm = 1',
            ".limits.x_ref_min_mm = 1 is not a key. Did you mean x_ref_min_m.",
        ),
        ('[[board]]\nname = "a"\nport = "p"\n[[board]]\nname = "a"\nport = "q"', "two boards have the name 'a'"),
        ('[[board]]\nname = "a"\nport = "p"\n[[board]]\nname = "b"\nport = "p"', "two boards have the port 'p'"),
        ('[log]\nrotate_s = "1h"', ": log.rotate_s = '1h' is not a finite number"),
        ("[log]\nflush_s = nan", ": log.flush_s = nan is not a finite number"),
        ("log = 3", ": log = 3 is not a table. Add [log]"),
        ('[zenoh]\nlisten = ["7447"]', ": zenoh.listen 1: '7447' is not a zenoh endpoint"),
        ('[zenoh]\nmode = "client"', ": zenoh: mode client without connect"),
    ],
)
def test_a_mistake_is_named_with_its_place(tmp_path: Path, text: str, named: str) -> None:
    with pytest.raises(ConfigError) as error:
        _load(tmp_path, text)

    assert named in str(error.value)
    assert "gateway.toml" in str(error.value)


@pytest.mark.parametrize(
    ("variable", "value"),
    [("BOARD51_LOG_ROTATE_S", "soon"), ("BOARD51_LOG_RAW", "maybe"), ("BOARD51_BOARDS", "/dev/ttyUSB0")],
)
def test_a_bad_environment_variable_is_an_error(tmp_path: Path, variable: str, value: str) -> None:
    with pytest.raises(ConfigError) as error:
        _load(tmp_path, "", **{variable: value})

    assert value in str(error.value)
    assert variable == "BOARD51_BOARDS" or str(error.value).startswith(f"{variable} = ")


def test_an_absent_file_says_how_to_get_one(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="--print-config"):
        load_config(tmp_path / "no.toml", {})


def test_a_computer_that_is_never_late_may_hold_a_shorter_host_loss(tmp_path: Path) -> None:
    text = '[[board]]\nname = "a"\nport = "p"\nhost_loss_timeout_s = 0.1\n[board.limits]\nhost_loss_min_s = 0.1\n'

    assert _load(tmp_path, text).boards[0].host_loss_timeout_s == 0.1


def test_the_documented_file_is_toml() -> None:
    assert set(tomllib.loads(documented_toml())) == {
        "site", "board", "zenoh", "log", "security", "opcua", "hmi", "foxglove",
    }  # fmt: skip


def test_the_views_are_configured_like_the_rest(tmp_path: Path) -> None:
    text = '[opcua]\nlisten = "127.0.0.1:4840"\nrate_hz = 50\n[foxglove]\nlisten = "127.0.0.1:8765"\n'

    config = _load(tmp_path, text, BOARD51_OPCUA_RATE_HZ="25", BOARD51_HMI_LISTEN="127.0.0.1:8051")

    assert (config.opcua.listen, config.opcua.rate_hz) == ("127.0.0.1:4840", 25.0)
    assert (config.hmi.listen, config.foxglove.listen) == ("127.0.0.1:8051", "127.0.0.1:8765")
    with pytest.raises(ConfigError, match=r"opcua.rate_hz = 51 is not in 10 .. 50"):
        _load(tmp_path, "[opcua]\nrate_hz = 51\n")
