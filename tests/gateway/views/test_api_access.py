"""Who gets in at the API, and what it refuses: programs against the running server."""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import httpx
import pytest
from websockets.exceptions import ConnectionClosed, InvalidStatus

from gateway.access.users import remove_token
from protocol.bus import board51_pb2 as pb
from tests.harness.gateway.api_peers import Program, users_with_tokens, viewer_token_of
from tests.harness.gateway.bus_peers import PlayedGateway, played_gateway
from tests.harness.gateway.gateway_peers import wait_for
from tests.harness.gateway.hmi_peers import Page, drain, hmi
from tests.patience import HANG_S

pytestmark = pytest.mark.xdist_group("hmi-api")
MODE = {"command": "mode", "mode": "closed-loop"}
COMMANDS = "/rigs/rig/commands"


@dataclass(frozen=True, kw_only=True)
class Server:
    port: int
    folder: Path
    users: Path
    gateway: PlayedGateway
    tokens: dict[str, str]

    def program(self, name: str = "") -> Program:
        return Program(self.port, self.tokens.get(name, ""))


def heard(gateway: PlayedGateway, program: Program) -> None:
    """Wait until the server knows the board."""

    def known() -> bool:
        gateway.state()
        gateway.parameters()
        gateway.status()
        return program.get("/rigs/rig/state").status_code == 200

    wait_for(known, "the board at the API")


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Server]:
    """With users and tokens; the gateway behind it accepts everything."""
    folder = tmp_path_factory.mktemp("api")
    users, tokens = users_with_tokens(folder)
    (folder / "logs").mkdir()
    (folder / "logs" / "a.mcap").write_bytes(b"not a log")
    (folder / "secret.mcap").write_bytes(b"not for you")
    with played_gateway() as gateway, hmi(folder, gateway.endpoint, "--users", str(users)) as (port, _):
        server = Server(port=port, folder=folder, users=users, gateway=gateway, tokens=tokens)
        heard(gateway, server.program("vic"))
        yield server


@pytest.fixture(scope="module")
def unguarded(server: Server, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Program]:
    """A program at a second page of the same bus, which needs no login."""
    with hmi(tmp_path_factory.mktemp("open"), server.gateway.endpoint) as (port, _):
        program = Program(port)
        heard(server.gateway, program)
        yield program


@pytest.mark.parametrize("token", ["", "b51_guessed", "b51_" + "A" * 43])
def test_without_a_valid_token_nothing_is_told(server: Server, token: str) -> None:
    program = Program(server.port, token)

    answers = [program.get(path) for path in ("/rigs", "/rigs/rig", "/logs", "/logs/logs/a.mcap", "/openapi.json")]
    answers += [program.http.get("/metrics"), program.command(**MODE), program.post("/rigs/rig/stop")]

    for answer in answers:
        assert answer.status_code == 401
        assert answer.headers["www-authenticate"] == "Bearer"
        assert answer.json()["code"] == "session"
        assert "add-token" in answer.json()["remedy"]
    with pytest.raises(InvalidStatus), program.stream():
        pass


def test_a_program_may_what_the_role_of_its_token_may(server: Server) -> None:
    before = len(server.gateway.commands)

    assert server.program("vic").command(**MODE).status_code == 403
    looking = Program(server.port, viewer_token_of(server.users, "ana"))
    refused = looking.command(**MODE)
    assert (refused.status_code, refused.json()["code"], refused.json()["executed"]) == (403, "not-allowed", False)
    assert server.program("ben").command(command="gains", gains=[1, 2, 3, 4], i_0_a=1, x_0_m=3e-3, u_0_v=2).json()[
        "code"
    ] == ("not-allowed")
    assert server.program("ben").post("/rigs/rig/campaigns", {}).json()["code"] == "not-allowed"
    assert server.program("vic").post("/rigs/rig/stop").json()["executed"]
    assert server.program("ben").command(**MODE).json()["executed"]

    kinds = [(command.WhichOneof("what"), command.who) for _, command in server.gateway.commands[before:]]
    assert kinds == [("stop", "vic"), ("set_mode", "ben")]


