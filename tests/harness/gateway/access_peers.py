"""A guarded gateway in its tests: a plant's keys, a gateway behind them, clients with an identity."""

from __future__ import annotations

import json
import time
import uuid
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import zenoh

from gateway.access.folder import SecurityFolder
from gateway.access.roles import Role
from gateway.access.users import User
from gateway.config import SecurityConfig, ZenohConfig
from protocol.bus import board51_pb2 as pb
from protocol.bus import topics
from protocol.bus.endpoint import zenoh_config
from protocol.bus.identity import Identity
from tests.harness.gateway.gateway_peers import ScriptedBoard, gateway_config, running, wait_for
from tests.harness.ports import free_port
from tests.patience import HANG_S

PEOPLE = {"ana": Role.ENGINEER, "ben": Role.OPERATOR, "vic": Role.VIEWER}
PASSWORD = "correct horse"


def made_folder(path: Path) -> SecurityFolder:
    """Keys of a plant with an engineer, an operator and a viewer."""
    folder = SecurityFolder(path)
    folder.init()
    for name, role in PEOPLE.items():
        folder.add_user(User(name=name, role=role), PASSWORD)
    return folder


class Client:
    """A session on a guarded bus that keeps what it hears."""

    def __init__(self, session: zenoh.Session, identity: Identity) -> None:
        self.session, self.identity = session, identity
        self.states: list[pb.State] = []
        self.records: list[pb.CommandRecord] = []
        self.events: list[pb.Event] = []
        self._retained = [
            self._keep("state", pb.State, self.states),
            self._keep("command/record", pb.CommandRecord, self.records),
            self._keep("event", pb.Event, self.events),
        ]

    def _keep(self, topic: str, kind: Any, into: list[Any]) -> object:
        return self.session.declare_subscriber(
            f"board51/*/{topic}", lambda sample: into.append(kind.FromString(sample.payload.to_bytes()))
        )

    @property
    def command_key(self) -> str:
        return topics.command_key("board51", "rig", role=self.identity.role, who=self.identity.name)

    def request(self, payload: bytes, key: str = "", timeout_s: float = HANG_S) -> list[pb.CommandReply]:
        """Every reply to a query."""
        replies = self.session.get(key or self.command_key, payload=payload, timeout=timeout_s)
        return [pb.CommandReply.FromString(reply.ok.payload.to_bytes()) for reply in replies if reply.ok is not None]

    def command(self, *, key: str = "", **what: Any) -> pb.CommandReply | None:
        """The reply to a fresh command; None where none came."""
        replies = self.request(fresh(**what).SerializeToString(), key)
        assert len(replies) <= 1
        return replies[0] if replies else None

    def record_of(self, id: str) -> pb.CommandRecord:
        return wait_for(lambda: next((r for r in self.records if r.command.id == id), None), f"record of {id}")


def fresh(**fields: Any) -> pb.Command:
    """A command as an honest sender makes it, but for `fields`."""
    return pb.Command(**{"id": uuid.uuid4().hex, "issued_ns": time.time_ns(), **fields})


@contextmanager
def join(
    endpoint: str,
    identity: Identity,
    *,
    patience_s: float = 5.0,
    change: Callable[[dict[str, Any]], None] | None = None,
) -> Iterator[Client]:
    """A client with this identity; `change` spoils its configuration."""
    config = json.loads(zenoh_config("client", connect=[endpoint], identity=identity))
    config["connect"]["timeout_ms"] = round(patience_s * 1e3)
    if change is not None:
        change(config)
    with zenoh.open(zenoh.Config.from_json5(json.dumps(config))) as session:
        yield Client(session, identity)


@dataclass(frozen=True, kw_only=True)
class GuardedRig:
    """A running gateway that is the router of a guarded bus, and its scripted board."""

    folder: SecurityFolder
    endpoint: str
    board: ScriptedBoard
    logs: Path

    @contextmanager
    def join(self, name: str) -> Iterator[Client]:
        """A client who hears states already."""
        with join(self.endpoint, self.folder.identity(name)) as client:
            wait_for(lambda: client.states, f"states for {name}")
            yield client


@contextmanager
def guarded_rig(folder: SecurityFolder, logs: Path, *, kind: str = "tls", endpoint: str = "") -> Iterator[GuardedRig]:
    """A gateway on a free port; ready for commands."""
    endpoint = endpoint or f"{kind}/127.0.0.1:{free_port()}"
    with ScriptedBoard() as board:
        config = replace(
            gateway_config(board.url, log=logs, stale_s=2.0),  # a busy machine is no attack
            zenoh=ZenohConfig(listen=(endpoint,)),
            security=SecurityConfig(directory=str(folder.path)),
        )
        with running(config):
            rig = GuardedRig(folder=folder, endpoint=endpoint, board=board, logs=logs)
            with join(endpoint, folder.identity("ben")) as first:
                wait_for(lambda: first.states, "states")
                # A gateway that has just started takes no command that may be older than itself.
                wait_for(lambda: (r := first.command(ping=pb.Ping())) is not None and r.accepted, "a first command")
            yield rig
