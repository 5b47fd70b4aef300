"""The compose file: valid where the plug-in is, and the whole line running where an engine is."""

from __future__ import annotations

import argparse
import importlib
import json
import os
import shutil
import subprocess
import sys
import tomllib
import uuid
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
import yaml

import board51
from tests.harness.ports import free_port

ROOT = Path(__file__).parents[2]
SERVICES = {"router", "emulator", "gateway", "twin", "page"}
BASE, TTY, GUARDED = "docker-compose.yml", "gateway/tty.yml", "gateway/access/guarded.yml"
VARIANTS = ((BASE,), (BASE, TTY), (BASE, GUARDED), (BASE, TTY, GUARDED))


def _compose() -> list[str] | None:
    """`docker compose` or `docker-compose`, whichever is here."""
    if shutil.which("docker"):
        plugin = subprocess.run(["docker", "compose", "version"], capture_output=True, check=False)
        if plugin.returncode == 0:
            return ["docker", "compose"]
    return ["docker-compose"] if shutil.which("docker-compose") else None


@pytest.fixture(scope="module")
def compose() -> list[str]:
    command = _compose()
    if command is None:
        pytest.skip("neither `docker compose` nor `docker-compose` is installed")
    return command


@pytest.mark.parametrize("files", VARIANTS, ids=" ".join)
def test_the_compose_files_are_valid_and_say_which_services_run(compose: list[str], files: tuple[str, ...]) -> None:
    words = [word for file in files for word in ("-f", file)]

    process = subprocess.run([*compose, *words, "config"], cwd=ROOT, capture_output=True, text=True, check=False)

    assert process.returncode == 0, process.stderr
    # Version 1 also prints services of profiles that nobody asked for; version 2 leaves them out.
    merged: dict[str, dict[str, Any]] = yaml.safe_load(process.stdout)["services"]
    running = {name for name, service in merged.items() if not service.get("profiles")}
    assert running == (SERVICES - {"emulator"} if TTY in files else SERVICES)


def services(file: str) -> dict[str, dict[str, Any]]:
    content = yaml.safe_load((ROOT / file).read_text(encoding="utf-8"))
    return dict(content["services"])


def test_no_service_waits_for_the_emulator_which_a_real_board_replaces() -> None:
    waiting = {name: set(service.get("depends_on", {})) for name, service in services("docker-compose.yml").items()}

    assert not [name for name, dependencies in waiting.items() if "emulator" in dependencies]
    assert set.union(*waiting.values()) <= SERVICES


def test_a_tty_is_open_to_the_gateway_alone_and_the_emulator_stays_off() -> None:
    changes = services(TTY)

    gateway = changes.pop("gateway")
    assert changes == {"emulator": {"profiles": ["emulated"]}}
    (device,) = gateway["devices"]
    assert gateway["environment"] == {"BOARD51_BOARDS": f"rig1={device.rpartition(':')[2]}"}
    assert gateway["group_add"] == ["${BOARD51_TTY_GROUP:-20}"]
    assert not any({"devices", "group_add"} & set(service) for service in services("docker-compose.yml").values())


@pytest.mark.parametrize("file", [BASE, GUARDED])
def test_each_service_runs_a_command_that_is_one_and_is_healthy_when_its_port_listens(file: str) -> None:
    base = services(BASE)
    for name, service in services(file).items():
        command, *words = service["command"]
        parser = argparse.ArgumentParser(exit_on_error=False)
        importlib.import_module(board51.COMMANDS[command][0]).configure(parser)
        _, unknown = parser.parse_known_args(words)
        assert unknown == [], name
        ports = base[name].get("ports", [])
        assert all(mapping.startswith("127.0.0.1:") for mapping in ports), name
        for port in (int(mapping.rpartition(":")[2]) for mapping in ports):
            assert f":{port:04X} " in base[name]["healthcheck"]["test"][-1], name
            assert any(f":{port}" in word for word in words), name


def test_opcua_and_foxglove_run_where_they_are_asked_for() -> None:
    optional = {name: service["profiles"] for name, service in services(BASE).items() if "profiles" in service}

    assert optional == {"opcua": ["opcua"], "foxglove": ["foxglove"]}


def test_the_image_installs_what_runs_and_copies_what_is_there() -> None:
    lines = (ROOT / "Dockerfile").read_text(encoding="utf-8").splitlines()
    copied = [word for line in lines if line.startswith("COPY ") for word in line.split()[1:-1]]
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    packages = {pattern.rstrip("*") for pattern in project["tool"]["setuptools"]["packages"]["find"]["include"]}

    assert [word for word in copied if not (ROOT / word).exists()] == []
    assert set(copied) >= {"requirements-run.lock", "pyproject.toml", "README.md", "LICENSE", "board51.py", *packages}
    assert "requirements.lock" not in copied
    (install,) = (line for line in lines if "--require-hashes" in line)
    assert install.endswith("-r requirements-run.lock")


