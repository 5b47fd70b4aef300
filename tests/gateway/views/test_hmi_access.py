"""Who gets in at the web page, and what is refused: plain HTTP and WebSocket clients against the running server."""

from __future__ import annotations

import contextlib
import html
import io
import os
import time
import zipfile
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from urllib.parse import unquote

import httpx
import pytest
from websockets.exceptions import ConnectionClosed, InvalidStatus

from gateway.access.roles import Role
from gateway.access.users import User, remove_user, set_user
from protocol.bus import board51_pb2 as pb
from tests.harness.gateway.bus_peers import PlayedGateway, played_gateway
from tests.harness.gateway.gateway_peers import wait_for
from tests.harness.gateway.hmi_peers import PASSWORDS, Page, drain, frame, hmi, users_file
from twin.model.parameters import Model

pytestmark = pytest.mark.xdist_group("hmi-access")
STOP = "/api/rig/stop"


@dataclass(frozen=True, kw_only=True)
class Server:
    port: int
    folder: Path
    gateway: PlayedGateway
    entered: dict[str, Page] = field(default_factory=dict)

    def page(self, name: str = "", *, again: bool = False) -> Page:
        """A browser of this person, in the same session as before: a log-in takes 0.05 s of processor time."""
        page = Page(self.port)
        if name and (again or name not in self.entered):
            assert page.log_in(name).status_code == 303
            if not again:
                self.entered[name] = page
        elif name:
            page.http.cookies.update(self.entered[name].http.cookies)
            page.token = self.entered[name].token
        return page


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Server]:
    """With logins; the gateway behind it accepts everything."""
    folder = tmp_path_factory.mktemp("hmi")
    (folder / "logs").mkdir()
    (folder / "logs" / "a.mcap").write_bytes(b"not a log")
    (folder / "secret.mcap").write_bytes(b"secret")
    (folder / "logs" / "link.mcap").symlink_to(folder / "secret.mcap")
    (folder / "logs" / ".hidden.mcap").write_bytes(b"hidden")
    with (
        played_gateway() as gateway,
        hmi(folder, gateway.endpoint, "--users", str(users_file(folder)), "--reports", str(folder / "data")) as (
            port,
            _,
        ),
    ):
        made = Server(port=port, folder=folder, gateway=gateway)
        heard = made.page("vic")

        def known() -> bool:
            gateway.state()
            gateway.parameters()
            gateway.status()
            time.sleep(0.02)
            with heard.live("/live") as socket:
                return bool(frame(socket)["boards"])

        wait_for(known, "the board on the page")
        yield made


def test_without_a_session_there_is_the_login_and_nothing_else(server: Server) -> None:
    page = server.page()

    for path, login in (
        ("/", "/login"),
        ("/rig/rig", "/login?next=/rig/rig"),
        ("/logs", "/login?next=/logs"),
        ("/report/0/a b/report.html", "/login?next=/report/0/a%20b/report.html"),
    ):
        answer = page.http.get(path, headers={"accept": "text/html"})
        assert (answer.status_code, answer.headers["location"]) == (303, login)
    for path in ("/api/session", "/log/logs/a.mcap", "/report-file/0/report.html", "/api/summary/logs/a.mcap",
                 "/api/rig/export/kept/a.json?to=fmu"):  # fmt: skip
        assert page.http.get(path).status_code == 401
    assert page.post(STOP).status_code == 401
    assert page.http.get("/login").status_code == 200


def test_curl_at_the_root_reads_where_to_go(server: Server) -> None:
    page = server.page()

    for accept in ("*/*", "application/json"):
        answer = page.http.get("/", headers={"accept": accept})

        assert answer.status_code == 200
        assert answer.headers["content-type"].startswith("text/plain")
        assert "set-cookie" not in answer.headers
        assert all(way in answer.text for way in ("/login", "/api/v1/rigs", "/api/v1/openapi.json"))
    assert page.http.post("/", headers={"accept": "*/*"}).status_code in (401, 403)
    assert page.http.get("/api/session", headers={"accept": "*/*"}).status_code == 401


