"""Tests of the API's refusals and of their answers, with programs against the running server."""

from __future__ import annotations

import httpx
import pytest
from websockets.exceptions import ConnectionClosed

from protocol.bus import board51_pb2 as pb
from tests.harness.gateway.api_peers import ApiServer
from tests.harness.gateway.gateway_peers import wait_for
from tests.patience import HANG_S

pytestmark = pytest.mark.xdist_group("hmi-api")
MODE = {"command": "mode", "mode": "closed-loop"}
COMMANDS = "/rigs/rig/commands"


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
def test_a_wrong_command_is_refused_with_a_remedy_and_reaches_no_board(api: ApiServer, body: object) -> None:
    before = len(api.gateway.commands)

    answer = api.program("ana").post(COMMANDS, body)

    assert answer.status_code == 400
    assert answer.json()["executed"] is False
    assert answer.json()["message"]
    assert answer.json()["remedy"]
    assert len(api.gateway.commands) == before


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
def test_a_body_that_cannot_be_read_is_refused(api: ApiServer, data: bytes, media: str, status: int) -> None:
    before = len(api.gateway.commands)

    answer = api.program("ana").http.post("/api/v1" + COMMANDS, content=data, headers={"content-type": media})

    assert answer.status_code == status
    assert {"code", "message", "remedy"} <= set(answer.json())
    assert len(api.gateway.commands) == before


def test_a_form_gives_the_command_that_json_gives(api: ApiServer) -> None:
    program, before = api.program("ana"), len(api.gateway.commands)
    gains = {"i_0_a": 0.6, "x_0_m": 3e-3, "u_0_v": 2.1, "law": "lqi"}

    program.command(command="gains", gains=[1, 2.5, 3, 4], **gains)
    program.http.post("/api/v1" + COMMANDS, data={"command": "gains", "gains": "[1, 2.5, 3, 4]", **gains})
    program.command(command="mark", text="7")
    program.http.post("/api/v1" + COMMANDS, content='{"command": "mark", "text": "7"}',
                      headers={"content-type": "application/x-www-form-urlencoded"})  # fmt: skip
    program.http.post("/api/v1" + COMMANDS, data={"command": "mark", "text": "7"})

    sent = [command for _, command in api.gateway.commands[before:]]
    assert sent[0].set_gains == sent[1].set_gains
    assert [command.mark.text for command in sent[2:]] == ["7", "7", "7"]


def test_a_refusal_of_the_board_has_code_text_remedy_and_status(api: ApiServer) -> None:
    usual = api.gateway.answer
    program = api.program("ben")
    try:
        api.gateway.answer = lambda _, command: pb.CommandReply(
            id=command.id, refused_by="board", reason="slew", text="The board refused: too far."
        )
        answer = program.command(command="reference", x_ref_m=5e-3)
        soft = program.http.post("/api/v1/rigs/rig/commands?soft_errors=true", json={"command": "ping"})
    finally:
        api.gateway.answer = usual

    assert answer.status_code == 409
    assert answer.json() == {
        "executed": False, "code": "slew", "message": "The board refused: too far.",
        "remedy": "Move the reference in smaller steps.", "refused_by": "board", "tick": 0,
    }  # fmt: skip
    assert (soft.status_code, soft.json()["code"]) == (200, "slew")
    assert program.http.post("/api/v1/rigs/rig/commands?soft_errors=true", json={}).json()["executed"] is False


def test_an_unknown_rig_is_answered_with_the_known_ones(api: ApiServer) -> None:
    program = api.program("ana")

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
    "query",
    ["last_s=-1", "last_s=61", "last_s=ten", "last_s=nan", "last_s=", "format=xml", "lasts=1", "last_s=1&last_s=2"],
)
def test_a_wrong_query_is_refused(api: ApiServer, query: str) -> None:
    answer = api.program("ana").http.get(f"/api/v1/rigs/rig/states?{query}")

    assert (answer.status_code, answer.json()["code"]) == (400, "malformed")
    assert answer.json()["remedy"]


@pytest.mark.parametrize("query", ["?rate_hz=0", "?rate_hz=1e6", "?rate_hz=x", "?format=xml", "?rate=1"])
def test_a_stream_with_a_wrong_query_is_closed_with_the_reason(api: ApiServer, query: str) -> None:
    with api.program("vic").stream(query) as stream, pytest.raises(ConnectionClosed) as closed:
        stream.recv(timeout=HANG_S)

    assert closed.value.rcvd is not None
    assert closed.value.rcvd.code == 4400
    assert "query" in closed.value.rcvd.reason


@pytest.mark.parametrize("method", ["PUT", "DELETE", "PATCH", "OPTIONS"])
def test_another_method_or_path_is_answered_in_json(api: ApiServer, method: str) -> None:
    program = api.program("ana")

    answer = program.http.request(method, "/api/v1/rigs/rig")
    answers = [program.http.get(f"/api/v1/{path}") for path in ("rigs/rig/nothing", "rig", "a%0Ab")]

    assert (answer.status_code, answer.json()["code"], answer.headers["allow"]) == (405, "method", "GET")
    assert [(response.status_code, response.json()["code"]) for response in answers] == [(404, "no-path")] * 3
    assert program.get("/rigs/rig/stop").headers["allow"] == "POST"


@pytest.mark.parametrize("name", ["../secret.mcap", "logs/../secret.mcap", "logs/..%2f..%2fsecret.mcap", "/etc/passwd",
                                  "logs/%00", "logs/a%0Ab", "%2e%2e/secret.mcap"])  # fmt: skip
def test_path_tricks_find_no_log(api: ApiServer, name: str) -> None:
    program = api.program("vic")
    url = httpx.URL(scheme="http", host="127.0.0.1", port=api.port, raw_path=f"/api/v1/logs/{name}".encode())

    answer = program.http.get(url)

    assert answer.status_code == 404
    assert b"not for you" not in answer.content
    (log,) = [log for log in program.json("/logs")["logs"] if log["name"] == "logs/a.mcap"]
    assert log["bytes"] == 9
    assert program.get("/logs/logs/a.mcap").content == b"not a log"


def test_what_no_board_sends_breaks_no_answer(api: ApiServer) -> None:
    program, nan = api.program("ana"), float("nan")

    def known() -> bool:
        api.gateway.state("odd", mode=9, x_m=nan, i_c_a=float("inf"), u_c_v=-nan, t_s=nan, flags=2**32 - 1)
        api.gateway.send("parameters", pb.Parameters(x_ref_min_m=nan, gains=[nan]), "odd")
        api.gateway.send("twin/divergence", pb.Divergence(nis_mean=nan, sync="?\ud7ff"), "odd")
        return bool(program.get("/rigs/odd/states", last_s=60).json().get("tick"))

    wait_for(known, "the samples")

    state, status = program.json("/rigs/odd/state"), program.json("/rigs/odd")
    assert (state["x_m"], state["i_c_a"], state["mode"]) == (None, None, "9")
    assert status["limits"] is None, "parameters that no rig has are refused as a whole"
    assert program.http.get("/metrics").status_code == 200
    with program.stream("?rate_hz=500", rig="odd") as stream:

        def sent() -> bool:
            api.gateway.state("odd", mode=9, x_m=nan)
            try:
                return '"mode":"9"' in str(stream.recv(timeout=0.05))
            except TimeoutError:
                return False

        wait_for(sent, "an odd sample")
