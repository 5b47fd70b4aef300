"""Tests of requests that a page of ours would not send, and of the answers, with plain HTTP and WebSocket clients."""

from __future__ import annotations

import contextlib

import httpx
import pytest
from websockets.exceptions import InvalidStatus

from tests.harness.gateway.hmi_peers import frame
from tests.harness.gateway.hmi_server import STOP, Server

pytestmark = pytest.mark.xdist_group("hmi-access")


@pytest.fixture
def server(hmi_server: Server) -> Server:
    return hmi_server


@pytest.mark.parametrize(
    ("headers", "reason"),
    [
        ({"x-board51-token": ""}, "token"),
        ({"x-board51-token": "guessed"}, "token"),
        ({"origin": "http://evil.example"}, "origin"),
        ({"origin": "null"}, "origin"),
        ({"origin": ""}, "origin"),
        ({"host": "evil.example", "origin": "http://evil.example"}, "host"),
    ],
)
def test_a_forged_request_does_nothing(server: Server, headers: dict[str, str], reason: str) -> None:
    page = server.page("ben")
    before = len(server.gateway.commands)

    answer = page.post(STOP, **headers)

    assert answer.status_code in (403, 421)
    assert answer.json()["reason"] == reason
    assert len(server.gateway.commands) == before


def test_the_token_of_another_session_is_none(server: Server) -> None:
    other = server.page("ben")

    answer = server.page("ben", again=True).post(STOP, **{"x-board51-token": other.token})

    assert answer.status_code == 403


def test_a_board_that_nobody_knows_gets_no_command(server: Server) -> None:
    answer = server.page("ben").post("/api/../*/stop".replace("../", "%2e%2e%2f"))

    assert answer.status_code in (404, 405)
    assert server.page("ben").post("/api/nobody/stop").json()["reason"] == "no-board"
    assert server.page("ben").post("/api/*/command", {"ping": {}}).json()["reason"] == "no-board"


@pytest.mark.parametrize(
    "name",
    [
        "logs/../secret.mcap", "../secret.mcap", "logs/..%2fsecret.mcap", "%2e%2e/secret.mcap", "/etc/passwd",
        "logs//etc/passwd", "logs/link.mcap", "logs/.hidden.mcap", "logs/%00a.mcap", "logs/",
        "logs/a.mcap/../../secret.mcap", "recordings/a.mcap",
    ],
)  # fmt: skip
@pytest.mark.parametrize("route", ["log", "report", "report-file", "api/summary"])
def test_path_tricks_find_nothing(server: Server, route: str, name: str) -> None:
    page = server.page("vic")
    # httpx tidies paths; a raw one must reach the server as an attacker would send it.
    url = httpx.URL(scheme="http", host="127.0.0.1", port=server.port, raw_path=f"/{route}/{name}".encode())

    answer = page.http.get(url)

    assert answer.status_code in (400, 404)
    assert b"secret" not in answer.content
    assert b"root:" not in answer.content
    assert page.http.get("/log/logs/a.mcap").content == b"not a log", "its own files are found"


def test_a_large_body_is_refused_before_it_is_read(server: Server) -> None:
    page = server.page("ben")

    assert page.post("/api/rig/command", {"x": "y" * 2_000_000}).status_code == 413
    without_length = page.http.build_request(
        "POST",
        "/api/rig/command",
        content=(b"y" * 100_000 for _ in range(30)),
        headers={"origin": page.base, "x-board51-token": page.token},
    )
    before = len(server.gateway.commands)
    with contextlib.suppress(httpx.TransportError):  # the server may cut the line, or answer
        assert page.http.send(without_length).status_code >= 400
    assert len(server.gateway.commands) == before


def test_frames_go_to_a_page_of_ours_only(server: Server) -> None:
    page = server.page("vic")

    with page.live("/live/rig") as socket:
        assert "now" in frame(socket)
    for wrong in ({"origin": "http://evil.example"}, {"token": "guessed"}, {"cookie": "guessed"}, {"cookie": ""}):
        with pytest.raises(InvalidStatus) as refused, page.live("/live/rig", **wrong):
            pass
        assert refused.value.response.status_code == 403


def test_a_page_cannot_be_framed_or_sniffed(server: Server) -> None:
    headers = server.page("vic").http.get("/", headers={"accept": "text/html"}).headers

    assert headers["x-frame-options"] == "DENY"
    assert "strict-transport-security" not in headers, "plain http cannot promise TLS"
    assert "frame-ancestors 'none'" in headers["content-security-policy"]
    assert "unsafe" not in headers["content-security-policy"]
    assert headers["x-content-type-options"] == "nosniff"