def test_a_wrong_password_is_refused_and_gives_no_session(server: Server) -> None:
    page = server.page()

    assert page.log_in("ana", "wrong").status_code == 401
    assert page.log_in("nobody-<b>", "x").status_code == 401
    assert page.cookie == ""


def test_the_cookie_is_out_of_reach_of_scripts_and_other_sites(server: Server) -> None:
    page = server.page()

    cookie = page.log_in("vic").headers["set-cookie"]

    assert "HttpOnly" in cookie
    assert "SameSite=Strict" in cookie
    assert "Path=/" in cookie


def test_who_held_a_session_is_told_to_log_in_again(server: Server) -> None:
    page = server.page()
    page.http.cookies.set(page.cookie_name, "of-a-server-that-has-restarted", domain="127.0.0.1")

    answer = page.http.get("/rig/rig", headers={"accept": "text/html"})
    form = page.http.get(answer.headers["location"])

    assert answer.status_code == 303
    assert "Your session is over" in form.text
    assert "Your session is over" not in page.http.get("/login").text


def test_two_pages_on_one_host_keep_their_sessions_apart(server: Server) -> None:
    """As behind two ssh tunnels: browsers send cookies to all ports of a host."""
    here, there = server.page("vic", again=True), Page(server.port)
    there.http.headers["host"], there.base = "127.0.0.1:9999", "http://127.0.0.1:9999"

    cookie = there.log_in("ben").headers["set-cookie"]
    here.http.cookies.update(there.http.cookies)

    assert cookie.startswith("board51_session_9999=")
    assert here.http.get("/api/session").json()["name"] == "vic"
    assert there.http.get("/api/session").json()["name"] == "ben"


def test_a_login_from_another_origin_is_refused(server: Server) -> None:
    answer = server.page().http.post(
        "/login", data={"name": "ben", "password": "operator-pass"}, headers={"origin": "http://evil.example"}
    )

    assert answer.status_code == 403
    assert answer.json()["reason"] == "origin"


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


@pytest.mark.parametrize(
    ("name", "body", "status"),
    [
        ("vic", {"stop": {}}, 200),
        ("vic", {"set_mode": {"mode": "MODE_IDLE"}}, 403),
        ("vic", {"set_reference": {"x_ref_m": 0.003}}, 403),
        ("ben", {"set_reference": {"x_ref_m": 0.003}}, 200),
        ("ben", {"set_mode": {"mode": "MODE_IDLE"}}, 200),
        ("ben", {"mark": {"text": "here"}}, 200),
        ("ben", {"set_gains": {"law": 0, "gains": [1, 2, 3, 4]}}, 403),
        ("ben", {"set_host_loss": {"policy": 0, "timeout_s": 1}}, 403),
        ("ben", {"id": "mine", "who": "ana", "stop": {}}, 400),
        ("ben", {"what": "stop"}, 400),
        ("ben", {}, 400),
        ("ben", {"set_reference": {"x_ref_m": "far"}}, 400),
    ],
)
def test_a_role_may_what_the_table_says_and_no_more(
    server: Server, name: str, body: dict[str, object], status: int
) -> None:
    page = server.page(name)
    before = len(server.gateway.commands)

    answer = page.post("/api/rig/command", body)

    assert answer.status_code == status, answer.text
    assert len(server.gateway.commands) - before == (status == 200)
    if status == 200:
        assert server.gateway.commands[-1][1].who == name, "the log shows who did it"
    if status == 403:
        assert answer.json()["reason"] == "not-allowed"


def test_a_role_or_a_person_taken_away_counts_at_once(server: Server) -> None:
    users = server.folder / "users.toml"
    set_user(users, User(name="zoe", role=Role.OPERATOR), "zoe-password")
    page = Page(server.port)
    assert page.log_in("zoe", "zoe-password").status_code == 303
    assert page.post(STOP).status_code == 200

    set_user(users, User(name="zoe", role=Role.VIEWER), "zoe-password")
    as_viewer = page.post("/api/rig/command", {"set_mode": {"mode": "MODE_IDLE"}})
    with page.live("/live/rig") as live:
        frame(live)
        remove_user(users, "zoe")
        with pytest.raises(ConnectionClosed):
            drain(live)

    assert as_viewer.status_code == 403
    assert page.post(STOP).status_code == 401


