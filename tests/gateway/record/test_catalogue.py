"""The catalogue of many logs: its rows, what an update reads, and what a question may do."""

from __future__ import annotations

import csv
import json
import os
import sqlite3
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest

import board51
from gateway.record.catalogue.sessions import sessions_of
from gateway.record.catalogue.store import COLUMNS, NAME, Update, query, selection, update
from gateway.record.writer import LogWriter
from protocol.bus import board51_pb2 as pb
from protocol.errors import ServiceError, UsageError

START_NS = 1_777_593_600_000_000_000  # 2026-05-01 00:00:00 UTC
T_S = 0.002


def state(tick: int, session: int, *, mode: pb.Mode = pb.MODE_CLOSED_LOOP) -> pb.State:
    return pb.State(tick=tick, session=session, t_s=tick * T_S, mode=mode, x_m=0.002 + 1e-6 * tick)


def write(path: Path, board: str = "rig", *, ticks: Sequence[int] = range(100), nis: float = 2.0) -> Path:
    """Write one session in closed loop, its twin off by 3 um, and a second one in which the board only idles."""
    writer, at_ns = LogWriter(path), START_NS

    def put(
        topic: str, message: pb.State | pb.Divergence | pb.Event | pb.Alarm | pb.TwinModel | pb.TwinDiagnosis
    ) -> None:
        writer.write(f"board51/{board}/{topic}", message.SerializeToString(), at_ns)

    put("twin/model", pb.TwinModel(session=1, name="ce152"))
    for tick in ticks:
        at_ns = START_NS + round(tick * T_S * 1e9)
        put("state", state(tick, 1))
        error = pb.SignalDivergence(error=3e-6 if tick % 2 else -3e-6)
        put(
            "twin/divergence",
            pb.Divergence(session=1, tick=tick, sync="in-step", x_m=error, nis=nis, innovation_valid=True),
        )
    put("twin/divergence", pb.Divergence(session=1, sync="out-of-step", x_m=pb.SignalDivergence(error=1.0)))
    put("twin/alarm", pb.Alarm(session=1, name="divergence-x", active=True))
    put("twin/alarm", pb.Alarm(session=1, name="divergence-x", active=False))
    put("twin/diagnosis", pb.TwinDiagnosis(session=1, cause="coulomb-friction"))
    put("event", pb.Event(session=1, name="reset-watchdog", severity="fault"))
    put("event", pb.Event(session=1, name="mode-changed", severity="info"))
    for tick in range(10):
        put("state", state(tick, 2, mode=pb.MODE_IDLE))
    writer.close()
    rest(path)
    return path


def rest(path: Path, *, seconds: int = 0) -> None:
    """A log that was finished long ago."""
    os.utime(path, ns=(START_NS + seconds * 10**9,) * 2)


def test_each_session_of_a_board_has_a_row(tmp_path: Path) -> None:
    (first, second), problem = sessions_of(write(tmp_path / "a.mcap", ticks=[*range(50), *range(60, 100)]))

    assert problem == ""
    assert (first.board, first.session, first.model) == ("rig", 1, "ce152")
    assert first.began == "2026-05-01 00:00:00"
    assert first.duration_s == pytest.approx(99 * T_S)
    assert (first.samples, first.missing) == (90, 10)
    assert first.flown_s == pytest.approx(99 * T_S)
    assert [first.x_low_m, first.x_high_m] == pytest.approx([0.002, 0.002099])
    assert (first.causes, first.alarms, first.faults) == ("coulomb-friction", "divergence-x", "reset-watchdog")
    assert first.divergence_x_m == pytest.approx(3e-6), "samples out of step do not count"
    assert first.nis == pytest.approx(2.0)
    assert (second.session, second.samples, second.flown_s, second.nis, second.alarms) == (2, 10, 0.0, None, "")


