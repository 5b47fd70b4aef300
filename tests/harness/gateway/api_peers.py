"""A program at the API of a web page's server, and tokens for it."""

from __future__ import annotations

import json
import ssl
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import httpx
from websockets.sync.client import ClientConnection, connect

from gateway.access.roles import Role
from gateway.access.users import User, set_token
from tests.harness.gateway.bus_peers import PlayedGateway, played_gateway
from tests.harness.gateway.design_files import campaign, designed
from tests.harness.gateway.gateway_peers import wait_for
from tests.harness.gateway.hmi_peers import ROLES, hmi, users_file
from tests.patience import HANG_S


class Program:
    """A client that is no browser: no cookie, no origin."""

    def __init__(self, port: int, token: str = "", *, ca: Path | None = None) -> None:
        self.port = port
        self._headers = {"authorization": f"Bearer {token}"} if token else {}
        base = f"{'http' if ca is None else 'https'}://127.0.0.1:{port}"
        trust = ssl.create_default_context(cafile=ca) if ca is not None else False
        self.http = httpx.Client(base_url=base, timeout=HANG_S, headers=self._headers, verify=trust)

    def get(self, path: str, **query: object) -> httpx.Response:
        """GET below /api/v1."""
        return self.http.get(f"/api/v1{path}", params={name: str(value) for name, value in query.items()})

    def json(self, path: str, **query: object) -> Any:
        """The answer to a GET that succeeds."""
        answer = self.get(path, **query)
        assert answer.status_code == 200, answer.text
        return answer.json()

    def post(self, path: str, body: object = None, **headers: str) -> httpx.Response:
        """POST JSON below /api/v1."""
        return self.http.post(
            f"/api/v1{path}", content=json.dumps(body), headers={"content-type": "application/json", **headers}
        )

    def command(self, **body: object) -> httpx.Response:
        """Send a command to the board `rig`."""
        return self.post("/rigs/rig/commands", body)

    @contextmanager
    def stream(
        self, query: str = "", rig: str = "rig", what: str = "stream", **headers: str
    ) -> Iterator[ClientConnection]:
        """The WebSocket of samples, or of `what`."""
        url = f"ws://127.0.0.1:{self.port}/api/v1/rigs/{rig}/{what}{query}"
        with connect(
            url, additional_headers={**self._headers, **headers}, open_timeout=HANG_S, close_timeout=1.0
        ) as socket:
            yield socket


@dataclass(frozen=True, kw_only=True)
class ApiServer:
    """A page with users and tokens; the gateway behind it accepts everything."""

    port: int
    users: Path
    gateway: PlayedGateway
    tokens: dict[str, str]

    def program(self, name: str = "") -> Program:
        """A program of this user."""
        return Program(self.port, self.tokens.get(name, ""))

    def let_know(self, program: Program) -> None:
        """Send what a board sends, until the server of this program knows it."""

        def known() -> bool:
            self.gateway.state()
            self.gateway.parameters()
            self.gateway.status()
            answer = program.get("/rigs/rig")
            return answer.status_code == 200 and answer.json()["limits"] is not None

        wait_for(known, "the board at the API")


@contextmanager
def api_server(folder: Path) -> Iterator[ApiServer]:
    """Serve two files and a campaign with a model and a design."""
    users, tokens = users_with_tokens(folder)
    (folder / "logs").mkdir()
    (folder / "logs" / "a.mcap").write_bytes(b"not a log")
    (folder / "secret.mcap").write_bytes(b"not for you")
    designed(campaign(folder / "data"))
    with played_gateway() as gateway, hmi(folder, gateway.endpoint, "--users", str(users)) as (port, _):
        server = ApiServer(port=port, users=users, gateway=gateway, tokens=tokens)
        server.let_know(server.program("vic"))
        yield server


def users_with_tokens(folder: Path) -> tuple[Path, dict[str, str]]:
    """The users of `users_file`, each with a token of the user's own name and role."""
    path = users_file(folder)
    return path, {name: set_token(path, name, User(name=name, role=role)) for name, role in ROLES.items()}


def viewer_token_of(path: Path, name: str) -> str:
    """A token by which a program may only look, for a user who may do more."""
    return set_token(path, f"{name}-looks", User(name=name, role=Role.VIEWER))