def test_an_alarm_is_listed_until_an_operator_has_seen_it(server: Server) -> None:
    server.gateway.send("twin/alarm", pb.Alarm(name="divergence-x", active=True, text="more than noise"))

    def alarm(field: str, expected: object) -> bool:
        with server.page("vic").live("/live/rig") as live:
            listed = next(f["rest"]["alarms"] for f in iter(lambda: frame(live), None) if "rest" in f)
        return any(a["name"] == "divergence-x" and a[field] == expected for a in listed)

    wait_for(lambda: alarm("acknowledged", False), "the alarm")
    assert server.page("vic").post("/api/rig/acknowledge", {"name": "divergence-x"}).status_code == 403
    assert server.page("ben").post("/api/rig/acknowledge", {"name": "divergence-x"}).status_code == 200
    assert alarm("by", "ben")
    assert server.page("ben").post("/api/rig/acknowledge", {"name": "nothing"}).json()["reason"] == "no-alarm"
    assert server.page("ben").post("/api/rig/acknowledge", {"name": 7}).status_code == 400


def test_the_last_report_opens_and_can_reach_nothing(server: Server) -> None:
    folder = server.folder / "data" / "campaigns" / "rig-20260102-030405" / "diagnosis"
    folder.mkdir(parents=True)
    (folder / "report.html").write_text("<p>air-gap-offset")
    page = server.page("vic")

    text = page.open("/rig/rig")
    address = "/report/" + text.partition("/report/")[2].partition('"')[0]
    around = page.http.get(address, headers={"accept": "text/html"})
    report = page.http.get(address.replace("/report/", "/report-file/"))

    assert 'sandbox="allow-same-origin"' in around.text
    assert "air-gap-offset" not in around.text
    assert "air-gap-offset" in report.text
    policy = report.headers["content-security-policy"]
    assert policy.startswith("sandbox allow-same-origin; default-src 'none'")
    assert "script" not in policy


def test_controls_are_on_the_pages_of_those_who_may_use_them(server: Server) -> None:
    pages = [server.page(name).open("/rig/rig") for name in ("vic", "ben")]
    viewer, operator = (page.partition("<body>")[2] for page in pages)  # the head has the texts of all controls

    assert "STOP" in viewer, "whoever sees that something goes wrong may stop it"
    for control in ("Closed loop", "Start excitation", "Mark now"):
        assert control in operator
        assert control not in viewer
    assert "Gains from a file" not in operator, "an engineer's"
    assert "Run quick" not in operator


def test_a_refusal_of_the_gateway_comes_back_with_its_reason(server: Server) -> None:
    page = server.page("ben")
    usual = server.gateway.answer
    server.gateway.answer = lambda _, command: pb.CommandReply(
        id=command.id, refused_by="gateway", reason="slew", text="The jump is too large."
    )

    answer = page.post("/api/rig/command", {"set_reference": {"x_ref_m": 0.003}})

    server.gateway.answer = usual
    assert answer.status_code == 409
    body = answer.json()
    assert (body["accepted"], body["refused_by"], body["reason"]) == (False, "gateway", "slew")


def test_a_log_is_deleted_by_an_engineer_alone_and_never_while_it_is_written(server: Server) -> None:
    logs, campaign = server.folder / "logs", server.folder / "data" / "campaigns" / "rig-20260303-030303"
    campaign.mkdir(parents=True)
    for path in (logs / "old.mcap", logs / "open.mcap", campaign / "rest.mcap"):
        path.write_bytes(b"log")
    for path in (logs / "old.mcap", campaign / "rest.mcap"):
        os.utime(path, (1e9, 1e9))

    def delete(name: str, log: object) -> object:
        return server.page(name).post("/api/*/delete", {"log": log}).json()["reason"]

    assert delete("ben", "logs/old.mcap") == "not-allowed"
    assert delete("ana", "logs/open.mcap") == "in-use"
    assert delete("ana", "campaigns/rig-20260303-030303/rest.mcap") == "of-a-campaign"
    assert delete("ana", "../secret.mcap") == "no-log"
    assert delete("ana", 7) == "malformed"
    assert (logs / "old.mcap").exists()
    assert delete("ana", "logs/old.mcap") == ""
    assert not (logs / "old.mcap").exists()
    for path in (logs / "open.mcap", campaign / "rest.mcap"):
        path.unlink()


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


