"""The parts of the web page that need no server: sessions, rows of a plot, files of gains, names of files, jobs."""

from __future__ import annotations

import asyncio
import json
import math
import os
import signal
import subprocess
from dataclasses import replace
from pathlib import Path

import pytest
from starlette.requests import Request

import board51
from gateway.access.roles import Role
from gateway.record.writer import LogWriter
from gateway.views.hmi.actions import Routes, slug
from gateway.views.hmi.gains import parse_gains, rows
from gateway.views.hmi.html.render import render
from gateway.views.hmi.jobs import LINES, WIDTH, Jobs
from gateway.views.hmi.library import Library
from gateway.views.hmi.live import travel_of
from gateway.views.hmi.sessions import MAX_SESSIONS, LoginSessions
from gateway.views.hmi.snapshot import describe, rest
from gateway.views.hmi.turns import MAX_BYTES, Turns
from protocol.bus import board51_pb2 as pb
from protocol.errors import DataError, UsageError
from tests.harness.gateway.bus_peers import feed_of, played_gateway
from tests.harness.gateway.gateway_peers import wait_for
from tests.harness.ports import free_port
from tests.patience import HANG_S

BOARD = pb.Parameters(sample_time_s=2e-3, x_ref_min_m=0.3e-3, x_ref_max_m=5.2e-3, gains=[0.5, 1700.0, 17.7, -17600.0])
FILE = {
    "law": "lqi",
    "gains": [0.5, 1700.0, 17.7, -17600.0],
    "operating_point": {"i_0_a": 0.63, "x_0_m": 2.85e-3, "u_0_v": 2.14},
    "sample_time_s": 2e-3,
}


def test_a_session_ends_by_idleness_and_by_age() -> None:
    sessions = LoginSessions(idle_s=10.0, lifetime_s=25.0)
    session = sessions.open("ben", Role.OPERATOR, 0.0)

    assert sessions.get(session.token, 9.9) is session
    sessions.acted(session, 9.9)
    assert sessions.get(session.token, 19.8) is session
    sessions.acted(session, 19.8)
    assert sessions.left_s(session, 20.0) == pytest.approx(5.0), "an act does not make a session older than it may get"
    assert sessions.get(session.token, 25.0) is None
    assert sessions.get("", 0.0) is None


def test_sessions_are_bounded_and_the_idlest_makes_room() -> None:
    sessions = LoginSessions(idle_s=1e6, lifetime_s=1e6)
    first = sessions.open("first", Role.VIEWER, 0.0)
    second = sessions.open("second", Role.VIEWER, 1.0)
    sessions.acted(first, 2.0)

    for n in range(MAX_SESSIONS - 1):
        sessions.open(f"n{n}", Role.VIEWER, 3.0 + n)

    assert sessions.get(second.token, 500.0) is None
    assert sessions.get(first.token, 500.0) is first


def test_a_file_of_gains_becomes_a_command_and_a_table() -> None:
    toml = (
        'law = "pid"\ngains = [900.0, 8000.0, 12.0]\n[operating_point]\ni_0_a = 0.63\nx_0_m = 0.00285\nu_0_v = 2.14\n'
    )

    gains = parse_gains(json.dumps(FILE).encode(), BOARD)
    pid = parse_gains(toml.encode(), BOARD)

    assert list(gains.gains) == FILE["gains"]
    assert gains.x_0_m == 2.85e-3
    assert (pid.law, list(pid.gains)) == (pb.LAW_PID, [900.0, 8000.0, 12.0, 0.0])
    assert rows(gains, BOARD)[1] == {"name": "k_x", "new": "1700", "now": "1700", "unit": "V/m"}
    assert rows(pid, BOARD)[0]["now"] == "other law"


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"law": "lqr"}, "law is 'lqr'"),
        ({"gains": [1, 2]}, "gains is"),
        ({"gains": [1, 2, 3, math.inf]}, "gains is"),
        ({"gains": [1, 2, 3, True]}, "gains is"),
        ({"operating_point": {"i_0_a": 1.0}}, "operating_point is not complete"),
        ({"sample_time_s": 1e-3}, "T_s = 0.001 s, the board runs at 0.002 s"),
        ({"operating_point": {"i_0_a": 0.6, "x_0_m": 9e-3, "u_0_v": 2.0}}, "outside the board's references"),
        ({"stable": False}, "unstable"),
    ],
)
def test_a_wrong_file_of_gains_is_refused_by_name(change: dict[str, object], message: str) -> None:
    with pytest.raises(DataError, match=message):
        parse_gains(json.dumps(FILE | change).encode(), BOARD)


