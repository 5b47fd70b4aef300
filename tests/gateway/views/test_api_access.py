"""Tests of access to the API, with programs against the running server: a STOP always gets in."""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor

import pytest
from websockets.exceptions import ConnectionClosed, InvalidStatus

from gateway.access.users import remove_token
from tests.harness.gateway.api_peers import ApiServer, Program, viewer_token_of
from tests.harness.gateway.gateway_peers import wait_for
from tests.harness.gateway.hmi_peers import Page, drain, hmi
from tests.patience import HANG_S

pytestmark = pytest.mark.xdist_group("hmi-api")
MODE = {"command": "mode", "mode": "closed-loop"}
COMMANDS = "/rigs/rig/commands"


@pytest.fixture(scope="module")
def unguarded(api: ApiServer, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Program]:
    """A program at a second page of the same bus, which needs no login."""
    with hmi(tmp_path_factory.mktemp("open"), api.gateway.endpoint) as (port, _):
        program = Program(port)
        api.let_know(program)
        yield program


@pytest.mark.parametrize("token", ["", "b51_guessed", "b51_" + "A" * 43])
def test_without_a_valid_token_nothing_is_told(api: ApiServer, token: str) -> None:
    program = Program(api.port, token)

    answers = [program.get(path) for path in ("/rigs", "/rigs/rig", "/logs", "/logs/logs/a.mcap", "/openapi.json")]
    answers += [program.http.get("/metrics"), program.command(**MODE), program.post("/rigs/rig/stop")]

    for answer in answers:
        assert answer.status_code == 401
        assert answer.headers["www-authenticate"] == "Bearer"
        assert answer.json()["code"] == "session"
        assert "add-token" in answer.json()["remedy"]
    with pytest.raises(InvalidStatus), program.stream():
        pass


def test_a_program_may_what_the_role_of_its_token_may(api: ApiServer) -> None:
    before = len(api.gateway.commands)

    assert api.program("vic").command(**MODE).status_code == 403
    looking = Program(api.port, viewer_token_of(api.users, "ana"))
    refused = looking.command(**MODE)
    assert (refused.status_code, refused.json()["code"], refused.json()["executed"]) == (403, "not-allowed", False)
    assert api.program("ben").command(command="gains", gains=[1, 2, 3, 4], i_0_a=1, x_0_m=3e-3, u_0_v=2).json()[
        "code"
    ] == ("not-allowed")
    assert api.program("ben").post("/rigs/rig/campaigns", {}).json()["code"] == "not-allowed"
    assert api.program("vic").post("/rigs/rig/stop").json()["executed"]
    assert api.program("ben").command(**MODE).json()["executed"]

    kinds = [(command.WhichOneof("what"), command.who) for _, command in api.gateway.commands[before:]]
    assert kinds == [("stop", "vic"), ("set_mode", "ben")]


def test_a_token_that_was_removed_ends_requests_and_streams_at_once(api: ApiServer) -> None:
    program = Program(api.port, viewer_token_of(api.users, "ben"))
    with program.stream("?rate_hz=500") as stream:
        api.gateway.state()
        remove_token(api.users, "ben-looks")
        with pytest.raises(ConnectionClosed) as closed:
            drain(stream)

    assert closed.value.rcvd is not None
    assert closed.value.rcvd.code == 4401
    assert program.get("/rigs").status_code == 401


def test_a_token_opens_the_api_and_nothing_else(api: ApiServer) -> None:
    program = api.program("ana")

    for path in ("/logs", "/api/session", "/log/logs/a.mcap", "/api/summary/logs/a.mcap"):
        assert program.http.get(path).status_code == 401
    assert program.http.post("/api/rig/stop").status_code in (401, 403)
    assert program.http.get("/", headers={"accept": "text/html"}).status_code == 303