def test_a_model_leaves_the_page_as_a_file_for_another_tool(server: Server) -> None:
    models = server.folder / "data" / "models" / "rig"
    models.mkdir(parents=True)
    Model.load("ce152").save(models / "a.json")
    (models / "b.json").write_text('{"plant": {"name": "ce152"}}')
    page = server.page("vic")

    answer = page.http.get("/api/rig/export/kept/a.json?to=matlab")
    assert answer.headers["content-disposition"] == 'attachment; filename="a.zip"'
    assert zipfile.ZipFile(io.BytesIO(answer.content)).testzip() is None
    broken = page.http.get("/api/rig/export/kept/b.json?to=fmu")
    assert broken.status_code == 409
    assert "kept/b.json" in broken.json()["text"]
    for name, to in (("kept/a.json", "exe"), ("kept/absent.json", "fmu"), ("kept/..%2f..%2f..%2fusers.toml", "fmu")):
        assert page.http.get(f"/api/rig/export/{name}?to={to}").status_code == 404


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


def test_logging_out_ends_the_session_and_its_frames(server: Server) -> None:
    page = server.page("vic", again=True)

    with page.live("/live/rig") as socket:
        frame(socket)
        assert page.post("/logout").status_code == 200
        with pytest.raises(ConnectionClosed) as closed:
            drain(socket)

    assert closed.value.rcvd is not None
    assert closed.value.rcvd.code == 4401


def test_a_page_cannot_be_framed_or_sniffed(server: Server) -> None:
    headers = server.page("vic").http.get("/", headers={"accept": "text/html"}).headers

    assert headers["x-frame-options"] == "DENY"
    assert "strict-transport-security" not in headers, "plain http cannot promise TLS"
    assert "frame-ancestors 'none'" in headers["content-security-policy"]
    assert "unsafe" not in headers["content-security-policy"]
    assert headers["x-content-type-options"] == "nosniff"


def test_a_session_ends_when_nobody_acts(server: Server, tmp_path: Path) -> None:
    idle_s = 4.0  # as long as a busy machine takes from the log-in to the open page
    users = server.folder / "users.toml"
    with hmi(tmp_path, server.gateway.endpoint, "--users", str(users), "--idle-min", str(idle_s / 60)) as (port, _):
        page = Page(port)
        page.log_in("ben")

        begun_s = time.monotonic()
        with page.live("/live") as socket, pytest.raises(ConnectionClosed) as closed:
            drain(socket)  # a page that is open is no action
        lasted_s = time.monotonic() - begun_s

    assert closed.value.rcvd is not None
    assert closed.value.rcvd.code == 4401
    assert lasted_s > idle_s - 0.5


def test_a_stale_session_can_do_nothing(server: Server, tmp_path: Path) -> None:
    users = server.folder / "users.toml"
    with hmi(tmp_path, server.gateway.endpoint, "--users", str(users), "--session-h", "0.0003") as (port, _):
        page = Page(port)
        page.log_in("ben")
        retained = {"cookie": f"{page.cookie_name}={page.cookie}"}
        page.http.cookies.clear()  # a browser forgets it in time; who has stolen it does not

        wait_for(lambda: page.http.get("/api/session", headers=retained).status_code == 401, "end of the session")
        before = len(server.gateway.commands)
        answer = page.post(STOP, **retained)

    assert answer.status_code == 401
    assert len(server.gateway.commands) == before


