"""Tests of the login at the web page: passwords, cookies, sessions and their duration, and the page that follows."""

from __future__ import annotations

import html
import time
from pathlib import Path
from urllib.parse import unquote

import pytest
from websockets.exceptions import ConnectionClosed

from gateway.access.roles import Role
from gateway.access.users import User, remove_user, set_user
from tests.harness.gateway.gateway_peers import wait_for
from tests.harness.gateway.hmi_peers import PASSWORDS, Page, drain, frame, hmi
from tests.harness.gateway.hmi_server import STOP, Server

pytestmark = pytest.mark.xdist_group("hmi-access")


@pytest.fixture
def server(hmi_server: Server) -> Server:
    return hmi_server


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
    first_page, second_page = server.page("vic", again=True), Page(server.port)
    second_page.http.headers["host"], second_page.base = "127.0.0.1:9999", "http://127.0.0.1:9999"

    cookie = second_page.log_in("ben").headers["set-cookie"]
    first_page.http.cookies.update(second_page.http.cookies)

    assert cookie.startswith("board51_session_9999=")
    assert first_page.http.get("/api/session").json()["name"] == "vic"
    assert second_page.http.get("/api/session").json()["name"] == "ben"


def test_a_login_from_another_origin_is_refused(server: Server) -> None:
    answer = server.page().http.post(
        "/login", data={"name": "ben", "password": "operator-pass"}, headers={"origin": "http://evil.example"}
    )

    assert answer.status_code == 403
    assert answer.json()["reason"] == "origin"


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


def test_logging_out_ends_the_session_and_its_frames(server: Server) -> None:
    page = server.page("vic", again=True)

    with page.live("/live/rig") as socket:
        frame(socket)
        assert page.post("/logout").status_code == 200
        with pytest.raises(ConnectionClosed) as closed:
            drain(socket)

    assert closed.value.rcvd is not None
    assert closed.value.rcvd.code == 4401


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


@pytest.mark.parametrize("target", ["/rig/rig", "/logs", "/replay/rig", "/report/0/a b/report.html"])
def test_a_login_leads_to_the_page_that_was_asked_for(server: Server, target: str) -> None:
    page = server.page()
    form = page.http.get(target, headers={"accept": "text/html"}).headers["location"]
    next_path = html.unescape(page.http.get(form).text.partition('name="next" value="')[2].partition('"')[0])

    wrong = page.http.post(
        "/login", data={"name": "vic", "password": "x", "next": next_path}, headers={"origin": page.base}
    )
    right = page.http.post(
        "/login", data={"name": "vic", "password": PASSWORDS["vic"], "next": next_path}, headers={"origin": page.base}
    )

    assert f'value="{target}"' in wrong.text, "a typo does not lose it"
    assert (right.status_code, unquote(right.headers["location"])) == (303, target)


@pytest.mark.parametrize(
    "target",
    ["//evil.example", "https://evil.example", "/\\evil.example", "\\\\evil.example", "/\t/evil.example",
     "evil.example", "javascript:alert(1)", "", "/\n/evil.example", " //evil.example", "/login"],
)  # fmt: skip
def test_a_login_leads_to_no_other_server(server: Server, target: str) -> None:
    page = server.page()
    assert 'name="next" value="/"' in page.http.get("/login", params={"next": target}).text

    answer = page.http.post(
        "/login", data={"name": "vic", "password": PASSWORDS["vic"], "next": target}, headers={"origin": page.base}
    )

    assert (answer.status_code, answer.headers["location"]) == (303, "/")