def test_a_cookie_opens_the_api_to_our_own_pages_alone(api: ApiServer) -> None:
    page = Page(api.port)
    page.log_in("ana")
    before = len(api.gateway.commands)
    evil = {"origin": "http://evil.example"}

    assert page.http.get("/api/v1/rigs").status_code == 200
    assert page.http.post("/api/v1" + COMMANDS, json=MODE).status_code == 403, "no origin, no token of the session"
    assert page.http.post("/api/v1" + COMMANDS, json=MODE, headers={"origin": page.base}).status_code == 403
    assert page.http.post("/api/v1" + COMMANDS, json=MODE, headers=evil).status_code == 403
    assert page.post("/api/v1" + COMMANDS, MODE, **evil).status_code == 403
    assert page.http.get("/api/v1/rigs", headers=evil).status_code == 403
    assert len(api.gateway.commands) == before
    assert page.post("/api/v1" + COMMANDS, MODE).status_code == 200
    with pytest.raises(InvalidStatus), api.program().stream(cookie=f"{page.cookie_name}={page.cookie}"):
        pass


def test_no_answer_lets_another_site_read_it(api: ApiServer) -> None:
    answer = api.program("ana").get("/rigs")

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
    api: ApiServer, unguarded: Program, header: dict[str, str]
) -> None:
    before = len(api.gateway.commands)

    answers = [
        unguarded.http.get("/api/v1/rigs", headers=header),
        unguarded.http.get("/metrics", headers=header),
        unguarded.post(COMMANDS, MODE, **header),
        unguarded.post("/rigs/rig/stop", **header),
    ]

    assert {answer.status_code for answer in answers} <= {403, 421}
    assert len(api.gateway.commands) == before
    with pytest.raises(InvalidStatus), unguarded.stream(**header):
        pass


def test_without_logins_a_program_of_this_machine_may_what_the_page_may(api: ApiServer, unguarded: Program) -> None:
    assert unguarded.command(**MODE).json()["executed"]
    assert unguarded.get("/openapi.json").json()["security"] == []
    with unguarded.stream("?rate_hz=500") as stream:

        def sent() -> bool:
            api.gateway.state()
            try:
                return "t_s" in str(stream.recv(timeout=0.05))
            except TimeoutError:
                return False

        wait_for(sent, "a sample")


def test_stop_acts_whatever_is_sent_with_it_and_for_all_rigs(api: ApiServer) -> None:
    program, before = api.program("vic"), len(api.gateway.commands)

    for body, query in ((b"{{{", ""), (b"\xff", "?x=1"), (b"", "?soft_errors=perhaps")):
        answer = program.http.post(f"/api/v1/rigs/rig/stop{query}", content=body)
        assert (answer.status_code, answer.json()["executed"]) == (200, True)
    assert program.post("/rigs/*/stop").json()["executed"]
    assert api.program("ben").command(command="stop").json()["executed"]

    assert [command.WhichOneof("what") for _, command in api.gateway.commands[before:]].count("stop") == 5


def test_a_stop_waits_for_no_command_and_gives_up_those_that_wait(api: ApiServer) -> None:
    """More of them than the server has threads for."""
    usual, program = api.gateway.answer, api.program("ben")
    api.gateway.answer = lambda key, command: usual(key, command) if command.HasField("stop") else None
    try:
        with ThreadPoolExecutor(40) as pool:
            held = [pool.submit(program.command, command="mark", text="x") for _ in range(40)]
            wait_for(lambda: len(api.gateway.unanswered) >= 5, "commands that wait")
            stopped = api.program("vic").post("/rigs/rig/stop")
            waiting = [future for future in held if not future.done()]
            api.gateway.give_up()
            api.gateway.answer = usual
            answers = [future.result(HANG_S) for future in held]
    finally:
        api.gateway.answer = usual

    assert stopped.json()["executed"]
    assert waiting, "STOP was quicker than the commands"
    assert {answer.json()["executed"] for answer in answers} <= {False, True}


def test_a_rig_that_is_called_like_the_api_is_stopped_by_its_page(api: ApiServer) -> None:
    page, program = Page(api.port), api.program("vic")
    page.log_in("vic")

    def known() -> bool:
        api.gateway.state("v1")
        return program.get("/rigs/v1/state").status_code == 200

    wait_for(known, "the rig v1")

    assert page.post("/api/v1/stop").json()["accepted"]
    assert program.post("/rigs/v1/stop").json()["executed"]


def test_the_cookie_that_reads_the_api_sees_its_page(api: ApiServer) -> None:
    page = Page(api.port)
    page.log_in("vic")

    text = page.open("/api/v1/")

    for path, methods in page.http.get("/api/v1/openapi.json").json()["paths"].items():
        for method in methods:
            assert f"{method.upper()} /api/v1{path}" in text