def test_a_token_that_was_removed_ends_requests_and_streams_at_once(server: Server) -> None:
    program = Program(server.port, viewer_token_of(server.users, "ben"))
    with program.stream("?rate_hz=500") as stream:
        server.gateway.state()
        remove_token(server.users, "ben-looks")
        with pytest.raises(ConnectionClosed) as closed:
            drain(stream)

    assert closed.value.rcvd is not None
    assert closed.value.rcvd.code == 4401
    assert program.get("/rigs").status_code == 401


def test_a_token_opens_the_api_and_nothing_else(server: Server) -> None:
    program = server.program("ana")

    for path in ("/logs", "/api/session", "/log/logs/a.mcap", "/api/summary/logs/a.mcap"):
        assert program.http.get(path).status_code == 401
    assert program.http.post("/api/rig/stop").status_code in (401, 403)
    assert program.http.get("/", headers={"accept": "text/html"}).status_code == 303


def test_a_cookie_opens_the_api_to_our_own_pages_alone(server: Server) -> None:
    page = Page(server.port)
    page.log_in("ana")
    before = len(server.gateway.commands)
    evil = {"origin": "http://evil.example"}

    assert page.http.get("/api/v1/rigs").status_code == 200
    assert page.http.post("/api/v1" + COMMANDS, json=MODE).status_code == 403, "no origin, no token of the session"
    assert page.http.post("/api/v1" + COMMANDS, json=MODE, headers={"origin": page.base}).status_code == 403
    assert page.http.post("/api/v1" + COMMANDS, json=MODE, headers=evil).status_code == 403
    assert page.post("/api/v1" + COMMANDS, MODE, **evil).status_code == 403
    assert page.http.get("/api/v1/rigs", headers=evil).status_code == 403
    assert len(server.gateway.commands) == before
    assert page.post("/api/v1" + COMMANDS, MODE).status_code == 200
    with pytest.raises(InvalidStatus), server.program().stream(cookie=f"{page.cookie_name}={page.cookie}"):
        pass


def test_no_answer_lets_another_site_read_it(server: Server) -> None:
    answer = server.program("ana").get("/rigs")

    assert not [name for name in answer.headers if name.startswith("access-control-")]
    assert answer.headers["x-content-type-options"] == "nosniff"


@pytest.mark.parametrize(
    "header",
    [
        {"origin": "http://evil.example"},
        {"origin": "null"},
        {"sec-fetch-site": "cross-site"},
        {"sec-fetch-site": "same-site"},
        {"host": "evil.example"},
    ],
)
def test_without_logins_a_foreign_page_opens_nothing(
    server: Server, unguarded: Program, header: dict[str, str]
) -> None:
    before = len(server.gateway.commands)

    answers = [
        unguarded.http.get("/api/v1/rigs", headers=header),
        unguarded.http.get("/metrics", headers=header),
        unguarded.post(COMMANDS, MODE, **header),
        unguarded.post("/rigs/rig/stop", **header),
    ]

    assert {answer.status_code for answer in answers} <= {403, 421}
    assert len(server.gateway.commands) == before
    with pytest.raises(InvalidStatus), unguarded.stream(**header):
        pass


def test_without_logins_a_program_of_this_machine_may_what_the_page_may(server: Server, unguarded: Program) -> None:
    assert unguarded.command(**MODE).json()["executed"]
    assert unguarded.get("/openapi.json").json()["security"] == []
    with unguarded.stream("?rate_hz=500") as stream:

        def sent() -> bool:
            server.gateway.state()
            try:
                return "t_s" in str(stream.recv(timeout=0.05))
            except TimeoutError:
                return False

        wait_for(sent, "a sample")


