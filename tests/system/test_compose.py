"""The compose file: valid where the plug-in is, and the whole line running where an engine is."""

from __future__ import annotations

import json
import os
import shutil
import socket
import subprocess
import uuid
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
SERVICES = {"router", "emulator", "gateway", "twin"}


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


def test_the_compose_file_is_valid(compose: list[str]) -> None:
    done = subprocess.run([*compose, "config", "-q"], cwd=ROOT, capture_output=True, text=True, check=False)

    assert done.returncode == 0, done.stderr


@pytest.fixture(scope="module")
def project(compose: list[str]) -> Iterator[list[str]]:
    engine = subprocess.run(["docker", "info"], capture_output=True, check=False)
    if engine.returncode != 0:
        pytest.skip("no Docker engine answers")
    image = subprocess.run(["docker", "image", "inspect", "python:3.11-slim"], capture_output=True, check=False)
    if image.returncode != 0:
        pulled = subprocess.run(["docker", "pull", "python:3.11-slim"], capture_output=True, check=False)
        if pulled.returncode != 0:
            pytest.skip("the base image python:3.11-slim is neither here nor to be had")
    command = [*compose, "--project-name", f"board51-{uuid.uuid4().hex[:8]}"]
    try:
        yield command
    finally:
        subprocess.run([*command, "down", "--volumes", "--timeout", "5"], cwd=ROOT, capture_output=True, check=False)


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_the_whole_line_runs_in_containers_and_leaves_a_closed_log(project: list[str]) -> None:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        free = str(probe.getsockname()[1])
    environment = {**os.environ, "BOARD51_BUS_PORT": free, "DOCKER_BUILDKIT": os.environ.get("DOCKER_BUILDKIT", "0")}

    def call(*words: str) -> str:
        done = subprocess.run(
            [*project, *words], cwd=ROOT, capture_output=True, text=True, check=False, env=environment, timeout=800
        )
        assert done.returncode == 0, f"{words}: {done.stdout[-2000:]}{done.stderr[-4000:]}"
        return done.stdout

    call("build")
    # `twin` waits for a healthy gateway, which waits for samples: up returns when the line is alive.
    call("up", "-d")
    watch = ["exec", "-T", "gateway", "board51", "watch", "--connect", "tcp/router:7447", "--json"]
    lines = call(*watch, "--topic", "twin/state", "--count", "200", "--timeout", "60").splitlines()
    reply = call(*watch[:4], "send", "rig1", "mode", "closed-loop", "--connect", "tcp/router:7447")
    call("stop", "gateway")  # SIGTERM: the log must be complete
    info = call(
        "run", "--rm", "--no-deps", "--entrypoint", "sh", "gateway", "-c", "board51 info --json /data/logs/*.mcap"
    )
    user = call("run", "--rm", "--no-deps", "--entrypoint", "id", "gateway", "-u").strip()

    assert len(lines) == 200
    assert all(json.loads(line)["key"] == "board51/rig1/twin/state" for line in lines)
    assert "accepted" in reply
    assert "rig1" in info
    assert user != "0"
