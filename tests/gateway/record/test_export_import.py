"""`import` reads what `export` writes: the same samples, to the bit, in each format."""

from __future__ import annotations

import math
import tempfile
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import board51
from gateway.record.tables.export import Format, export
from gateway.record.tables.table_import import import_recording
from gateway.record.writer import LogWriter
from protocol.bus import board51_pb2 as pb
from protocol.campaign import Recording
from protocol.log.reader import read
from tests.examples import costly
from tests.harness.twin.rig import Rig

FORMATS: tuple[Format, ...] = ("csv", "mat", "parquet")
START_NS = 1_700_000_000_000_000_001  # odd: a double cannot hold it
NUMBERS = st.floats(allow_nan=False, allow_infinity=False, allow_subnormal=True)


@st.composite
def flights(draw: st.DrawFn) -> list[pb.State]:
    """Samples of one to three sessions, with gaps, and with channels that nobody measured."""
    measured = draw(st.sets(st.sampled_from(("i_c_a", "x_m", "u_c_v", "x_ref_m"))))
    states: list[pb.State] = []
    time_ns = START_NS
    for session in range(7, 7 + draw(st.integers(1, 3))):
        tick = draw(st.integers(0, 1 << 33))
        for _ in range(draw(st.integers(1, 4))):
            lost = draw(st.integers(0, 3))
            tick += 1 + lost
            time_ns += draw(st.integers(1, 10**9))
            state = pb.State(sequence=tick & 0xFFFF, tick=tick, session=session, host_time_ns=time_ns)
            state.t_s, state.lost_before = tick * 2000 / 1e6, lost
            state.mode = draw(st.sampled_from((pb.MODE_IDLE, pb.MODE_OPEN_LOOP, pb.MODE_CLOSED_LOOP)))
            state.flags = draw(st.integers(0, 255))
            for field in measured:
                if draw(st.booleans()):
                    setattr(state, field, draw(NUMBERS))
            states.append(state)
    return states


def write_log(path: Path, states: list[pb.State]) -> None:
    writer = LogWriter(path)
    for state in states:
        writer.write("board51/rig/state", state.SerializeToString(), state.host_time_ns)
    writer.close()


@pytest.mark.parametrize("form", FORMATS)
@settings(max_examples=costly(40), deadline=None, derandomize=True)
@given(states=flights())
def test_what_was_exported_comes_back(form: Format, states: list[pb.State]) -> None:
    with tempfile.TemporaryDirectory() as folder:
        log, table, again = (Path(folder) / name for name in ("a.mcap", f"a.{form}", "again.mcap"))
        write_log(log, states)
        export(log, table, form=form)

        report = import_recording(table, again, Recording(file=table.name, kind="free", use="fit"), board="rig")

        assert [record.message for record in read(again, topics=["state"])] == states
        assert [record.time_ns for record in read(again, topics=["state"])] == [s.host_time_ns for s in states]
        assert report.samples_missing == sum(state.lost_before for state in states)
        assert math.isfinite(report.duration_s)


@pytest.mark.parametrize("form", FORMATS)
def test_an_export_of_the_twin_or_of_a_capture_is_a_recording(form: Format, tmp_path: Path) -> None:
    twin = [pb.TwinState(tick=k, session=1, t_s=k * 2e-3, x_m=k * 1.7e-6, i_c_a=0.6 + k / 3e3, u_c_v=2.1, x_ref_m=3e-3)
            for k in range(5)]  # fmt: skip
    capture = pb.CaptureRecord(sample_time_s=4e-5, u_from_v=1.0, u_to_v=2.0, step_index=2, i_c_a=[0.1, 0.1, 0.1, 0.2])
    writer = LogWriter(tmp_path / "a.mcap")
    for state in twin:
        writer.write("board51/rig/twin/state", state.SerializeToString(), START_NS + state.tick * 2_000_000)
    writer.write("board51/rig/capture", capture.SerializeToString(), START_NS)
    writer.close()

    made: dict[str, list[pb.State]] = {}
    for topic in ("twin/state", "capture"):
        table, again = tmp_path / f"{topic[:4]}.{form}", tmp_path / f"{topic[:4]}.mcap"
        export(tmp_path / "a.mcap", table, form=form, topic=topic)
        assert board51.main(["import", str(table), "-o", str(again)]) == 0
        made[topic] = [
            record.message for record in read(again, topics=["state"]) if isinstance(record.message, pb.State)
        ]

    assert [(s.t_s, s.x_m, s.i_c_a, s.u_c_v, s.x_ref_m) for s in made["twin/state"]] == [
        (s.t_s, s.x_m, s.i_c_a, s.u_c_v, s.x_ref_m) for s in twin
    ]
    assert [(s.i_c_a, s.u_c_v) for s in made["capture"]] == [(0.1, 1.0), (0.1, 1.0), (0.1, 2.0), (0.2, 2.0)]
    assert [s.t_s for s in made["capture"]] == pytest.approx([-8e-5, -4e-5, 0.0, 4e-5])


def test_the_prediction_of_a_recording_is_a_recording(tmp_path: Path) -> None:
    """`board51 predict --out` writes t, x, x_hat in s and m; x_hat is no measurement and is left out."""
    rig = Rig()
    rig.hold(2.85e-3)
    flown = list(rig.run(200, lambda _: 2.85e-3))
    write_log(tmp_path / "flight.mcap", flown)
    words = [
        "predict",
        "ce152",
        str(tmp_path / "flight.mcap"),
        "--horizon",
        "5",
        "--out",
        str(tmp_path / "predicted.csv"),
    ]
    assert board51.main(words) == 0

    assert board51.main(["import", str(tmp_path / "predicted.csv"), "-o", str(tmp_path / "a.mcap")]) == 0

    states = [r.message for r in read(tmp_path / "a.mcap", topics=["state"]) if isinstance(r.message, pb.State)]
    rows = [line.split(",") for line in (tmp_path / "predicted.csv").read_text().splitlines()[1:]]
    assert len(rows) > 100
    assert [(state.t_s, state.x_m) for state in states] == [(float(t), float(x)) for t, x, _ in rows]
    assert {round(state.x_m, 9) for state in states} <= {round(state.x_m, 9) for state in flown}


@pytest.mark.parametrize(("field", "cell"), [("tick", "1.5"), ("mode", "flying"), ("x_m", "inf"), ("session", "-1")])
def test_a_changed_cell_is_named(tmp_path: Path, field: str, cell: str, capsys: pytest.CaptureFixture[str]) -> None:
    log, table = tmp_path / "a.mcap", tmp_path / "a.csv"
    write_log(log, [pb.State(tick=1, session=1, x_m=1e-3, host_time_ns=START_NS)])
    export(log, table, form="csv")
    names, row = table.read_text().splitlines()
    cells = row.split(",")
    cells[names.split(",").index(field)] = cell
    table.write_text(f"{names}\n{','.join(cells)}\n")

    assert board51.main(["import", str(table), "-o", str(tmp_path / "again.mcap")]) == 2
    err = capsys.readouterr().err
    assert f"{table}, line 2: {field} = '{cell}' is not a value of an exported log" in err
    assert not (tmp_path / "again.mcap").exists()