BAD: list[object] = [
    None, [], "text", 7, {}, {"command": "hop"}, {"command": ["mode"]}, {"command": "mode"},
    {"command": "mode", "mode": "flying"}, {"command": "mode", "mode": 2}, {**MODE, "extra": 1},
    {"command": "reference"}, {"command": "reference", "x_ref_m": "0.003"}, {"command": "reference", "x_ref_m": True},
    {"command": "reference", "x_ref_m": None}, {"command": "reference", "x_ref_m": [3e-3]},
    {"command": "reference", "x_ref_mm": 3}, {"command": "gains", "gains": [1, 2, 3]},
    {"command": "gains", "gains": [1, 2, 3, "4"], "i_0_a": 1, "x_0_m": 1, "u_0_v": 1},
    {"command": "excite", "shape": "chirp"}, {"command": "excite", "shape": "step", "duration_s": 0},
    {"command": "excite", "shape": "step", "duration_s": -1}, {"command": "stream", "divider": -1},
    {"command": "stream", "divider": 2**40}, {"command": "stream", "divider": 1.5},
    {"command": "mark", "text": "a\nb"}, {"command": "mark", "text": "\ud800"}, {"command": "host-loss", "policy": "x"},
    {"set_mode": {"mode": 2}},
]  # fmt: skip


@pytest.mark.parametrize("body", BAD, ids=lambda body: ascii(body)[:50])
def test_a_wrong_command_is_refused_with_a_remedy_and_reaches_no_board(server: Server, body: object) -> None:
    before = len(server.gateway.commands)

    answer = server.program("ana").post(COMMANDS, body)

    assert answer.status_code == 400
    assert answer.json()["executed"] is False
    assert answer.json()["message"]
    assert answer.json()["remedy"]
    assert len(server.gateway.commands) == before


@pytest.mark.parametrize(
    ("data", "media", "status"),
    [
        (b'{"command": "reference", "x_ref_m": NaN}', "application/json", 400),
        (b'{"command": "reference", "x_ref_m": 1e999}', "application/json", 400),
        (b'{"command": "stream", "divider": ' + b"9" * 5000 + b"}", "application/json", 400),
        (b"[" * 100_000, "application/json", 400),
        (b"\xff\xfe", "application/json", 400),
        (b"{", "application/json", 400),
        (b"command=mode&command=mode&mode=idle", "application/x-www-form-urlencoded", 400),
        (b"command=reference&x_ref_m=nan", "application/x-www-form-urlencoded", 400),
        (b"--x\r\n", "multipart/form-data; boundary=x", 415),
        (b"<a/>", "application/xml", 415),
    ],
)
def test_a_body_that_cannot_be_read_is_refused(server: Server, data: bytes, media: str, status: int) -> None:
    before = len(server.gateway.commands)

    answer = server.program("ana").http.post("/api/v1" + COMMANDS, content=data, headers={"content-type": media})

    assert answer.status_code == status
    assert {"code", "message", "remedy"} <= set(answer.json())
    assert len(server.gateway.commands) == before


def test_a_form_gives_the_command_that_json_gives(server: Server) -> None:
    program, before = server.program("ana"), len(server.gateway.commands)
    gains = {"i_0_a": 0.6, "x_0_m": 3e-3, "u_0_v": 2.1, "law": "lqi"}

    program.command(command="gains", gains=[1, 2.5, 3, 4], **gains)
    program.http.post("/api/v1" + COMMANDS, data={"command": "gains", "gains": "[1, 2.5, 3, 4]", **gains})
    program.command(command="mark", text="7")
    program.http.post("/api/v1" + COMMANDS, content='{"command": "mark", "text": "7"}',
                      headers={"content-type": "application/x-www-form-urlencoded"})  # fmt: skip
    program.http.post("/api/v1" + COMMANDS, data={"command": "mark", "text": "7"})

    sent = [command for _, command in server.gateway.commands[before:]]
    assert sent[0].set_gains == sent[1].set_gains
    assert [command.mark.text for command in sent[2:]] == ["7", "7", "7"]