@pytest.mark.parametrize("asked", ["/rig/rig", "/logs", "/replay/rig", "/report/0/a b/report.html"])
def test_a_login_leads_to_the_page_that_was_asked_for(server: Server, asked: str) -> None:
    page = server.page()
    form = page.http.get(asked, headers={"accept": "text/html"}).headers["location"]
    shown = html.unescape(page.http.get(form).text.partition('name="next" value="')[2].partition('"')[0])

    wrong = page.http.post(
        "/login", data={"name": "vic", "password": "x", "next": shown}, headers={"origin": page.base}
    )
    right = page.http.post(
        "/login", data={"name": "vic", "password": PASSWORDS["vic"], "next": shown}, headers={"origin": page.base}
    )

    assert f'value="{asked}"' in wrong.text, "a typo does not lose it"
    assert (right.status_code, unquote(right.headers["location"])) == (303, asked)


@pytest.mark.parametrize(
    "asked",
    ["//evil.example", "https://evil.example", "/\\evil.example", "\\\\evil.example", "/\t/evil.example",
     "evil.example", "javascript:alert(1)", "", "/\n/evil.example", " //evil.example", "/login"],
)  # fmt: skip
def test_a_login_leads_to_no_other_server(server: Server, asked: str) -> None:
    page = server.page()
    assert 'name="next" value="/"' in page.http.get("/login", params={"next": asked}).text

    answer = page.http.post(
        "/login", data={"name": "vic", "password": PASSWORDS["vic"], "next": asked}, headers={"origin": page.base}
    )

    assert (answer.status_code, answer.headers["location"]) == (303, "/")


@pytest.mark.parametrize(("held_up_s", "done"), [(0.1, True), (30.0, False), (-30.0, False), (float("nan"), False)])
def test_what_the_network_held_up_is_not_done_and_stop_is(server: Server, held_up_s: float, done: bool) -> None:
    page, before = server.page("ben"), len(server.gateway.commands)
    seen = {"x-board51-seen": f"{time.monotonic() - held_up_s:.3f}"}

    mark = page.post("/api/rig/command", {"mark": {"text": "here"}}, **seen)
    stop = page.post(STOP, **seen)

    assert (mark.status_code == 200) is done
    assert done or mark.json()["reason"] == "not-fresh"
    assert stop.status_code == 200
    assert len(server.gateway.commands) - before == 1 + done


def test_one_stop_stops_every_board_and_says_what_became_of_each(server: Server) -> None:
    usual = server.gateway.answer
    server.gateway.state("other")
    page = server.page("vic")
    with page.live("/live") as live:
        wait_for(lambda: {b["name"] for b in frame(live)["boards"]} >= {"rig", "other"}, "both boards")

    def answer(key: str, command: pb.Command) -> pb.CommandReply | None:
        return usual(key, command) if "/rig/" in key else pb.CommandReply(refused_by="link", reason="timed-out")

    server.gateway.answer = answer
    before = len(server.gateway.commands)
    stopped = page.post("/api/*/stop")
    server.gateway.answer = usual

    assert stopped.status_code == 409, "not all of them"
    boards = stopped.json()["boards"]
    assert {name: boards[name]["accepted"] for name in ("rig", "other")} == {"rig": True, "other": False}
    assert {key.split("/")[1] for key, _ in server.gateway.commands[before:]} >= {"rig", "other"}


def test_a_stop_does_not_wait_for_commands_that_are_not_answered(server: Server) -> None:
    """More of them than the server has threads for."""
    usual = server.gateway.answer
    server.gateway.answer = lambda key, command: usual(key, command) if command.HasField("stop") else None
    pages = [server.page("ben") for _ in range(8)]

    with ThreadPoolExecutor(40) as pool:
        held = [pool.submit(page.post, "/api/rig/command", {"mark": {"text": "x"}}) for page in pages * 5]
        wait_for(lambda: len(server.gateway.unanswered) >= 5, "commands that wait")
        stopped = pages[0].post(STOP)
        waiting = [one for one in held if not one.done()]
        server.gateway.answer = usual
        server.gateway.give_up()

    assert stopped.status_code == 200
    assert len(waiting) > 20, "it was answered before them"
