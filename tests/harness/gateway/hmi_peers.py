"""The surroundings of a web page in its tests: `board51` processes, a client that behaves as a page, its WebSockets."""

from __future__ import annotations

import json
import os
import socket
import ssl
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import httpx
from websockets.sync.client import ClientConnection, connect
from websockets.typing import Origin, Subprotocol

from gateway.access.roles import Role
from gateway.access.users import User, set_user
from protocol.bus import board51_pb2 as pb
from tests.harness.gateway.bus_peers import PlayedGateway, played_gateway
from tests.harness.gateway.gateway_peers import wait_for
from tests.harness.ports import free_port
from tests.patience import HANG_S

PASSWORDS = {"vic": "viewer-pass", "ben": "operator-pass", "ana": "engineer-pass"}
ROLES = {"vic": Role.VIEWER, "ben": Role.OPERATOR, "ana": Role.ENGINEER}


class Process:
    """A `board51` command as a process of its own; what it says is in a file."""

    def __init__(self, folder: Path, *words: str) -> None:
        self.log_file = folder / f"{words[0]}-{os.urandom(3).hex()}.log"
        with self.log_file.open("wb") as out:
            self._process = subprocess.Popen(
                [sys.executable, "-m", "board51", *words], stdout=out, stderr=out, stdin=subprocess.DEVNULL
            )

    def __enter__(self) -> Process:
        return self

    def __exit__(self, *_: object) -> None:
        self.end()

    @property
    def pid(self) -> int:
        return self._process.pid

    def end(self) -> int:
        """SIGTERM; its exit code."""
        if self._process.poll() is None:
            self._process.terminate()
        return self._process.wait(HANG_S)

    def wait(self) -> int:
        """Wait until the process has ended by itself, and return its exit code."""
        return self._process.wait(HANG_S)

    def kill(self) -> None:
        """kill -9."""
        self._process.kill()
        self._process.wait(HANG_S)

    def signal(self, number: int) -> None:
        self._process.send_signal(number)

    def wait_for_words(self, words: str) -> None:
        def look() -> bool:
            text = self.log_file.read_text(errors="replace")
            assert self._process.poll() is None, text
            return words in text

        wait_for(look, f"{words!r} in {self.log_file}")


class Page:
    """A visitor: a cookie jar, our origin, and the token that a page bears."""

    def __init__(self, port: int, *, ca: Path | None = None) -> None:
        self.port = port
        self.base = f"{'http' if ca is None else 'https'}://127.0.0.1:{port}"
        trust = ssl.create_default_context(cafile=ca) if ca is not None else False  # plain http: nothing to load
        no_leftovers = httpx.Limits(max_keepalive_connections=0)
        self.http = httpx.Client(base_url=self.base, timeout=HANG_S, verify=trust, limits=no_leftovers)
        self.token = ""

    def log_in(self, name: str, password: str | None = None) -> httpx.Response:
        answer = self.http.post(
            "/login",
            data={"name": name, "password": PASSWORDS[name] if password is None else password},
            headers={"origin": self.base},
        )
        if answer.status_code == 303:
            self.open()
        return answer

    def open(self, path: str = "/") -> str:
        """A page's text; its token is kept."""
        answer = self.http.get(path, headers={"accept": "text/html"})
        assert answer.status_code == 200, answer.status_code
        self.token = answer.text.partition('data-token="')[2].partition('"')[0]
        assert self.token, "the page bears a token"
        return answer.text

    def post(self, path: str, body: object = None, **headers: str) -> httpx.Response:
        """Post as hmi.js does; a header given as "" is left out."""
        usual = {"origin": self.base, "x-board51-token": self.token, "content-type": "application/json"}
        retained = {name: value for name, value in {**usual, **headers}.items() if value}
        return self.http.post(path, content=json.dumps({} if body is None else body), headers=retained)

    @property
    def cookie_name(self) -> str:
        return f"board51_session_{self.port}"

    @property
    def cookie(self) -> str:
        return self.http.cookies.get(self.cookie_name) or ""

    @contextmanager
    def live(
        self, path: str, *, origin: str = "", token: str | None = None, cookie: str | None = None
    ) -> Iterator[ClientConnection]:
        """A WebSocket to the frames."""
        cookie_value = self.cookie if cookie is None else cookie
        with connect(
            f"ws://127.0.0.1:{self.port}{path}",
            origin=Origin(origin or self.base),
            subprotocols=[Subprotocol("board51"), Subprotocol(self.token if token is None else token)],
            additional_headers={"cookie": f"{self.cookie_name}={cookie_value}"},
            open_timeout=HANG_S,
            close_timeout=1.0,
        ) as live:
            yield live


def frame(live: ClientConnection) -> dict[str, Any]:
    made: dict[str, Any] = json.loads(live.recv(timeout=HANG_S))
    return made


def drain(live: ClientConnection, limit_s: float = HANG_S) -> None:
    """Read until the server ends it."""
    end_s = time.monotonic() + limit_s
    while time.monotonic() < end_s:
        frame(live)


def users_file(folder: Path) -> Path:
    path = folder / "users.toml"
    for name, role in ROLES.items():
        set_user(path, User(name=name, role=role), PASSWORDS[name])
    return path


@contextmanager
def hmi(folder: Path, endpoint: str, *options: str, port: int = 0) -> Iterator[tuple[int, Process]]:
    """`board51 hmi`, ready; its port and its process."""
    port = port or free_port()
    words = ("hmi", "--connect", endpoint, "--listen", f"127.0.0.1:{port}", "--log-dir", str(folder / "logs"))
    with Process(folder, *words, "--data", str(folder / "data"), *options) as process:
        process.wait_for_words("control room of")

        def answers() -> bool:
            try:
                with socket.create_connection(("127.0.0.1", port), timeout=2.0):
                    return "--security" in options or httpx.get(f"http://127.0.0.1:{port}/login").status_code < 400
            except (OSError, httpx.TransportError):
                return False

        wait_for(answers, "the page")
        yield port, process


@contextmanager
def served(folder: Path, model: dict[str, Any]) -> Iterator[tuple[PlayedGateway, int]]:
    """A page with users, on which a played gateway has a board `rig`, whose twin runs on `model`."""
    words = ("--users", str(users_file(folder)))
    with played_gateway() as gateway, hmi(folder, gateway.endpoint, *words) as (port, _):
        page = Page(port)
        page.log_in("vic")

        def known() -> bool:
            gateway.state()
            gateway.send("twin/model", pb.TwinModel(name="ce152", sha256="0" * 64, model_json=json.dumps(model)))
            with page.live("/live") as socket:
                return bool(frame(socket)["boards"])

        wait_for(known, "the board on the page")
        yield gateway, port