def test_a_refusal_of_the_board_has_code_text_remedy_and_status(server: Server) -> None:
    usual = server.gateway.answer
    program = server.program("ben")
    try:
        server.gateway.answer = lambda _, command: pb.CommandReply(
            id=command.id, refused_by="board", reason="slew", text="The board refused: too far."
        )
        answer = program.command(command="reference", x_ref_m=5e-3)
        soft = program.http.post("/api/v1/rigs/rig/commands?soft_errors=true", json={"command": "ping"})
    finally:
        server.gateway.answer = usual

    assert answer.status_code == 409
    assert answer.json() == {
        "executed": False, "code": "slew", "message": "The board refused: too far.",
        "remedy": "Move the reference in smaller steps.", "refused_by": "board", "tick": 0,
    }  # fmt: skip
    assert (soft.status_code, soft.json()["code"]) == (200, "slew")
    assert program.http.post("/api/v1/rigs/rig/commands?soft_errors=true", json={}).json()["executed"] is False


def test_an_unknown_rig_is_answered_with_the_known_ones(server: Server) -> None:
    program = server.program("ana")

    for answer in (
        program.get("/rigs/nix"), program.get("/rigs/nix/state"), program.get("/rigs/nix/states"),
        program.get("/rigs/nix/campaigns"), program.get("/rigs/nix/models"),
        program.post("/rigs/nix/commands", MODE), program.post("/rigs/nix/campaigns", {}),
    ):  # fmt: skip
        assert (answer.status_code, answer.json()["code"]) == (404, "no-board")
        assert "rig" in answer.json()["remedy"].split(": ")[1].rstrip(".").split(", ")
    assert program.post("/rigs/nix/stop").status_code == 404
    with program.stream(rig="nix") as stream, pytest.raises(ConnectionClosed) as closed:
        stream.recv(timeout=HANG_S)
    assert closed.value.rcvd is not None
    assert (closed.value.rcvd.code, "rig" in closed.value.rcvd.reason) == (4404, True)


@pytest.mark.parametrize(
    "query", ["last_s=-1", "last_s=61", "last_s=ten", "last_s=nan", "last_s=", "format=xml", "lasts=1",
              "last_s=1&last_s=2"],
)  # fmt: skip
def test_a_wrong_query_is_refused(server: Server, query: str) -> None:
    answer = server.program("ana").http.get(f"/api/v1/rigs/rig/states?{query}")

    assert (answer.status_code, answer.json()["code"]) == (400, "malformed")
    assert answer.json()["remedy"]


@pytest.mark.parametrize("query", ["?rate_hz=0", "?rate_hz=1e6", "?rate_hz=x", "?format=xml", "?rate=1"])
def test_a_stream_with_a_wrong_query_is_closed_with_the_reason(server: Server, query: str) -> None:
    with server.program("vic").stream(query) as stream, pytest.raises(ConnectionClosed) as closed:
        stream.recv(timeout=HANG_S)

    assert closed.value.rcvd is not None
    assert closed.value.rcvd.code == 4400
    assert "query" in closed.value.rcvd.reason


@pytest.mark.parametrize("method", ["PUT", "DELETE", "PATCH", "OPTIONS"])
def test_another_method_or_path_is_answered_in_json(server: Server, method: str) -> None:
    program = server.program("ana")

    answer = program.http.request(method, "/api/v1/rigs/rig")
    nothing = [program.http.get(f"/api/v1/{path}") for path in ("rigs/rig/nothing", "rig", "a%0Ab")]

    assert (answer.status_code, answer.json()["code"], answer.headers["allow"]) == (405, "method", "GET")
    assert [(one.status_code, one.json()["code"]) for one in nothing] == [(404, "no-path")] * 3
    assert program.get("/rigs/rig/stop").headers["allow"] == "POST"


@pytest.mark.parametrize("name", ["../secret.mcap", "logs/../secret.mcap", "logs/..%2f..%2fsecret.mcap", "/etc/passwd",
                                  "logs/%00", "logs/a%0Ab", "%2e%2e/secret.mcap"])  # fmt: skip
def test_path_tricks_find_no_log(server: Server, name: str) -> None:
    program = server.program("vic")
    url = httpx.URL(scheme="http", host="127.0.0.1", port=server.port, raw_path=f"/api/v1/logs/{name}".encode())

    answer = program.http.get(url)

    assert answer.status_code == 404
    assert b"not for you" not in answer.content
    (log,) = [log for log in program.json("/logs")["logs"] if log["name"] == "logs/a.mcap"]
    assert log["bytes"] == 9
    assert program.get("/logs/logs/a.mcap").content == b"not a log"


