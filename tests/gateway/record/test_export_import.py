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
@settings(max_examples=40, deadline=None, derandomize=True)
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


def test_the_prediction_of_a_recording_is_a_recording(tmp_path: Path) -> None:
    """`board51 predict --out` writes t, x, x_hat."""
    (tmp_path / "predicted.csv").write_text("t,x,x_hat\n0,0.001,0.001\n0.002,0.0011,0.001\n")

    assert board51.main(["import", str(tmp_path / "predicted.csv"), "-o", str(tmp_path / "a.mcap")]) == 0


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