def test_two_first_updates_at_once_make_one_catalogue(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The second one makes the tables between the look of the first one and its own tables."""
    write(tmp_path / "a.mcap")
    connect, updates = sqlite3.connect, list[Update]()

    def connect_traced(*args: Any, **options: Any) -> sqlite3.Connection:
        database: sqlite3.Connection = connect(*args, **options)

        def meanwhile(statement: str) -> None:
            if not statement.startswith("PRAGMA"):
                database.set_trace_callback(None)
                updates.append(update(tmp_path))

        database.set_trace_callback(meanwhile)
        monkeypatch.setattr(sqlite3, "connect", connect)
        return database

    monkeypatch.setattr(sqlite3, "connect", connect_traced)

    delayed = update(tmp_path)

    assert [delayed.read, *(other.read for other in updates)] == [0, 1]
    assert len(query(tmp_path, selection("")).rows) == 2


def test_an_update_reads_what_is_new_or_changed_and_forgets_what_is_gone(tmp_path: Path) -> None:
    (tmp_path / "may").mkdir()
    write(tmp_path / "may" / "a.mcap", "rig1")
    write(tmp_path / "b.mcap", "rig2")
    (tmp_path / "none.mcap").write_bytes(b"no log")
    rest(tmp_path / "none.mcap")
    first = update(tmp_path)
    assert (first.read, first.forgotten, first.unfinished) == (3, 0, ())
    assert len(first.unreadable) == 1
    assert "none.mcap" in first.unreadable[0]
    assert update(tmp_path)[:3] == (0, 0, ()), "nothing has changed"

    for name in ("b.mcap", "may/a.mcap"):
        (tmp_path / name).unlink()
    write(tmp_path / "may" / "a.mcap", "rig3")
    rest(tmp_path / "may" / "a.mcap", seconds=1)
    write(tmp_path / "c.mcap").touch()  # somebody writes it now

    assert update(tmp_path)[:3] == (1, 1, ("c.mcap",))
    assert {row[0] for row in query(tmp_path, "SELECT board FROM logs").rows} == {"rig3"}


def test_an_interrupted_update_goes_on_where_it_was(tmp_path: Path) -> None:
    for name in "abc":
        write(tmp_path / f"{name}.mcap", f"rig-{name}")

    def interrupt(text: str) -> None:
        if "c.mcap" in text:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        update(tmp_path, interrupt)

    assert len(query(tmp_path, selection("")).rows) == 4
    assert update(tmp_path).read == 1


def test_a_question_in_sql_finds_sessions(tmp_path: Path) -> None:
    write(tmp_path / "a.mcap", "rig6", nis=2.0)
    write(tmp_path / "b.mcap", "rig7", nis=9.0)
    update(tmp_path)

    result = query(tmp_path, selection("board like 'rig%' and began like '2026-05%' and nis > 3"))

    assert result.columns == COLUMNS
    assert [row[result.columns.index("file")] for row in result.rows] == ["b.mcap"]


@pytest.mark.parametrize(
    "sql",
    [
        "DELETE FROM logs",
        "DROP TABLE logs",
        "UPDATE logs SET board = ''",
        "ATTACH '{folder}/other.sqlite' AS other",
        "PRAGMA writable_schema = 1",
        "VACUUM INTO '{folder}/other.sqlite'",
        "SELECT 1; SELECT 2",
        "SELECT load_extension('x')",
        "SELECT zeroblob(2000000)",
        "WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n) SELECT i FROM n",
        "SELECT nothing FROM logs",
        "",
    ],
)
def test_a_question_only_reads(tmp_path: Path, sql: str) -> None:
    write(tmp_path / "a.mcap")
    update(tmp_path)
    before = (tmp_path / NAME).read_bytes()

    if sql:
        with pytest.raises(UsageError):
            query(tmp_path, sql.format(folder=tmp_path))
    else:
        assert query(tmp_path, sql).rows == []

    assert (tmp_path / NAME).read_bytes() == before
    assert not (tmp_path / "other.sqlite").exists()


def test_a_question_without_an_end_is_ended(tmp_path: Path) -> None:
    for name in "abcdefgh":
        write(tmp_path / f"{name}.mcap", ticks=range(2))
    update(tmp_path)
    many = ", ".join(f"logs AS l{n}" for n in range(12))

    with pytest.raises(UsageError, match="more than 0 s"):
        query(tmp_path, f"SELECT count(*) FROM {many}", limit_s=0.0)
    with pytest.raises(UsageError, match="more than 100000 rows"):
        query(tmp_path, f"SELECT 1 FROM {many}")


def test_a_catalogue_that_is_none_is_said_and_one_of_another_version_is_made_anew(tmp_path: Path) -> None:
    write(tmp_path / "a.mcap")
    with pytest.raises(UsageError, match="has no catalogue"):
        query(tmp_path, selection(""))
    (tmp_path / NAME).write_bytes(b"x" * 4096)
    with pytest.raises(ServiceError, match="delete it"):
        update(tmp_path)
    (tmp_path / NAME).unlink()
    update(tmp_path)
    with sqlite3.connect(tmp_path / NAME) as database:
        database.execute("PRAGMA user_version = 99")
    database.close()

    assert update(tmp_path).read == 1


def test_the_command_prints_a_table_json_or_csv(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write(tmp_path / "a.mcap")
    words = ["logs", "query", "flown_s > 0", "--folder", str(tmp_path)]

    assert board51.main(words) == 0
    captured = capsys.readouterr()
    assert board51.main([*words, "--json"]) == 0
    row = json.loads(capsys.readouterr().out)
    assert board51.main([*words, "--csv", "--no-update"]) == 0
    table = list(csv.reader(capsys.readouterr().out.splitlines()))

    assert "[1/1] a.mcap" in captured.err
    assert captured.out.splitlines()[-1] == "1 row"
    assert (row["board"], row["causes"]) == ("rig", "coulomb-friction")
    assert tuple(row) == tuple(table[0]) == COLUMNS
    assert board51.main(["logs", "query", "board = 'none'", "--folder", str(tmp_path)]) == 1
    assert board51.main(["logs", "query", "x > 1", "--sql", "SELECT 1", "--folder", str(tmp_path)]) == 2