@pytest.mark.parametrize(
    "data", [b"", b"\xff\xfe", b"{", b"[1, 2]", b"{" * 5000, b"x" * 100_000, b'{"gains": ' + b"[" * 3000]
)
def test_what_is_no_file_of_gains_is_told_so(data: bytes) -> None:
    with pytest.raises(DataError):
        parse_gains(data, BOARD)


def test_a_library_shows_its_own_files_newest_first_and_nothing_else(tmp_path: Path) -> None:
    log_folder, outside = tmp_path / "logs", tmp_path / "outside"
    for folder in (log_folder / "deep", outside):
        folder.mkdir(parents=True)
    for path in (
        log_folder / "a.mcap",
        log_folder / "deep" / "b.mcap",
        log_folder / "c.txt",
        log_folder / ".d.mcap",
        outside / "e.mcap",
    ):
        path.write_bytes(b"x")
    (log_folder / "f.mcap").symlink_to(outside / "e.mcap")
    (log_folder / "g.mcap").symlink_to(log_folder / "nowhere.mcap")
    (log_folder / "a.mcap").touch()
    library = Library({"logs": log_folder, "none": tmp_path / "absent"}, "*.mcap")

    assert {entry.name for entry in library.entries()} == {"logs/a.mcap", "logs/deep/b.mcap"}
    assert library.entries()[0].name == "logs/a.mcap"
    assert library.find("logs/../outside/e.mcap") is None
    assert library.find(str(log_folder / "a.mcap")) is None
    entry = library.find("logs/deep/b.mcap")
    assert entry is not None
    assert entry.path == log_folder / "deep" / "b.mcap"


@pytest.mark.slow
def test_jobs_run_once_say_a_bounded_amount_and_end_with_us(tmp_path: Path) -> None:
    jobs = Jobs()
    words = ["emulate", "--tcp", "127.0.0.1:0"]

    job = jobs.start("record", "rig", words, title="t", who="ben")
    with pytest.raises(UsageError, match="that ben started is still running"):
        jobs.start("record", "rig", words, title="t", who="ana")
    wait_for(lambda: job.lines, "its first line")
    jobs.close()

    assert not job.running
    assert job.lines.maxlen == LINES
    assert all(len(line) <= WIDTH for line in job.lines)
    assert not jobs.stop("record", "rig")