def test_stop_acts_whatever_is_sent_with_it_and_for_all_rigs(server: Server) -> None:
    program, before = server.program("vic"), len(server.gateway.commands)

    for body, query in ((b"{{{", ""), (b"\xff", "?x=1"), (b"", "?soft_errors=perhaps")):
        answer = program.http.post(f"/api/v1/rigs/rig/stop{query}", content=body)
        assert (answer.status_code, answer.json()["executed"]) == (200, True)
    assert program.post("/rigs/*/stop").json()["executed"]
    assert server.program("ben").command(command="stop").json()["executed"]

    assert [command.WhichOneof("what") for _, command in server.gateway.commands[before:]].count("stop") == 5


def test_a_stop_waits_for_no_command_and_gives_up_those_that_wait(server: Server) -> None:
    """More of them than the server has threads for."""
    usual, program = server.gateway.answer, server.program("ben")
    server.gateway.answer = lambda key, command: usual(key, command) if command.HasField("stop") else None
    try:
        with ThreadPoolExecutor(40) as pool:
            held = [pool.submit(program.command, command="mark", text="x") for _ in range(40)]
            wait_for(lambda: len(server.gateway.unanswered) >= 5, "commands that wait")
            stopped = server.program("vic").post("/rigs/rig/stop")
            waiting = [one for one in held if not one.done()]
            server.gateway.give_up()
            server.gateway.answer = usual
            answers = [one.result(HANG_S) for one in held]
    finally:
        server.gateway.answer = usual

    assert stopped.json()["executed"]
    assert waiting, "STOP was quicker than the commands"
    assert {answer.json()["executed"] for answer in answers} <= {False, True}


def test_a_rig_that_is_called_like_the_api_is_stopped_by_its_page(server: Server) -> None:
    page, program = Page(server.port), server.program("vic")
    page.log_in("vic")

    def known() -> bool:
        server.gateway.state("v1")
        return program.get("/rigs/v1/state").status_code == 200

    wait_for(known, "the rig v1")

    assert page.post("/api/v1/stop").json()["accepted"]
    assert program.post("/rigs/v1/stop").json()["executed"]


def test_what_no_board_sends_breaks_no_answer(server: Server) -> None:
    program, nan = server.program("ana"), float("nan")

    def known() -> bool:
        server.gateway.state("odd", mode=9, x_m=nan, i_c_a=float("inf"), u_c_v=-nan, t_s=nan, flags=2**32 - 1)
        server.gateway.send("parameters", pb.Parameters(x_ref_min_m=nan, gains=[nan]), "odd")
        server.gateway.send("twin/divergence", pb.Divergence(nis_mean=nan, sync="?\ud7ff"), "odd")
        return bool(program.get("/rigs/odd/states", last_s=60).json().get("tick"))

    wait_for(known, "the samples")

    state, status = program.json("/rigs/odd/state"), program.json("/rigs/odd")
    assert (state["x_m"], state["i_c_a"], state["mode"]) == (None, None, "9")
    assert status["limits"] is None, "parameters that no rig has are refused as a whole"
    assert program.http.get("/metrics").status_code == 200
    with program.stream("?rate_hz=500", rig="odd") as stream:

        def sent() -> bool:
            server.gateway.state("odd", mode=9, x_m=nan)
            try:
                return '"mode":"9"' in str(stream.recv(timeout=0.05))
            except TimeoutError:
                return False

        wait_for(sent, "an odd sample")


def test_the_cookie_that_reads_the_api_sees_its_page(server: Server) -> None:
    page = Page(server.port)
    page.log_in("vic")

    text = page.open("/api/v1/")

    for path, methods in page.http.get("/api/v1/openapi.json").json()["paths"].items():
        for method in methods:
            assert f"{method.upper()} /api/v1{path}" in text