@dataclass(frozen=True)
class Stack:
    """The containers of one test."""

    compose: list[str]  # with files and project
    environment: dict[str, str]

    def run(self, *words: str) -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            [*self.compose, *words],
            cwd=ROOT, capture_output=True, text=True, check=False, env=self.environment, timeout=800,
        )  # fmt: skip

    def call(self, *words: str) -> str:
        process = self.run(*words)
        assert process.returncode == 0, f"{words}: {process.stdout[-2000:]}{process.stderr[-4000:]}"
        return process.stdout

    def board51(self, *words: str) -> str:
        """Run a command in the gateway's container."""
        return self.call("exec", "-T", "gateway", "board51", *words)


@pytest.fixture
def stack(compose: list[str], tmp_path: Path, request: pytest.FixtureRequest) -> Iterator[Stack]:
    engine = subprocess.run(["docker", "info"], capture_output=True, check=False)
    if engine.returncode != 0:
        pytest.skip("no Docker engine answers")
    image = subprocess.run(["docker", "image", "inspect", "python:3.11-slim"], capture_output=True, check=False)
    if image.returncode != 0:
        pulled = subprocess.run(["docker", "pull", "python:3.11-slim"], capture_output=True, check=False)
        if pulled.returncode != 0:
            pytest.skip("the base image python:3.11-slim is neither here nor to be had")
    free, page = str(free_port()), str(free_port())
    files = [word for file in getattr(request, "param", ()) for word in ("-f", file)]
    stack = Stack(
        [*compose, *files, "--project-name", f"board51-{uuid.uuid4().hex[:8]}"],
        {
            **os.environ,
            "BOARD51_BUS_PORT": free,
            "BOARD51_PAGE_PORT": page,
            "BOARD51_KEYS": str(tmp_path / "keys"),
            "DOCKER_BUILDKIT": os.environ.get("DOCKER_BUILDKIT", "0"),
        },
    )
    try:
        yield stack
    finally:
        stack.run("down", "--volumes", "--timeout", "5")


@pytest.mark.slow
@pytest.mark.xdist_group("containers")  # one image, built once
def test_the_whole_line_runs_in_containers_and_leaves_a_closed_log(stack: Stack) -> None:
    stack.call("build")
    # `twin` waits for a healthy gateway, which waits for samples: up returns when the line is alive.
    stack.call("up", "-d")
    bus = ["--connect", "tcp/router:7447"]
    lines = stack.board51(
        "watch", *bus, "--json", "--topic", "twin/state", "--count", "200", "--timeout", "60"
    ).splitlines()
    reply = stack.board51("send", "rig1", "mode", "closed-loop", *bus)
    services = set(stack.call("ps", "--services").split())
    stack.call("stop", "gateway")  # SIGTERM: the log must be complete
    once = ["run", "--rm", "--no-deps", "--entrypoint"]
    info = stack.call(*once, "sh", "gateway", "-c", "board51 info --json /data/logs/*.mcap")
    user = stack.call(*once, "id", "gateway", "-u").strip()

    assert len(lines) == 200
    assert all(json.loads(line)["key"] == "board51/rig1/twin/state" for line in lines)
    assert "accepted" in reply
    assert services == SERVICES
    assert "rig1" in info
    assert user != "0"


@pytest.mark.slow
@pytest.mark.xdist_group("containers")
@pytest.mark.skipif(os.geteuid() != 0, reason="the keys are given to the containers' user, which only root can do")
@pytest.mark.parametrize(
    "stack", [("docker-compose.yml", "gateway/access/guarded.yml")], indirect=True, ids=["guarded"]
)
def test_guarded_containers_serve_who_has_an_identity_and_nobody_else(stack: Stack) -> None:
    keys = Path(stack.environment["BOARD51_KEYS"])
    people = ["--user", "ana:engineer", "--user", "vic:viewer"]
    made = subprocess.run(
        [sys.executable, "-m", "board51", "security", "init", str(keys), "--host", "router", *people],
        cwd=ROOT, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert made.returncode == 0, made.stderr
    for path in (keys, *keys.rglob("*")):
        os.chown(path, 5151, 5151)

    stack.call("build")
    stack.call("up", "-d")
    bus = ["--connect", "tls/router:7447"]
    as_ana, as_vic = (["--identity", f"/keys/identities/{name}"] for name in ("ana", "vic"))
    text = stack.board51("watch", *bus, *as_vic, "--json", "--topic", "twin/state", "--count", "50", "--timeout", "60")
    commanded = stack.board51("send", "rig1", "mode", "closed-loop", *bus, *as_ana)
    refused = stack.run("exec", "-T", "gateway", "board51", "send", "rig1", "mode", "closed-loop", *bus, *as_vic)
    stranger = stack.run(
        "exec", "-T", "gateway", "board51", "watch", *bus, "--topic", "state", "--count", "1", "--timeout", "5"
    )

    assert len(text.splitlines()) == 50
    assert "accepted" in commanded
    assert refused.returncode != 0
    assert "viewer" in refused.stdout + refused.stderr
    assert stranger.returncode != 0
    assert "board51/rig1" not in stranger.stdout