@pytest.mark.slow
@pytest.mark.skipif(os.name != "posix", reason="holds a process by SIGSTOP")
@pytest.mark.parametrize(("kind", "killed"), [("replay", True), ("campaign", False), ("record", False)])
def test_a_job_that_does_not_end_is_killed_but_not_one_that_parks_the_ball_or_writes(
    kind: str, killed: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("gateway.views.hmi.jobs.END_S", 0.2)
    jobs = Jobs()
    try:
        job = jobs.start(kind, "*", ["emulate", "--tcp", "127.0.0.1:0"], title="t", who="ben")
        wait_for(lambda: job.lines, "its first line")
        os.kill(job.process.pid, signal.SIGSTOP)  # it hears nothing

        assert jobs.stop(kind, "*")
        if not killed:
            with pytest.raises(subprocess.TimeoutExpired):
                job.process.wait(1.0)
            os.kill(job.process.pid, signal.SIGCONT)
        assert (job.process.wait(HANG_S) == -signal.SIGKILL) is killed
    finally:
        jobs.close()


@pytest.mark.slow
def test_a_job_that_cannot_go_on_says_its_error_and_one_that_counts_steps_its_progress(tmp_path: Path) -> None:
    jobs = Jobs()
    try:
        job = jobs.start("identify", "rig", ["identify", str(tmp_path / "none.toml")], title="t", who="ben")
        wait_for(lambda: not job.running, "its end")
        job.listener.join()
    finally:
        jobs.close()

    assert job.failed
    assert job.standing.startswith("failed. board51 identify: ")
    assert "none.toml" in job.standing
    assert job.progress is None
    job.lines.extend(["[2/4] steps, 12 s", "    the ball is at rest"])
    assert job.progress == 0.25
    job.lines.clear()
    job.lines.append("[ 14.2 s]   5 %  selected: air-gap-offset")
    assert job.progress == 0.05


def test_a_job_is_on_the_bus_as_the_person_who_started_it(tmp_path: Path) -> None:
    open_bus = Routes(
        logs=tmp_path, data=tmp_path, connect="tcp/h:1", site="s", replay="tcp/127.0.0.1:2", identities=None
    )
    guarded = replace(open_bus, identities=tmp_path)

    assert open_bus.live("ana") == ["--connect", "tcp/h:1", "--site", "s"]
    assert guarded.live("ana")[-2:] == ["--identity", str(tmp_path / "ana")]
    assert guarded.replayed() == ["--connect", "tcp/127.0.0.1:2", "--as-site", "replay"]


@pytest.mark.parametrize(
    ("command", "words"),
    [
        (pb.Command(stop=pb.Stop()), "stop"),
        (pb.Command(set_reference=pb.SetReference(x_ref_m=0.003)), "reference 3.000 mm"),
        (pb.Command(set_mode=pb.SetMode(mode=pb.MODE_CLOSED_LOOP)), "mode closed loop"),
        (pb.Command(mark=pb.Mark(text="here")), "mark here"),
        (pb.Command(excite=pb.Excite(shape=pb.SHAPE_CHIRP, duration_s=3.0)), "excitation chirp 3 s"),
        (pb.Command(excite=pb.Excite(shape=pb.SHAPE_STEP)), "excitation step until it is ended"),
        (pb.Command(excite=pb.Excite(shape=pb.SHAPE_NONE)), "end of the excitation"),
        (pb.Command(), "nothing"),
    ],
)
def test_a_command_is_told_in_words(command: pb.Command, words: str) -> None:
    assert describe(command) == words


@pytest.mark.parametrize(
    "text", ["", "[]", "{}", '{"plant": {"travel_m": "far"}}', '{"plant": {"travel_m": -1}}', "{" * 9]
)
def test_a_model_without_a_travel_tells_none(text: str) -> None:
    assert math.isnan(travel_of(text))


def test_bad_frames_are_frames_and_what_else_is_odd_has_its_own_name() -> None:
    """An answer that came after its time is no fault of the line."""
    with played_gateway() as gateway, feed_of(gateway) as feed:
        status = pb.Status(link="streaming", bad_frames={"crc": 2, "length": 1, "stray-answer": 7, "duplicate": 0})
        gateway.send("status", status)
        board = wait_for(lambda: feed.board("rig"), "the board")
        rest_status = rest(board)["status"]

    assert rest_status["bad_frames"] == 3
    assert rest_status["unexpected"] == {"stray-answer": 7}


def test_text_in_a_page_is_no_html() -> None:
    page = bytes(render("login.html", {"message": "<b>", "next": '"><script>'}).body).decode()

    assert '<p role="alert">&lt;b&gt;</p>' in page
    assert 'value="&#34;&gt;&lt;script&gt;"' in page


def test_a_title_becomes_a_part_of_a_file_name() -> None:
    assert slug("../Étude 1: a/b") == "tude-1-a-b"


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--listen", "8051"], "is not an address"),
        (["--listen", "127.0.0.1:99999"], "is not an address"),
        (["--listen", "0.0.0.0:8051"], "open to the network without protection"),
        (["--users", "nowhere.toml"], "nowhere.toml cannot be read"),
        (["--idle-min", "0"], "--idle-min 0.0 is not a positive number"),
        (["--security", "nowhere"], "cannot be read"),
        (["--site", "a/b"], "is not a name"),
        (["--connect", "nowhere"], "is not a zenoh endpoint"),
    ],
)
def test_wrong_options_are_one_clear_line(
    words: list[str], message: str, capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)

    assert board51.main(["hmi", *words]) == 2

    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1


def test_a_role_with_a_typo_names_its_user(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    path = tmp_path / "users.toml"
    path.write_text('[users.ana]\nrole = "enginer"\npassword = "x"\n')
    path.chmod(0o600)

    assert board51.main(["hmi", "--users", str(path)]) == 2

    assert "user ana: 'enginer' is not a role. Write one of viewer, operator, engineer" in capsys.readouterr().err


def test_a_port_in_use_is_told(capsys: pytest.CaptureFixture[str]) -> None:
    from gateway.views.hmi.app import listen

    port = free_port()
    with listen("127.0.0.1", port):
        assert board51.main(["hmi", "--listen", f"127.0.0.1:{port}"]) == 1

    assert f"Cannot listen on 127.0.0.1:{port}: Address already in use" in capsys.readouterr().err


def test_a_log_that_takes_too_long_to_read_has_a_timeline_without_marks(tmp_path: Path) -> None:
    writer = LogWriter(tmp_path / "flight.mcap")
    for at_s in (0, 60):
        writer.write("board51/rig/state", pb.State(tick=at_s).SerializeToString(), (1_700_000_000 + at_s) * 10**9)
    writer.close()
    (entry,) = Library({"logs": tmp_path}, "*.mcap").entries()

    known = json.loads(asyncio.run(Turns().timeline(Request({"type": "http"}), replace(entry, bytes=MAX_BYTES + 1))))

    assert known == {"start_s": 1.7e9, "duration_s": 60.0, "marks": []}
